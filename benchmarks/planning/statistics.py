"""Means over pairs, with bootstrap intervals in which whole maps are drawn: pairs on one map resemble each other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

RESAMPLES = 10_000
LEVEL = 0.95


class Interval(NamedTuple):
    """A mean over ``number`` values, and the ends of its interval; None without values."""

    mean: float | None
    low: float | None
    high: float | None
    number: int

    @property
    def ends(self) -> list[float] | None:
        """Lower and upper end."""
        return None if self.low is None or self.high is None else [self.low, self.high]


def bootstrap_mean(values: Sequence[float], groups: Sequence) -> Interval:
    """Mean and its 95 % percentile interval over bootstrap samples of whole groups.

    Args:
        values: numbers [n].
        groups: group of each value [n], for instance its map.
    """
    if not len(values):
        return Interval(None, None, None, 0)
    which = np.unique(np.asarray(groups, dtype=str), return_inverse=True)[1]
    sums, numbers = np.bincount(which, weights=values), np.bincount(which)
    drawn = np.random.default_rng(0).integers(len(sums), size=(RESAMPLES, len(sums)))
    means = sums[drawn].sum(axis=1) / numbers[drawn].sum(axis=1)
    low, high = np.quantile(means, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return Interval(float(np.mean(values)), float(low), float(high), len(values))


def geometric_mean_ratio(over: Sequence[float], under: Sequence[float], groups: Sequence) -> Interval:
    """Geometric mean of ``over / under`` pair by pair, with an interval as from `bootstrap_mean`."""
    found = bootstrap_mean(np.log(np.asarray(over, float)) - np.log(np.asarray(under, float)), groups)
    if found.mean is None:
        return found
    return Interval(*(round(float(np.exp(value)), 4) for value in found[:3]), found.number)
