"""Configurations of a robot over time, for playback."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hdsp.detailed.motion.motion import Motion
from hdsp.robot.robot import Robot
from hdsp.robot.urdf import wheel_radius
from hdsp.terrain.height_map import HeightMap
from hdsp.viz.viewer.robot_pose import standing

# Speeds through the states of a plan, which has no times: m/s of feet, m/s and rad/s of the base.
_FOOT, _BASE, _TURN = 0.5, 0.4, 0.6
_LEAST = 0.02  # s, from one state to the next
_SAMPLE = 0.04  # s, between two samples of a motion


class Timeline(NamedTuple):
    """Configurations at moments, linear between them.

    Attributes:
        times: float64 [n], s, from 0 on.
        base: float64 [n, 6]: x, y, z, roll, pitch, heading (continuous).
        feet: float64 [n, 4, 3].
        rolled: float64 [n, 4], angles by which the wheels have turned, rad.
    """

    times: np.ndarray
    base: np.ndarray
    feet: np.ndarray
    rolled: np.ndarray

    @property
    def duration(self) -> float:
        """Time of the last configuration, s."""
        return float(self.times[-1])

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns base [6], feet [4, 3] and wheel angles [4] at a time in s; the ends hold before and after."""
        k = int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.times) - 1))
        after = min(k + 1, len(self.times) - 1)
        length = self.times[after] - self.times[k]
        share = float(np.clip((time - self.times[k]) / length, 0.0, 1.0)) if length > 0 else 0.0
        base, feet, rolled = ((1 - share) * v[k] + share * v[after] for v in (self.base, self.feet, self.rolled))
        return base, feet, rolled


def timeline_of_states(terrain: HeightMap, robot: Robot, states: np.ndarray) -> Timeline:
    """Returns the timeline of a robot that stands in each state of a plan, float64 [n, 7]."""
    base, feet = standing(terrain, robot, states)
    base[:, 5] = np.unwrap(base[:, 5])
    moved = np.diff(feet, axis=0)
    seconds = np.stack([
        np.linalg.norm(moved, axis=2).max(axis=1) / _FOOT,
        np.linalg.norm(np.diff(base[:, :3], axis=0), axis=1) / _BASE,
        abs(np.diff(base[:, 5])) / _TURN,
        np.full(len(moved), _LEAST),
    ]).max(axis=0)  # fmt: skip
    times = np.concatenate([[0.0], np.cumsum(seconds)])
    return _timeline(robot, times, base, feet, np.ones(feet.shape[:2], bool))


def timeline_of_motion(motion: Motion) -> Timeline:
    """Returns the timeline of a motion, with its times."""
    times = np.linspace(0.0, motion.duration, max(2, int(np.ceil(motion.duration / _SAMPLE)) + 1))
    state = motion.at(times)
    base = np.array(state.base)
    base[:, 5] = np.unwrap(base[:, 5])
    return _timeline(motion.robot, times, base, state.feet, state.carries)


def _timeline(robot: Robot, times: np.ndarray, base: np.ndarray, feet: np.ndarray, carries: np.ndarray) -> Timeline:
    moved = np.diff(feet, axis=0)
    ahead = np.stack([np.cos(base[1:, 5]), np.sin(base[1:, 5])], axis=1)
    rolling = np.einsum("nfi,ni->nf", moved[..., :2], ahead) * (carries[1:] & carries[:-1])
    rolled = np.cumsum(np.concatenate([np.zeros((1, 4)), rolling]), axis=0) / wheel_radius(robot)
    return Timeline(times, base, feet, rolled)
