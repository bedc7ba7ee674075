"""A motion for a follower: states at regular times, heights of wheels at edges, directions of the wheels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hdsp.detailed.motion.motion import Motion
from hdsp.detailed.motion.phases import PHASES

#: Largest time between two states, s.
STEP = 0.01
_ROUND = 9  # points along a wheel's lower half
_RESTS = 0.004  # m/s; a slower wheel has no direction


class Wanted(NamedTuple):
    """Wanted state at one moment; arrays as in `MotionState`.

    Attributes:
        base, feet, base_velocity, feet_velocity, carries: as in a motion.
        steering: float64 [4], wheel directions against the heading, rad; either end of a wheel may lead.
        moves: bool [4], whether each wheel rolls.
        left: distance that all wheels still roll without a pause, m.
    """

    base: np.ndarray
    feet: np.ndarray
    base_velocity: np.ndarray
    feet_velocity: np.ndarray
    carries: np.ndarray
    steering: np.ndarray
    moves: np.ndarray
    left: float


class Reference:
    """Sampled motion.

    Attributes:
        duration: s.
        changes: float64 [k], times at which a foot leaves the ground or comes to carry.
    """

    def __init__(self, motion: Motion, radius: float):
        self.duration = motion.duration
        count = max(2, int(np.ceil(self.duration / STEP)) + 1)
        self._times = np.linspace(0.0, self.duration, count)
        state = motion.at(self._times)
        self.base, self.feet = state.base, state.feet.copy()
        self.base_velocity, self.feet_velocity = state.base_velocity, state.feet_velocity
        self.carries, self.phase, self.action = state.carries, state.phase, state.action
        changed = (self.carries[1:] != self.carries[:-1]).any(axis=1)
        self.changes = self._times[1:][changed]
        self._directions()
        self._left = self._ways_left()
        self._rise(motion, radius)

    def _directions(self) -> None:
        """Direction of each wheel against the heading; a wheel at rest takes the next one, then the last one."""
        flat = self.feet_velocity[..., :2]
        speed = np.linalg.norm(flat, axis=2)
        self.moves = self.carries & (speed > _RESTS) & (self.phase == PHASES.index("roll"))[:, None]
        angle = np.arctan2(flat[..., 1], flat[..., 0]) - self.base[:, 5:6]
        self.steering = np.zeros_like(angle)
        for foot in range(4):
            rows = np.flatnonzero(self.moves[:, foot])
            if len(rows):
                following = np.minimum(np.searchsorted(rows, np.arange(len(angle))), len(rows) - 1)
                self.steering[:, foot] = angle[rows[following], foot]

    def _ways_left(self) -> np.ndarray:
        """Distances that the base still covers while all wheels roll, float64 [n], m."""
        way = np.append(np.linalg.norm(np.diff(self.base[:, :2], axis=0), axis=1), 0.0)
        drives = self.moves.all(axis=1)
        total = np.cumsum(way[::-1])[::-1]
        ends = np.where(drives, np.inf, np.arange(len(way)))
        following = np.minimum(np.minimum.accumulate(ends[::-1])[::-1], len(way) - 1).astype(int)
        return np.where(drives, total - total[following], 0.0)

    def _rise(self, motion: Motion, radius: float) -> None:
        """Lifts carrying feet to where a wheel touches the edges before and behind it."""
        off = np.linspace(-radius, radius, _ROUND)
        sunk = radius - np.sqrt(radius**2 - off**2)
        angle = self.steering + self.base[:, 5:6]
        along = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        places = self.feet[..., None, :2] + off[:, None] * along[..., None, :]
        heights = np.asarray(motion.terrain.height_at(places[..., 0], places[..., 1]), float) - sunk
        low = np.where(np.isnan(heights), -np.inf, heights)
        low[low > self.feet[..., 2:] + motion.robot.drive.highest_edge + 0.01] = -np.inf  # a wall beside the foot
        risen = np.maximum(self.feet[..., 2], low.max(axis=2))
        self.feet[..., 2] = np.where(
            self.carries & (self.phase == PHASES.index("roll"))[:, None], risen, self.feet[..., 2]
        )

    def at(self, time: float) -> Wanted:
        """Returns the wanted state at a time, s."""
        row, share = self._row(time)
        base, feet, base_velocity, feet_velocity = (
            (1 - share) * values[row] + share * values[row + 1]
            for values in (self.base, self.feet, self.base_velocity, self.feet_velocity)
        )
        near = row if share < 1e-9 else row + 1
        return Wanted(
            base, feet, base_velocity, feet_velocity, self.carries[near], self.steering[near],
            self.moves[near], float(self._left[near]),
        )  # fmt: skip

    def labels(self, time: float) -> tuple[int, int]:
        """Phase and action at a time."""
        row, share = self._row(time)
        near = row if share < 1e-9 else row + 1
        return int(self.phase[near]), int(self.action[near])

    def _row(self, time: float) -> tuple[int, float]:
        """Sample before a time, and the share of the way to the next one."""
        last = len(self._times) - 1
        place = min(max(time, 0.0), self.duration) / self.duration * last if self.duration else 0.0
        row = min(int(place + 1e-9), last - 1)
        return row, max(place - row, 0.0)
