"""Label counts, added up shard by shard, and the split summary computed from them."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hdsp.base.short_repr import short_repr
from hdsp.labels.tasks import REASON_UNKNOWN, TaskSet
from hdsp.robot.lattice import ABSTRACT_HEADINGS, HEADINGS_PER_ABSTRACT, N_ABSTRACT_ACTIONS


@dataclass(frozen=True)
class LabelCounts:
    """Label counts for some maps; counts can be added.

    Attributes:
        maps, dropped: map count with and without a valid start.
        reasons: int64 [256], task count for each ``Status``.
        feasible: number of feasible tasks.
        cost_sum, cost_squares: sums over feasible tasks: costs, and squared costs.
        compared: int64 [16, 22], task count with both kinds of costs, by abstract heading and action.
        ratios: float64 [16, 22], sums of label cost over planning cost of these tasks.
    """

    maps: int = 0
    dropped: int = 0
    reasons: np.ndarray = field(default_factory=lambda: np.zeros(256, np.int64))
    feasible: int = 0
    cost_sum: float = 0.0
    cost_squares: float = 0.0
    compared: np.ndarray = field(default_factory=lambda: np.zeros((ABSTRACT_HEADINGS, N_ABSTRACT_ACTIONS), np.int64))
    ratios: np.ndarray = field(default_factory=lambda: np.zeros((ABSTRACT_HEADINGS, N_ABSTRACT_ACTIONS)))

    def __repr__(self) -> str:
        return short_repr(self)

    @classmethod
    def of(cls, feasible: np.ndarray, cost: np.ndarray, reason: np.ndarray, dropped: int = 0) -> "LabelCounts":
        """Counts the labels for n maps, arrays [n, 22]; ``dropped`` further maps have no labels."""
        found = cost[feasible].astype(np.float64)
        reasons = np.bincount(reason.ravel(), minlength=256)
        return cls(len(feasible), dropped, reasons, len(found), float(found.sum()), float((found**2).sum()))

    def comparing(self, tasks: TaskSet) -> "LabelCounts":
        """Returns the counts with the ratios of both kinds of costs in ``tasks``."""
        if tasks.planning_cost is None:
            return self
        compared, ratios = self.compared.copy(), self.ratios.copy()
        heading = np.broadcast_to(tasks.heading[:, None] // HEADINGS_PER_ABSTRACT, tasks.feasible.shape)
        action = np.broadcast_to(np.arange(N_ABSTRACT_ACTIONS), tasks.feasible.shape)
        both = tasks.feasible & (tasks.planning_cost > 0)
        at = heading[both], action[both]
        np.add.at(compared, at, 1)
        np.add.at(ratios, at, tasks.cost[both].astype(np.float64) / tasks.planning_cost[both])
        return replace(self, compared=compared, ratios=ratios)

    def __add__(self, other: "LabelCounts") -> "LabelCounts":
        return LabelCounts(*(getattr(self, name) + getattr(other, name) for name in self.__dataclass_fields__))

    def to_json(self) -> dict[str, Any]:
        """Returns plain values, without zeros in the arrays."""
        plain = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return {name: _sparse(value) if isinstance(value, np.ndarray) else value for name, value in plain.items()}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> "LabelCounts":
        """Counts from `to_json`."""
        zeros = cls()
        plain = dict(values)
        for name in ("reasons", "compared", "ratios"):
            array = getattr(zeros, name)
            positions, found = values[name]
            array.flat[positions] = found
            plain[name] = array
        return cls(**plain)

    @property
    def tasks(self) -> int:
        return int(self.reasons.sum())

    def summary(self) -> dict[str, Any]:
        """Summary by name: tasks, feasible share, mean and standard deviation of cost, share per reason."""
        tasks, n = self.tasks, self.feasible
        mean = self.cost_sum / n if n else None
        return {
            "tasks": tasks,
            "feasible_share": n / tasks if tasks else None,
            "cost_mean": mean,
            "cost_std": max(self.cost_squares / n - mean**2, 0.0) ** 0.5 if mean is not None else None,
            "share_per_reason": self.shares(),
            **({"label_over_planning": self._label_over_planning()} if self.compared.any() else {}),
        }

    def _label_over_planning(self) -> dict[str, Any]:
        """Mean ratio of both kinds of costs: of all tasks, by action, and by abstract heading."""
        by_action = self.ratios.sum(axis=0) / np.maximum(self.compared.sum(axis=0), 1)
        present = np.flatnonzero(self.compared.any(axis=1)).tolist()
        return {
            "mean": float(self.ratios.sum() / self.compared.sum()),
            "by_action": [value or None for value in by_action.tolist()],
            "by_heading": {str(k): float(self.ratios[k].sum() / self.compared[k].sum()) for k in present},
        }

    def shares(self) -> dict[str, float]:
        """Share of tasks for each reason that occurs."""
        return {reason_name(k): int(self.reasons[k]) / self.tasks for k in np.flatnonzero(self.reasons).tolist()}


def counts_by_category(tasks: TaskSet) -> dict[str, LabelCounts]:
    """Counts a task set by category; a task set does not contain dropped maps."""
    found = {}
    for category in sorted(set(tasks.category.tolist())):
        of_it = tasks.category == category
        counts = LabelCounts.of(tasks.feasible[of_it], tasks.cost[of_it], tasks.reason[of_it])
        found[category] = counts.comparing(tasks[of_it])
    return found


def add_up(parts: Iterable[Mapping[str, LabelCounts]], categories: Iterable[str]) -> dict[str, LabelCounts]:
    """Sums counts for each category in ``categories``."""
    sums = {category: LabelCounts() for category in categories}
    for part in parts:
        for category, counts in part.items():
            sums[category] += counts
    return sums


def split_summary(by_category: Mapping[str, LabelCounts], maps_per_category: int) -> dict[str, Any]:
    """Summary for a labelled split; it depends on the labels alone."""
    kept = {category: counts.maps for category, counts in by_category.items()}
    total = sum(by_category.values(), LabelCounts())
    return {
        "maps": total.maps,
        "maps_dropped": maps_per_category * len(kept) - total.maps,
        "maps_per_category": kept,
        "maps_dropped_per_category": {category: maps_per_category - count for category, count in kept.items()},
        **total.summary(),
    }


def reason_name(reason: int) -> str:
    """Name of a ``Status``, or ``unknown``."""
    from hdsp.detailed.search.outcome import Status

    return "unknown" if reason == REASON_UNKNOWN else str(Status(reason))


def _sparse(array: np.ndarray) -> list[list]:
    """Positions of the non-zero values in a flat array, and the values."""
    positions = np.flatnonzero(array)
    return [positions.tolist(), array.flat[positions].tolist()]
