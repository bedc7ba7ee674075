"""Robot state at moments in a motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hdsp.base.short_repr import short_repr


@dataclass(frozen=True, eq=False)
class MotionState:
    """Robot at one or several moments in a motion (``Motion.at``).

    Convention: as in ``Motion``; ``...`` is the shape that ``time`` has, () for one moment.

    Attributes:
        time: float64 [...], s from the start.
        base: float64 [..., 6]: x, y, z, roll, pitch, heading; m and rad. The heading does not jump at full turns.
        feet: float64 [..., 4, 3]: x, y, z, m.
        carries: bool [..., 4], ground contact for each foot.
        phase: uint8 [...], index into ``PHASES``.
        action: int64 [...], action index in the plan.
        margin: float64 [...], m, as in ``Motion.margins``.
        base_velocity: float64 [..., 6], derivatives of ``base``, m/s and rad/s.
        feet_velocity: float64 [..., 4, 3], m/s, in the world frame.
        configuration: int64 [...], index: the next configuration.
    """

    time: np.ndarray
    base: np.ndarray
    feet: np.ndarray
    carries: np.ndarray
    phase: np.ndarray
    action: np.ndarray
    margin: np.ndarray
    base_velocity: np.ndarray
    feet_velocity: np.ndarray
    configuration: np.ndarray

    def __repr__(self) -> str:
        return short_repr(self)
