"""The absence of a path, as figures and the browser draw it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class Mark(NamedTuple):
    """A cause of a failure to draw.

    Attributes:
        place: (x, y), m.
        label: the cause in a few words.
        pose: detailed state [7] that the cause makes invalid; None without one.
    """

    place: tuple[float, float]
    label: str
    pose: tuple[float, ...] | None = None


class Failure(NamedTuple):
    """The absence of a path to draw.

    Attributes:
        marks: causes.
        reached: bool [nx, ny], cells of the base in reach; None if unknown.
        nearest: detailed state [7] in reach that is nearest to the goal; None without one.
        distance: distance of this state from the goal, m.
    """

    marks: Sequence[Mark] = ()
    reached: np.ndarray | None = None
    nearest: tuple[float, ...] | None = None
    distance: float = 0.0
