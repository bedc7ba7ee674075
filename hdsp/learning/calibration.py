"""Calibration: reliability figures for a network's probabilities and costs, and their correction.

*Probabilities.* Among tasks with a predicted probability of 0.9, about nine in ten should be feasible. The expected
calibration error (ECE) is the mean distance between predicted and observed share over probability bins (Guo et al., On
Calibration of Modern Neural Networks, 2017). Temperature scaling, from the same paper, divides all logits by one
number; no decision at one half changes.

*Costs.* Split conformal prediction turns errors on tasks outside the training set into bounds for new tasks. If tasks
are exchangeable, a new task's cost lies below the bound for level a with probability at most a (for a <= 1/2) or at
least a (for a > 1/2), with any network (Vovk et al. 2005; Lei et al. 2018). Errors are small for most tasks and grow
with the excess cost over flat ground. Errors are therefore taken relative to the predicted cost, and quantiles are
taken per excess group. The bounds then also hold within each group.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from pydantic import BeforeValidator, model_validator
from scipy.optimize import minimize_scalar

from hdsp.base.errors import InputError
from hdsp.base.settings import Natural, Positive, checked, fault, load_settings

#: Lower bound on predicted costs, in use and in metrics. A network may predict zero or less, but a search needs
#: positive edge costs.
MINIMUM_COST = 1e-3
BINS = 15
#: Quantile levels kept with a model.
LEVELS = (0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99)
#: Largest number of excess cost groups, and smallest number of tasks per group.
GROUPS, GROUP_TASKS = 8, 200
#: Search range for the temperature.
_TEMPERATURES = (0.05, 20.0)


class Reliability(NamedTuple):
    """Tasks binned by predicted probability, without empty bins; arrays [bins].

    Attributes:
        tasks: number per bin.
        predicted: mean predicted probability per bin.
        observed: share of feasible tasks per bin.
    """

    tasks: np.ndarray
    predicted: np.ndarray
    observed: np.ndarray

    @property
    def error(self) -> float:
        """Expected calibration error: mean |observed - predicted| per bin, weighted by tasks; NaN without tasks."""
        if len(self.tasks) == 0:
            return float("nan")
        return float(np.average(np.abs(self.observed - self.predicted), weights=self.tasks))


def reliability(probability: np.ndarray, feasible: np.ndarray, bins: int = BINS, adaptive: bool = False) -> Reliability:
    """Bins tasks by probability.

    Args:
        probability: in [0, 1], any shape.
        feasible: bool, the same shape.
        bins: largest number of bins.
        adaptive: bins with equal task counts instead of equal widths.

    Raises:
        InputError: shapes differ, a value is no probability, or ``bins`` is below 1.
    """
    probability, feasible = np.ravel(probability).astype(float), np.ravel(feasible).astype(bool)
    if probability.shape != feasible.shape:
        raise InputError(f"calibration: {probability.size} probabilities for {feasible.size} labels")
    if not ((probability >= 0) & (probability <= 1)).all():
        raise InputError("calibration: a probability is outside [0, 1]")
    if bins < 1:
        raise InputError(f"calibration: {bins} bins; need at least one")
    if adaptive:
        order = np.argsort(probability, kind="stable")
        which = np.empty(len(order), np.int64)
        which[order] = np.arange(len(order)) * bins // max(len(order), 1)
    else:
        which = np.minimum((probability * bins).astype(np.int64), bins - 1)
    count = np.bincount(which, minlength=bins)
    filled = count > 0
    predicted, observed = (
        np.bincount(which, weights=values, minlength=bins)[filled] / count[filled] for values in (probability, feasible)
    )
    return Reliability(count[filled], predicted, observed)


def fit_temperature(logits: np.ndarray, feasible: np.ndarray) -> float:
    """Returns the temperature T with the highest likelihood for sigmoid(logit / T); 1 without tasks."""
    logits, feasible = np.ravel(logits).astype(float), np.ravel(feasible).astype(bool)
    if logits.size == 0:
        return 1.0
    signed = np.where(feasible, logits, -logits)

    def loss(log_temperature: float) -> float:
        return float(np.logaddexp(0.0, -signed / math.exp(log_temperature)).mean())

    found = minimize_scalar(loss, bounds=[math.log(t) for t in _TEMPERATURES], method="bounded")
    return float(math.exp(found.x))


def conformal_quantile(residuals: np.ndarray, level: float) -> float:
    """Returns a bound; a further, exchangeable residual lies below it with probability at most ``level``.

    For levels above one half the probability is at least ``level``. The bound is order statistic number floor(level (n
    + 1)), above one half ceil(level (n + 1)); it is infinite if n is too small for the level.

    Raises:
        InputError: the level is not between 0 and 1.
    """
    if not 0 < level < 1:
        raise InputError(f"quantile level {level}; need one between 0 and 1")
    ordered = np.sort(np.ravel(residuals))
    place = level * (len(ordered) + 1)
    # The tolerance serves whole products like 0.05 * 20, which floating point may miss.
    rank = math.floor(place + 1e-9) if level <= 0.5 else math.ceil(place - 1e-9)
    if rank < 1:
        return -math.inf
    return float(ordered[rank - 1]) if rank <= len(ordered) else math.inf


def _by_level(values: Any) -> Any:
    """Converts text keys from JSON to numbers, and lists to tuples."""

    def number(key: Any) -> Any:
        try:
            return float(key) if isinstance(key, str) else key
        except ValueError:
            return key

    if not isinstance(values, Mapping):
        return values
    return {number(level): tuple(row) if isinstance(row, list) else row for level, row in values.items()}


@checked
class Calibration:
    """Corrections for a network's probabilities and costs.

    Attributes:
        temperature: probabilities are sigmoid(logit / temperature).
        excess: rising borders between task groups, by predicted cost / predicted cost on flat ground.
        cost_quantiles: for each level, each group's quantile of (cost - predicted cost) / predicted cost.
        tasks: number of fitted tasks.
    """

    temperature: Positive = 1.0
    excess: tuple[float, ...] = ()
    cost_quantiles: Annotated[dict[float, tuple[float, ...]], BeforeValidator(_by_level)] = field(default_factory=dict)
    tasks: Natural = 0

    @model_validator(mode="after")
    def _check(self) -> Self:
        for level, values in self.cost_quantiles.items():
            if len(values) != len(self.excess) + 1:
                raise fault("cost_quantiles", {level: values}, f"{len(self.excess) + 1} numbers for each level")
        return self

    def at_level(self, level: float, cost: np.ndarray, flat_cost: np.ndarray) -> np.ndarray:
        """Returns cost quantiles, float32, any shape, from predicted costs on the terrain and on flat ground.

        Raises:
            InputError: the level was not fitted.
        """
        values = self.factors(level)
        groups = np.searchsorted(self.excess, cost / np.maximum(flat_cost, 1e-9), side="right")
        return (cost * values[groups]).astype(np.float32)

    def factors(self, level: float) -> np.ndarray:
        """Returns each group's factor on predicted costs; raises as ``at_level``."""
        values = next((values for key, values in self.cost_quantiles.items() if math.isclose(key, level)), None)
        if values is None:
            known = ", ".join(f"{key:g}" for key in sorted(self.cost_quantiles)) or "none: the model is not calibrated"
            raise InputError(f"cost quantile {level:g} is not known of this model; known are {known}")
        return 1.0 + np.asarray(values)

    def to_dict(self) -> dict[str, Any]:
        """Returns plain values for JSON."""
        return {
            "temperature": self.temperature,
            "excess": list(self.excess),
            "cost_quantiles": {f"{level:g}": list(values) for level, values in self.cost_quantiles.items()},
            "tasks": self.tasks,
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Calibration:
        """Inverse of ``to_dict``.

        Raises:
            InputError: the values are no calibration.
        """
        return load_settings(cls, values, "calibration")


def fit_calibration(
    logits: np.ndarray,
    cost: np.ndarray,
    flat_cost: np.ndarray,
    feasible: np.ndarray,
    labelled_cost: np.ndarray,
    levels: Sequence[float] = LEVELS,
) -> Calibration:
    """Fits temperature and cost quantiles to tasks outside the training set; all arrays have one shape.

    Args:
        logits: feasibility logits.
        cost: predicted costs.
        flat_cost: predicted costs for the same goals on flat ground.
        feasible, labelled_cost: labels.
        levels: quantile levels. Levels with too few tasks are left out.

    Raises:
        InputError: shapes differ.
    """
    arrays = [np.ravel(array) for array in (logits, cost, flat_cost, feasible, labelled_cost)]
    if len({array.size for array in arrays}) != 1:
        raise InputError(f"calibration: arrays of {', '.join(str(array.size) for array in arrays)} tasks; need equal")
    logits, cost, flat_cost, feasible, labelled_cost = arrays
    feasible = feasible.astype(bool)
    both = feasible & (logits > 0)
    residuals = labelled_cost[both].astype(float) / cost[both] - 1
    excess = cost[both].astype(float) / np.maximum(flat_cost[both], 1e-9)
    groups = max(1, min(GROUPS, both.sum() // GROUP_TASKS))
    edges = np.unique(np.quantile(excess, np.arange(1, groups) / groups)) if groups > 1 else np.empty(0)
    which = np.searchsorted(edges, excess, side="right")
    quantiles = {}
    for level in levels:
        row = [conformal_quantile(residuals[which == group], level) for group in range(len(edges) + 1)]
        if np.isfinite(row).all():
            quantiles[float(level)] = tuple(row)
    return Calibration(fit_temperature(logits, feasible), tuple(edges.tolist()), quantiles, int(feasible.size))


def calibration_figures(
    probability: np.ndarray, feasible: np.ndarray, bounds: Mapping[float, np.ndarray], labelled_cost: np.ndarray,
    judged: np.ndarray,
) -> dict[str, Any]:  # fmt: skip
    """Returns calibration figures for a task set: plain numbers, ready for JSON.

    Args:
        probability: predicted feasibility probabilities.
        feasible, labelled_cost: labels.
        bounds: for each level, the predicted cost quantiles.
        judged: bool, tasks that the network judges feasible.

    Returns:
        ``ece``, ``ece_adaptive``, ``brier`` (mean squared probability error); ``bins``: reliability diagram with equal
        bin widths; ``cost_coverage``: for each level, the share of tasks with costs up to the bound, among tasks that
        labels and network judge feasible.
    """
    equal = reliability(probability, feasible)
    both = feasible & judged
    return {
        "ece": equal.error,
        "ece_adaptive": reliability(probability, feasible, adaptive=True).error,
        "brier": float(np.mean((probability - feasible) ** 2)),
        "bins": {name: values.tolist() for name, values in equal._asdict().items()},
        "cost_coverage": {
            f"{level:g}": float(np.mean(labelled_cost[both] <= bound[both])) if both.any() else None
            for level, bound in bounds.items()
        },
    }
