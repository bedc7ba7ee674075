"""A robot as triangles: base, two links for each leg, and wheels."""

from __future__ import annotations

import numpy as np

from hdsp.robot.robot import Robot
from hdsp.robot.urdf import wheel_radius
from hdsp.viz.palette import FEET, ORANGE, VERMILLION
from hdsp.viz.recordings.track import Track
from hdsp.viz.recordings.z_buffer import Triangles
from hdsp.viz.viewer.robot_pose import link_length, trunk
from hdsp.viz.viewer.textures import rgb

_BASE, _LINK, _RUBBER = "#4C6A92", "#AEB6C0", "#34373B"
_WIDTHS = 0.06, 0.045  # m, of thigh and shank
_TYRE = 0.07  # m, width of a wheel
_SIDES = 20  # of a wheel

_CUBE = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_QUADS = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
_FACES = np.concatenate([_QUADS[:, [0, 1, 2]], _QUADS[:, [0, 2, 3]]])


class RobotMesh:
    """Robot triangles for a track's states."""

    def __init__(self, track: Track):
        self._track, robot = track, track.motion.robot
        self._trunk = [(_box(*trunk(robot)[0]), _BASE), (_nose(robot), ORANGE)]
        self._links = [_box((link_length(robot), width, width)) for width in _WIDTHS]
        radius = wheel_radius(robot)
        self._tyre, self._hub = _cylinder(radius, _TYRE), _cylinder(0.5 * radius, 1.15 * _TYRE)
        self._spoke = _box((1.5 * radius, 1.18 * _TYRE, 0.18 * radius))

    def at(self, k: int) -> Triangles:
        """Returns the triangles in state ``k``; a wheel in the air has another colour."""
        from scipy.spatial.transform import Rotation

        track = self._track
        base = track.state.base[k, :3], Rotation.from_quat(track.quaternions[k]).as_matrix()
        found = [(_placed(shape, *base), color) for shape, color in self._trunk]
        legs = Rotation.from_quat(track.legs[k, ..., 3:].reshape(-1, 4)).as_matrix()
        wheels = Rotation.from_quat(track.wheels[k, :, 3:]).as_matrix()
        for foot in range(4):
            for link, shape in enumerate(self._links):
                found.append((_placed(shape, track.legs[k, foot, link, :3], legs[2 * foot + link]), _LINK))
            place, turn = track.wheels[k, foot, :3], wheels[foot]
            tyre = _RUBBER if track.state.carries[k, foot] else VERMILLION
            found += [(_placed(self._tyre, place, turn), tyre), (_placed(self._hub, place, turn), FEET[foot])]
            found.append((_placed(self._spoke, place, turn), FEET[foot]))
        colors = [np.broadcast_to(np.array(rgb(color)) / 255, (len(shape), 3)) for shape, color in found]
        return Triangles(np.concatenate([shape for shape, _ in found]), np.concatenate(colors))


def _placed(shape: np.ndarray, place: np.ndarray, turn: np.ndarray) -> np.ndarray:
    return shape @ turn.T + place


def _box(size: tuple[float, float, float], center: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Cuboid triangles, float64 [12, 3, 3]."""
    return (_CUBE * size + center)[_FACES]


def _nose(robot: Robot) -> np.ndarray:
    """A mark at the base's front end."""
    (length, width, height), (x, y, z) = trunk(robot)[0]
    return _box((0.03, 0.5 * width, 0.35 * height), (x + length / 2 + 0.015, y, z))


def _cylinder(radius: float, width: float) -> np.ndarray:
    """Triangles for a cylinder about the y axis, float64 [4 _SIDES, 3, 3]."""
    angles = np.linspace(0, 2 * np.pi, _SIDES + 1)
    ring = np.stack([radius * np.cos(angles), np.zeros_like(angles), radius * np.sin(angles)], axis=1)
    left, right = ring + (0, width / 2, 0), ring - (0, width / 2, 0)
    a, b, c, d = left[:-1], left[1:], right[1:], right[:-1]
    middle = np.zeros_like(a)
    sides = [np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]
    caps = [np.stack([middle + (0, width / 2, 0), b, a], axis=1), np.stack([middle - (0, width / 2, 0), d, c], axis=1)]
    return np.concatenate([*sides, *caps])
