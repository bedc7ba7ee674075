"""The pose that a follower believes: wheel odometry, corrected by measured poses with noise.

An inertial unit measures roll, pitch and all rates. Wheels and legs give the velocity. Position and heading come from a
measurement several times a second, as from a camera or a lidar, with noise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

_EVERY = 0.1  # s, between two measured poses
_NOISE = 0.01, 0.01  # m, rad; standard deviations of a measured pose
_TRUST = 0.15  # share of a measured difference that is believed


class BasePose(NamedTuple):
    """Base in the world frame.

    Attributes:
        place: float64 [3], m.
        rotation: float64 [3, 3], from the base frame to the world frame.
        velocity: float64 [3], m/s.
        turn_rate: float64 [3], rad/s, world frame.
    """

    place: np.ndarray
    rotation: np.ndarray
    velocity: np.ndarray
    turn_rate: np.ndarray


class PoseEstimate:
    """Estimates the base pose from odometry and measurements.

    Args:
        place: first position, float64 [3], m.
        random: source of the noise.
    """

    def __init__(self, place: np.ndarray, random: np.random.Generator):
        self._random, self._place, self._turned, self._since = random, place.copy(), 0.0, 0.0

    def update(self, true: BasePose, odometry: np.ndarray, elapsed: float) -> BasePose:
        """Returns the new estimate.

        Args:
            true: the true pose, for inertial unit and measurement.
            odometry: float64 [3], velocity from wheels and legs, m/s.
            elapsed: s since the last call.
        """
        self._place += odometry * elapsed
        self._since += elapsed
        if self._since >= _EVERY:
            self._since -= _EVERY
            measured = true.place + self._random.normal(0.0, _NOISE[0], 3)
            self._place += _TRUST * (measured - self._place)
            self._turned += _TRUST * (self._random.normal(0.0, _NOISE[1]) - self._turned)
        cos, sin = np.cos(self._turned), np.sin(self._turned)
        turn = np.array([(cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)])
        return BasePose(self._place.copy(), turn @ true.rotation, odometry, true.turn_rate)
