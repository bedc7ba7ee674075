"""Times along a motion: a fast way through its configurations within the robot's speeds and accelerations.

The path runs in straight lines through the configurations. Parabolas round its corners, at most half-way to the
neighbours, and within ``_NEAR`` around the configuration. The path parameter s is the time that the robot needs at full
speed, so the speed along the path is at most 1. The robot stops only where a foot leaves or touches the ground.

A backward and a forward pass over all path pieces give the speeds, as in time-optimal path parametrisation. In
a parabola, the acceleration across the path takes at most ``_ACROSS`` times its limit; the acceleration along
the path gets the rest. All limits therefore hold at each moment, but the motion is not quite the fastest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hdsp.detailed.motion.rounded_path import RoundedPath
from hdsp.robot.robot import Robot

_NEAR = 0.0015, 0.003  # m, rad; largest distance of the path from a configuration
_ACROSS = 0.6
_RESTS = 1e-7  # m, rad; smaller changes come from rounding, in coordinates of a survey, too


class Timing:
    """Motion times, and points at any time.

    A point holds base x, y, z, roll, pitch, heading, and the feet's x, y, z in turn, float64 [18], m and rad.

    Attributes:
        times: float64 [n], s, at which the path passes each configuration: from 0 on, never falling.
    """

    def __init__(self, base: np.ndarray, feet: np.ndarray, carries: np.ndarray, robot: Robot):
        """Gives configurations their times.

        Args:
            base: float64 [n, 6]: x, y, z, roll, pitch, heading.
            feet: float64 [n, 4, 3].
            carries: bool [n, 4], whether a foot stands on the ground.
            robot: the robot with the limits.
        """
        points = np.concatenate([base, feet.reshape(len(base), 12)], axis=1)
        points[:, 3:6] = np.unwrap(points[:, 3:6], axis=0)
        moves = (np.abs(np.diff(points, axis=0)) > _RESTS).any(axis=1)
        vertex = np.concatenate([[0], np.cumsum(moves)])  # of each configuration
        points, carried = points[np.concatenate([[True], moves])], carries[1:][moves]
        stops = np.zeros(len(points), bool)
        stops[vertex[:-1][np.diff(carries, axis=0).any(axis=1)]] = True
        stops[[0, -1]] = True
        limits = _Limits(robot, points, carried)
        self._path = RoundedPath(points, limits.length, limits.radius(points, carried, stops))
        self._profile(*limits.pieces(self._path))
        self.times = self._time_at(self._path.at)[vertex]

    def __call__(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns points and velocities, float64 [k, 18] each, at times [k] (s)."""
        piece = np.clip(np.searchsorted(self._time, times, side="right") - 1, 0, len(self._gain) - 1)
        since = times - self._time[piece]
        s = self._s[piece] + since * (self._speed[piece] + 0.5 * self._gain[piece] * since)
        points, slopes = self._path(s)
        return points, slopes * (self._speed[piece] + self._gain[piece] * since)[:, None]

    def _profile(self, length: np.ndarray, fastest: np.ndarray, gain: np.ndarray) -> None:
        """Speeds up, cruises and brakes in each piece: its length, its largest squared speed and acceleration in s."""
        most = np.zeros(len(length) + 1)  # at the ends of the pieces
        most[1:-1] = np.minimum(fastest[:-1], fastest[1:])
        rise, square = (2 * gain * length).tolist(), most.tolist()
        for k in reversed(range(len(rise))):
            square[k] = min(square[k], square[k + 1] + rise[k])
        for k in range(len(rise)):
            square[k + 1] = min(square[k + 1], square[k] + rise[k])
        start, end = np.array(square[:-1]), np.array(square[1:])
        top = np.maximum(np.minimum(fastest, 0.5 * (start + end) + gain * length), np.maximum(start, end))
        up, down = (top - start) / (2 * gain), (top - end) / (2 * gain)
        parts = np.stack([up, np.maximum(length - up - down, 0.0), down], axis=1).ravel()
        before = np.sqrt(np.stack([start, top, top], axis=1)).ravel()
        after = np.sqrt(np.stack([top, top, end], axis=1)).ravel()
        moves = parts > 1e-12
        parts, before, after = parts[moves], before[moves], after[moves]
        spent = 2 * parts / (before + after)
        self._time = np.concatenate([[0.0], np.cumsum(spent)])
        self._s = np.concatenate([[0.0], np.cumsum(parts)])
        self._speed, self._gain = before, (after - before) / spent
        if not len(parts):  # the motion rests
            self._speed = self._gain = np.zeros(1)

    def _time_at(self, s: np.ndarray) -> np.ndarray:
        """Times (s) at path parameters."""
        piece = np.clip(np.searchsorted(self._s, s, side="right") - 1, 0, len(self._gain) - 1)
        far = np.clip(s - self._s[piece], 0.0, None)
        speed = self._speed[piece]
        reached = speed + np.sqrt(np.maximum(speed**2 + 2 * self._gain[piece] * far, 0.0))
        taken = np.divide(2 * far, reached, out=np.zeros_like(far), where=reached > 0)
        return np.minimum(self._time[piece] + taken, self._time[-1])


class _Quantity(NamedTuple):
    """A quantity with limits: values [m, d] at points; largest speed and acceleration, [m - 1] or the same anywhere."""

    values: np.ndarray
    speed: np.ndarray | float
    acceleration: np.ndarray | float


class _Limits:
    """Limits along a path.

    Attributes:
        length: float64 [m - 1], s: time for each line at full speed.
    """

    def __init__(self, robot: Robot, points: np.ndarray, carried: np.ndarray):
        steps, limits = [], []
        for quantity in _quantities(robot, points, carried):
            steps.append(np.linalg.norm(np.diff(quantity.values, axis=0), axis=1))
            limits.append(quantity)
        lines = steps[0].shape
        self._quantities = limits
        self.length = np.max([step / q.speed for step, q in zip(steps, limits, strict=True)], axis=0)
        self._slope = np.stack(steps) / self.length
        self._most = np.stack([np.broadcast_to(q.acceleration, lines) for q in limits])

    def radius(self, points: np.ndarray, carried: np.ndarray, stops: np.ndarray) -> np.ndarray:
        """Radii for a ``RoundedPath``."""
        radius = np.zeros(len(points))
        bent = np.diff(np.diff(points, axis=0) / self.length[:, None], axis=0)
        near = np.full(18, _NEAR[0])
        near[3:6] = _NEAR[1]
        far = np.abs(bent) / near
        far[:, 8::3] *= ~(carried[:-1] & carried[1:])  # ground under rolling feet has steps from cell to cell
        widest = 4 / np.maximum(far.max(axis=1, initial=0.0), 1e-9)
        radius[1:-1] = np.minimum(0.5 * np.minimum(self.length[:-1], self.length[1:]), widest)
        radius[stops] = 0.0
        return radius

    def pieces(self, path: RoundedPath) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Lines and parabolas in turn: length, largest squared speed, largest acceleration, all in s."""
        lines, arcs = path.pieces()
        slopes = [np.diff(q.values, axis=0) / self.length[:, None] for q in self._quantities]
        bends = np.stack([np.linalg.norm(np.diff(slope, axis=0), axis=1) for slope in slopes])
        with np.errstate(divide="ignore", invalid="ignore"):
            most = np.maximum(self._most[:, :-1], self._most[:, 1:])
            steep = np.maximum(self._slope[:, :-1], self._slope[:, 1:])
            curvature = bends / arcs
            fastest = np.minimum((_ACROSS * most / curvature).min(axis=0, initial=np.inf), 1.0)
            gain = ((most - curvature * fastest) / steep).min(axis=0, initial=np.inf)
            straight = (self._most / self._slope).min(axis=0)
        stopped = arcs == 0
        fastest[stopped], gain[stopped] = 0.0, 1.0
        return _alternately(lines, arcs), _alternately(np.ones(len(lines)), fastest), _alternately(straight, gain)


def _quantities(robot: Robot, points: np.ndarray, carried: np.ndarray) -> list[_Quantity]:
    """Quantities with limits along a path through points [m, 18]; carried [m - 1, 4] holds for its lines."""
    speeds, accelerations = robot.speeds, robot.accelerations
    base, feet = points[:, :6], points[:, 6:].reshape(-1, 4, 3)
    rolls = carried & (np.abs(np.diff(feet[..., :2], axis=0)) > _RESTS).any(axis=2)
    driving = rolls.any(axis=1)
    found = [
        _Quantity(
            base[:, :2],
            np.where(driving, speeds.drive, speeds.shift),
            np.where(driving, accelerations.drive, accelerations.shift),
        ),
        _Quantity(base[:, 2:3], speeds.height, accelerations.height),
        _Quantity(base[:, 3:4], speeds.lean, accelerations.lean),
        _Quantity(base[:, 4:5], speeds.lean, accelerations.lean),
        _Quantity(base[:, 5:6], speeds.turn, accelerations.turn),
    ]
    for foot in range(4):
        relative = from_base(base, feet[:, foot])
        on_ground = carried[:, foot]
        found += [
            _Quantity(
                feet[:, foot, :2],
                np.where(on_ground, speeds.drive, np.inf),
                np.where(on_ground, accelerations.drive, np.inf),
            ),
            _Quantity(relative[:, :2], speeds.foot, accelerations.foot),
            _Quantity(relative[:, 2:], speeds.lift, accelerations.lift),
        ]
    return found


def from_base(base: np.ndarray, points: np.ndarray) -> np.ndarray:
    """World points [n, 3] relative to the base [n, 6], turned by its heading alone, float64 [n, 3]."""
    x, y, z = (points - base[:, :3]).T
    cos, sin = np.cos(base[:, 5]), np.sin(base[:, 5])
    return np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=1)


def _alternately(lines: np.ndarray, arcs: np.ndarray) -> np.ndarray:
    """The first line, then parabolas and lines in turn."""
    result = np.empty(len(lines) + len(arcs))
    result[::2], result[1::2] = lines, arcs
    return result
