"""A spinning multi-beam lidar that is carried through a world.

The model follows the paper's sensor: a Velodyne Puck (16 beams within +-15 degrees around its spinning plane) at the
robot's head. The Puck lies on its side: its spin axis is horizontal. A motor rotates it about the vertical, so the
beams sweep the whole sphere.

Convention: world coordinates, m, rad, s. Ranges are measured along the beams, and only ranges have noise.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from hdsp.base.errors import InputError
from hdsp.base.settings import Count, NotNegative, Positive, checked
from hdsp.terrain.simulation.mujoco_world import MujocoWorld


@checked
class Lidar:
    """A sensor and its motion.

    Attributes:
        beams: number of beams, evenly spread over +- ``opening`` rad around the spinning plane.
        azimuth_step: angle between two measurements by one beam, rad.
        spin: revolutions per second.
        swing: angular velocity of the motor about the vertical, rad/s.
        noise: standard deviation of a range, m.
        max_range: m.
        height: sensor height above the ground, m. Momaro's head is at about this height when it drives.
        blind: beams within this angle around the downward direction hit the robot itself and are dropped, rad.
        speed: speed of the robot during a scan, m/s.

    Raises:
        InputError: if a value is out of range.
    """

    beams: Count = 16
    opening: Annotated[float, Field(gt=0, lt=math.pi / 2)] = math.radians(15)
    azimuth_step: Annotated[float, Field(gt=0, le=math.pi)] = math.radians(0.4)
    spin: Positive = 10.0
    swing: NotNegative = 1.5
    noise: NotNegative = 0.03
    max_range: Positive = 30.0
    height: Positive = 1.6
    blind: NotNegative = math.radians(25)
    speed: Positive = 0.4

    def directions(self, swing_angle: float) -> np.ndarray:
        """Beam directions during one revolution, float64 [n, 3], length 1; the motor angle is ``swing_angle``."""
        around = np.arange(0, 2 * math.pi - 1e-9, self.azimuth_step)[:, None]
        off = np.linspace(-self.opening, self.opening, self.beams) if self.beams > 1 else np.zeros(1)
        # In the frame of the motor the sensor spins in the plane of y and z, about x.
        sideways, up = np.cos(off) * np.cos(around), np.cos(off) * np.sin(around)
        ahead = np.broadcast_to(np.sin(off), up.shape)
        c, s = math.cos(swing_angle), math.sin(swing_angle)
        beams = np.stack([c * ahead - s * sideways, s * ahead + c * sideways, up], axis=-1).reshape(-1, 3)
        return beams[beams[:, 2] > -math.cos(self.blind)]


class Cloud(NamedTuple):
    """Points from a scan, registered by the known sensor poses.

    Attributes:
        points: float32 [n, 3], m, world.
        origins: float32 [n, 3], sensor position for each point.
    """

    points: np.ndarray
    origins: np.ndarray


def scan(world: MujocoWorld, path: np.ndarray, lidar: Lidar, random: np.random.Generator) -> Cloud:
    """Carries the sensor along a path and measures continuously.

    Args:
        world: the scanned world.
        path: float [n, 2], corners (x, y) of the sensor's path over the ground, m.
        lidar: the sensor.
        random: random generator for the noise.

    Raises:
        InputError: if the path is empty or leaves the arena.
    """
    stations = along(path, lidar.speed / lidar.spin)
    size = world.arena.size
    if not ((stations > 0) & (stations < size)).all():
        raise InputError(f"scan: the path leaves the arena of {size} x {size} m")
    ground = world.arena.scene.heights_at(*stations.T)
    highest = max((block.height for block in world.arena.blocks()), default=0.0)
    points, origins = [], []
    for turn, ((x, y), floor) in enumerate(zip(stations, ground, strict=True)):
        origin = np.array([x, y, floor + lidar.height])
        beams = lidar.directions(turn / lidar.spin * lidar.swing)
        if highest <= origin[2]:
            beams = beams[beams[:, 2] < 0]  # horizontal and rising beams hit nothing
        ranges = world.ranges(origin, beams, lidar.max_range)
        hit = np.isfinite(ranges)
        measured = ranges[hit] + random.normal(0.0, lidar.noise, int(hit.sum()))
        points.append((origin + beams[hit] * measured[:, None]).astype(np.float32))
        origins.append(np.broadcast_to(origin.astype(np.float32), points[-1].shape))
    return Cloud(np.concatenate(points), np.concatenate(origins))


def along(path: np.ndarray, spacing: float) -> np.ndarray:
    """Points (x, y) along a polyline, float64 [n, 2], every ``spacing`` m from its first corner.

    Raises:
        InputError: if the path is not [n, 2] finite numbers with n >= 1.
    """
    path = np.asarray(path, float)
    if path.ndim != 2 or path.shape[1:] != (2,) or len(path) == 0 or not np.isfinite(path).all():
        raise InputError(f"path of shape {path.shape}; need finite [n, 2], n >= 1: x, y in m")
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    stations = np.arange(0.0, way[-1] + 1e-9, spacing)
    return np.stack([np.interp(stations, way, path[:, axis]) for axis in (0, 1)], axis=-1)
