"""A robot in a viser scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from hdsp.robot.robot import Robot
from hdsp.robot.urdf import wheel_radius
from hdsp.viz.palette import FEET
from hdsp.viz.viewer.robot_pose import link_length, parts, trunk
from hdsp.viz.viewer.textures import rgb

_BASE = "#4C6A92"
_LINK = "#B8BEC6"
_NOSE, _RUBBER = "#E69F00", "#303030"
_WIDTHS = 0.055, 0.04  # m, of thigh and shank
_TYRE = 0.07  # m, width of a wheel


class RobotNodes:
    """The nodes of a robot: base, legs and wheels.

    Args:
        scene: the scene of a viser server.
        name: name of the node above all parts.
        robot: the robot.
        color: colour of the base; None: the usual one.
        opacity: opacity of all parts; None: opaque.

    Attributes:
        placed: poses of all moving parts, [7] each, the base first; empty before ``place``.
    """

    def __init__(self, scene: Any, name: str, robot: Robot, color: str | None = None, opacity: float | None = None):
        self.robot = robot
        self.placed: list[np.ndarray] = []
        self.root = scene.add_frame(name, show_axes=False)
        look = {"opacity": opacity, "cast_shadow": opacity is None, "receive_shadow": False}
        self._base = scene.add_frame(f"{name}/base", show_axes=False)
        boxes = trunk(robot)
        for k, box in enumerate(boxes):
            shade = rgb(_NOSE if color is None and k > 0 else color or _BASE)
            scene.add_box(f"{name}/base/{k}", shade, box.size, position=box.center, **look)
        if len(boxes) == 1:  # the front end of a symmetric base
            size, center = boxes[0]
            front = (center[0] + size[0] / 2, 0.0, center[2])
            scene.add_box(f"{name}/base/front", rgb(color or _NOSE), (0.03, 0.1, 0.04), position=front, **look)
        length, radius = link_length(robot), wheel_radius(robot)
        self._links = [
            scene.add_box(f"{name}/leg_{foot}_{k}", rgb(color or _LINK), (length, width, width), **look)
            for foot in range(4)
            for k, width in enumerate(_WIDTHS)
        ]
        self._wheels = []
        for foot in range(4):
            wheel = f"{name}/wheel_{foot}"
            self._wheels.append(scene.add_frame(wheel, show_axes=False))
            hub = rgb(color or FEET[foot])
            scene.add_cylinder(f"{wheel}/tyre", radius, _TYRE, rgb(color or _RUBBER), radial_segments=24, **look)
            scene.add_cylinder(f"{wheel}/hub", 0.45 * radius, 1.15 * _TYRE, hub, **look)
            scene.add_box(f"{wheel}/mark", hub, (1.5 * radius, 1.1 * _TYRE, 0.2 * radius), **look)

    def place(self, base: np.ndarray, feet: np.ndarray, rolled: np.ndarray | None = None) -> None:
        """Moves the robot to a configuration; arguments as for `robot_pose.parts`."""
        found = parts(self.robot, base, feet, rolled)
        self.placed = [found.base, *found.links.reshape(-1, 7), *found.wheels]
        for node, pose in zip((self._base, *self._links, *self._wheels), self.placed, strict=True):
            node.position, node.wxyz = pose[:3], pose[3:]

    def remove(self) -> None:
        """Removes the robot from its scene."""
        self.root.remove()
