"""The outcome of a drive in the simulation: success or the cause of failure, and all states over time."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hdsp.base.errors import InputError
from hdsp.base.short_repr import shortened
from hdsp.detailed.motion.local_motion import Place
from hdsp.detailed.motion.motion import Motion
from hdsp.detailed.motion.motion_state import MotionState
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.obstacles import Scene


class Ending(StrEnum):
    """End of a drive."""

    ARRIVED = "arrived"
    SLIPPED = "slipped"
    TIPPED_OVER = "tipped_over"
    FOOT_MISSED = "foot_missed"
    BODY_TOUCHED = "body_touched"
    FORCE_LIMIT = "force_limit"
    LEFT_PLAN = "left_plan"
    OUT_OF_TIME = "out_of_time"


@dataclass(frozen=True, eq=False, repr=False)
class DrivenMotion(Motion):
    """States that were driven, as a motion: every format of motions records them.

    ``carries`` tells which feet the follower loads; ``Run.forces`` has the true ground forces.

    Attributes:
        moments: float64 [n], times of the states, s.
    """

    moments: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def times(self) -> np.ndarray:
        return self.moments

    @cached_property
    def _velocities(self) -> tuple[np.ndarray, np.ndarray]:
        if len(self) == 1:  # the drive ended at once
            return np.zeros_like(self.base), np.zeros_like(self.feet)
        unwrapped = self.base.copy()
        unwrapped[:, 3:] = np.unwrap(unwrapped[:, 3:], axis=0)
        return tuple(np.gradient(values, self.moments, axis=0) for values in (unwrapped, self.feet))  # type: ignore

    def at(self, time: ArrayLike) -> MotionState:
        """Returns the recorded state nearest to each time, s of any shape.

        Raises:
            InputError: a time that is no number.
        """
        given = self._numbers(time)
        if np.isnan(given).any():
            raise InputError(f"time nan s: the drive lasts from 0 to {self.duration:.6g} s")
        step = self.moments[1] - self.moments[0] if len(self) > 1 else 0.0
        row = np.clip(np.searchsorted(self.moments, given - 0.5 * step), 0, len(self) - 1)
        base_velocity, feet_velocity = self._velocities
        return MotionState(
            given, self.base[row], self.feet[row], self.carries[row], self.phase[row], self.action[row],
            self._margins[row], base_velocity[row], feet_velocity[row], row,
        )  # fmt: skip

    @cached_property
    def _margins(self) -> np.ndarray:
        return self.margins()


@dataclass(frozen=True, eq=False)
class Run:
    """A drive along a plan in the simulation.

    Convention: SI units in the world frame; feet in the order of ``hdsp.robot.robot.FEET``.

    Attributes:
        ending: how it ended.
        cause: the end in words.
        motion: the driven states, 50 per second; ``save`` writes them.
        planned: the motion that the robot followed.
        progress: float64 [n], moment of the planned motion in each state, s.
        forces: float64 [n, 4, 3], ground forces on the wheels, N.
        slip: float64 [4], largest displacement of each foot while it stood, m.
        least_margin: least distance of the centre of mass, legs included, inside the polygon of the feet that carry, m.
        energy: mechanical work of the motors, J; braking returns nothing.
        distance, turn: from the end of the planned motion, m and rad.
        ground: the ground that was driven on.
        positions: float32 [n, number of coordinates], MuJoCo's ``qpos`` in each state, relative to ``place``.
        place: world position (x, y) of the simulation's origin, m.
    """

    ending: Ending
    cause: str
    motion: DrivenMotion
    planned: Motion = field(repr=False)
    progress: np.ndarray = field(repr=False)
    forces: np.ndarray = field(repr=False)
    slip: np.ndarray
    least_margin: float
    energy: float
    distance: float
    turn: float
    ground: HeightMap | Scene = field(repr=False)
    positions: np.ndarray = field(repr=False)
    place: Place

    def __repr__(self) -> str:
        return shortened(f"Run({self.cause}, {self.duration:.1f} s, {self.energy:.0f} J)")

    @property
    def success(self) -> bool:
        """Whether the robot arrived within 10 cm and 10 degrees, without a fault on the way."""
        return self.ending is Ending.ARRIVED

    @property
    def duration(self) -> float:
        """Duration of the drive, s."""
        return float(self.motion.moments[-1])

    def save(self, path: str | Path, rate: float = 50.0) -> Path:
        """Writes the drive, whole or not at all; the suffix names the format.

        ``.gif`` and ``.mp4`` are pictures by MuJoCo. All other formats are those of ``Motion.save``: ``.mcap`` for
        Foxglove, ``.csv``, ``.json``, ``.npz``, and a path without a suffix for a ROS 2 bag.

        Raises:
            InputError: another suffix, a path that cannot be written, or a missing extra.
        """
        if Path(path).suffix.lower() in (".gif", ".mp4"):
            from hdsp.planning.driving.drive_film import save_film

            return save_film(self, path)
        return self.motion.save(path, rate)

    def facts(self) -> dict[str, Any]:
        """Returns the verdict for a JSON document."""
        return {
            "ending": str(self.ending),
            "success": self.success,
            "cause": self.cause,
            "duration": self.duration,
            "planned_duration": self.planned.duration,
            "distance": self.distance,
            "turn": self.turn,
            "slip": self.slip.tolist(),
            "least_margin": self.least_margin,
            "energy": self.energy,
        }


def checked_ground(terrain: Any) -> HeightMap | Scene:
    """Returns the ground to drive on: a height map, a scene, or the scene of an arena.

    Raises:
        InputError: something else.
    """
    ground = getattr(terrain, "scene", terrain)
    if not isinstance(ground, HeightMap | Scene):
        raise InputError(f"terrain is {type(terrain).__name__}; need a HeightMap, a Scene or an Arena")
    return ground
