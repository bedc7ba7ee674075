"""How far the probabilities and costs of a network can be believed, and what corrects them.

*Probabilities.* A network that says 0.9 of many tasks should be right about nine in ten. The expected calibration error
(ECE) is the mean distance between what is said and what is so, over bins of probability (Guo et al., On Calibration of
Modern Neural Networks, 2017). Temperature scaling, from the same paper, divides all logits by one number; no judgement
at one half changes.

*Costs.* Split conformal prediction turns the errors on tasks that were not trained on into bounds for new ones: if
tasks are exchangeable, the cost of a new one lies below the bound of level a with probability at most a (for a <= 1/2;
at least a for the others), whatever the network is like (Vovk et al. 2005; Lei et al. 2018). Errors grow with how much
dearer a task is than on flat ground, and are small for most tasks. So they are taken relative to the predicted cost,
and tasks are grouped by that excess before quantiles are taken, which also makes the bounds hold within each group.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from hdsp.base.errors import InputError

BINS = 15
#: Levels whose quantiles are kept with a model.
LEVELS = (0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99)
#: Groups of excess cost, and how many tasks a group needs at least.
GROUPS, GROUP_TASKS = 8, 200
#: Range in which the temperature is looked for.
_TEMPERATURES = (0.05, 20.0)


class Reliability(NamedTuple):
    """Tasks by predicted probability, empty bins left out; arrays [bins].

    Attributes:
        count: tasks in the bin.
        predicted: their mean probability of being feasible.
        observed: share of them that is feasible.
    """

    count: np.ndarray
    predicted: np.ndarray
    observed: np.ndarray

    @property
    def error(self) -> float:
        """The expected calibration error: mean over tasks of |observed - predicted| of their bin; NaN without tasks."""
        if len(self.count) == 0:
            return float("nan")
        return float(np.average(np.abs(self.observed - self.predicted), weights=self.count))


def reliability(probability: np.ndarray, feasible: np.ndarray, bins: int = BINS, adaptive: bool = False) -> Reliability:
    """Bins tasks by probability.

    Args:
        probability: in [0, 1], any shape.
        feasible: bool, the same shape.
        bins: at most so many.
        adaptive: bins with equally many tasks instead of bins of equal width.

    Raises:
        InputError: shapes differ, or a value is no probability.
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
    """The temperature T with which sigmoid(logit / T) has the highest likelihood; 1 without tasks."""
    logits, feasible = np.ravel(logits).astype(float), np.ravel(feasible).astype(bool)
    if logits.size == 0:
        return 1.0
    signed = np.where(feasible, logits, -logits)

    def loss(log_temperature: float) -> float:
        return float(np.logaddexp(0.0, -signed / math.exp(log_temperature)).mean())

    found = minimize_scalar(loss, bounds=[math.log(t) for t in _TEMPERATURES], method="bounded")
    return float(math.exp(found.x))


def conformal_quantile(residuals: np.ndarray, level: float) -> float:
    """The bound that a further residual, exchangeable with these n, is below with probability at most ``level``.

    For levels above one half: at least ``level``. That is the order statistic number floor(level (n + 1)), above one
    half ceil(level (n + 1)); infinite where n is too small for the level.
    """
    if not 0 < level < 1:
        raise InputError(f"quantile level {level}; need one between 0 and 1")
    ordered = np.sort(np.ravel(residuals))
    place = level * (len(ordered) + 1)
    # The rounding is of numbers such as 0.05 * 20, which are whole.
    rank = math.floor(place + 1e-9) if level <= 0.5 else math.ceil(place - 1e-9)
    if rank < 1:
        return -math.inf
    return float(ordered[rank - 1]) if rank <= len(ordered) else math.inf


@dataclass(frozen=True)
class Calibration:
    """What corrects a network.

    Attributes:
        temperature: probabilities are sigmoid(logit / temperature).
        excess: rising; borders between the groups of tasks by predicted cost / predicted cost on flat ground.
        cost_quantiles: by level, for each group the quantile of (cost - predicted cost) / predicted cost.
        tasks: how many it was fitted to.
    """

    temperature: float = 1.0
    excess: tuple[float, ...] = ()
    cost_quantiles: Mapping[float, tuple[float, ...]] = field(default_factory=dict)
    tasks: int = 0

    def __post_init__(self):
        if not (math.isfinite(self.temperature) and self.temperature > 0):
            raise InputError(f"calibration.temperature is {self.temperature}; it must be positive")
        for level, values in self.cost_quantiles.items():
            if len(values) != len(self.excess) + 1 or not np.isfinite(values).all():
                raise InputError(f"calibration.cost_quantiles of {level}: need {len(self.excess) + 1} finite numbers")

    def at_level(self, level: float, cost: np.ndarray, flat_cost: np.ndarray) -> np.ndarray:
        """The quantile of the cost of tasks, float32, any shape, given what the network predicts for them and for the
        same goals on flat ground.

        Raises:
            InputError: for a level that was not fitted.
        """
        values = self.factors(level)
        groups = np.searchsorted(self.excess, cost / np.maximum(flat_cost, 1e-9), side="right")
        return (cost * values[groups]).astype(np.float32)

    def factors(self, level: float) -> np.ndarray:
        """For each group, what a predicted cost is multiplied by; raises as ``at_level``."""
        values = next((values for key, values in self.cost_quantiles.items() if math.isclose(key, level)), None)
        if values is None:
            known = ", ".join(f"{key:g}" for key in sorted(self.cost_quantiles)) or "none: the model is not calibrated"
            raise InputError(f"cost quantile {level:g} is not known of this model; known are {known}")
        return 1.0 + np.asarray(values)

    def to_dict(self) -> dict[str, Any]:
        """As plain values, for JSON."""
        return {
            "temperature": self.temperature,
            "excess": list(self.excess),
            "cost_quantiles": {f"{level:g}": list(values) for level, values in self.cost_quantiles.items()},
            "tasks": self.tasks,
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Calibration:
        """The inverse of ``to_dict``.

        Raises:
            InputError: the values are not those of a calibration.
        """
        try:
            quantiles = {float(level): tuple(map(float, row)) for level, row in values["cost_quantiles"].items()}
            edges = tuple(map(float, values["excess"]))
            return cls(float(values["temperature"]), edges, quantiles, int(values["tasks"]))
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputError(f"calibration: not readable ({type(error).__name__}: {error})") from None


def fit_calibration(
    logits: np.ndarray,
    cost: np.ndarray,
    flat_cost: np.ndarray,
    feasible: np.ndarray,
    labelled_cost: np.ndarray,
    levels: Sequence[float] = LEVELS,
) -> Calibration:
    """Temperature and cost quantiles from tasks that were not trained on; all arrays of one shape.

    Args:
        logits: of feasibility.
        cost: as the network predicts it.
        flat_cost: predicted for the same goals on flat ground.
        feasible, labelled_cost: the labels.
        levels: which quantiles. Those that there are too few tasks for are left out.

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
    """How well calibrated a network is on a set: plain numbers, ready for JSON.

    Args:
        probability: of feasibility.
        feasible, labelled_cost: the labels.
        bounds: by level, the quantile of cost that the network states.
        judged: bool, tasks that the network judges feasible.

    Returns:
        ``ece``, ``ece_adaptive``, ``brier`` (mean squared error of the probability); ``bins``: the diagram with bins of
        equal width; ``cost_coverage``: by level, the share of tasks feasible for both whose cost is at most the bound.
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
