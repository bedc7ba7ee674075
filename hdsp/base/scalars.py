"""Single numbers as users give them: of Python or numpy, no texts, no truth values."""

from __future__ import annotations

import math
from numbers import Integral, Real
from typing import Any

import numpy as np


def scalar(value: Any) -> Any:
    """Returns the Python value of a numpy scalar, or another value as it is; None for a truth value."""
    if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.ndim == 0):
        value = value.item()
    return None if isinstance(value, bool) else value


def real(value: Any) -> float:
    """Returns a number as float: inf beyond the range of float; NaN for everything that is no number."""
    found = scalar(value)
    if not isinstance(found, Real):
        return math.nan
    try:
        return float(found)
    except OverflowError:
        return math.inf if found > 0 else -math.inf  # type: ignore[operator]


def integer(value: Any) -> int | None:
    """Returns a whole number as int, also a float like ``1e6``; None for everything else."""
    found = scalar(value)
    if isinstance(found, float) and found.is_integer():
        return int(found)
    return int(found) if isinstance(found, Integral) else None


def integers(values: Any, count: int) -> tuple[int, ...] | None:
    """Returns so many whole numbers as int, each as in `integer`; None for everything else."""
    try:
        found = tuple(number for value in values if (number := integer(value)) is not None)
        return found if len(found) == len(values) == count else None
    except TypeError:  # neither a sequence nor an array
        return None
