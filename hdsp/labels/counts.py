"""Label counts, added up shard by shard, and the split summary computed from them."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hdsp.labels.tasks import REASON_UNKNOWN, TaskSet


@dataclass(frozen=True)
class LabelCounts:
    """Label counts for some maps; counts can be added.

    Attributes:
        maps, dropped: number of maps with and without a valid start.
        reasons: int64 [256], number of tasks for each ``Status``.
        feasible: number of feasible tasks.
        cost_sum, cost_squares: sums over feasible tasks: costs, and squared costs.
    """

    maps: int = 0
    dropped: int = 0
    reasons: np.ndarray = field(default_factory=lambda: np.zeros(256, np.int64))
    feasible: int = 0
    cost_sum: float = 0.0
    cost_squares: float = 0.0

    @classmethod
    def of(cls, feasible: np.ndarray, cost: np.ndarray, reason: np.ndarray, dropped: int = 0) -> "LabelCounts":
        """Counts the labels for n maps, arrays [n, 22]; ``dropped`` further maps have no labels."""
        found = cost[feasible].astype(np.float64)
        reasons = np.bincount(reason.ravel(), minlength=256)
        return cls(len(feasible), dropped, reasons, len(found), float(found.sum()), float((found**2).sum()))

    def __add__(self, other: "LabelCounts") -> "LabelCounts":
        return LabelCounts(*(getattr(self, name) + getattr(other, name) for name in self.__dataclass_fields__))

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
        }

    def shares(self) -> dict[str, float]:
        """Share of tasks for each reason that occurs."""
        return {reason_name(k): int(self.reasons[k]) / self.tasks for k in np.flatnonzero(self.reasons).tolist()}


def counts_by_category(tasks: TaskSet) -> dict[str, LabelCounts]:
    """Counts a task set by category; a task set does not contain dropped maps."""
    found = {}
    for category in sorted(set(tasks.category.tolist())):
        of_it = tasks.category == category
        found[category] = LabelCounts.of(tasks.feasible[of_it], tasks.cost[of_it], tasks.reason[of_it])
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
