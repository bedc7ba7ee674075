"""A pose that a user drags over the ground: x, y and heading, with a see-through robot."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from hdsp.detailed.motion.local_motion import Place, local_place, relative_map, relative_points
from hdsp.robot.lattice import rotation
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.viz.viewer.robot_nodes import RobotNodes
from hdsp.viz.viewer.robot_pose import standing

_OPACITY = 0.4
_WORDS = 0.5  # m, of the label above the hips


class PoseHandle:
    """A handle in a viser scene, on the ground: two arrows, a square between them, and a ring for the heading.

    Its node is relative to `local_place`, as those of `hdsp.viz.viewer.plan_scene`.

    Args:
        scene: the scene of a viser server.
        name: node name.
        words: label beside the handle.
        color: colour of the robot.
        released: called with (x, y, heading) in m and rad after a drag, in a thread of viser.
    """

    def __init__(
        self, scene: Any, name: str, words: str, color: str, released: Callable[[tuple[float, float, float]], None]
    ):
        self.name, self.color, self._scene, self._released = name, color, scene, released
        self.control = scene.add_transform_controls(
            name, scale=0.7, active_axes=(True, True, False), depth_test=False, visible=False
        )
        self._words = scene.add_label(f"{name}/words", words, anchor="bottom-center")
        self._ghost: RobotNodes | None = None
        self._held = False
        self._place: Place = (0.0, 0.0)
        self.control.on_update(self._moved)

    def place(self, terrain: HeightMap, robot: Robot, pose: np.ndarray) -> None:
        """Moves the handle to a pose (x, y, heading) or a state with 7 values, onto the ground.

        A handle in a user's hand stays there.
        """
        if self._held:
            return
        self._place = local_place(terrain)
        terrain = relative_map(terrain, self._place)
        state = relative_points(np.concatenate([np.asarray(pose, float), np.zeros(7 - len(pose))]), self._place)
        base, feet = (rows[0] for rows in standing(terrain, robot, state))
        level = float(feet[:, 2].mean())
        self.control.visible = True
        self.control.position = (state[0], state[1], level)
        self.control.wxyz = (math.cos(state[2] / 2), 0.0, 0.0, math.sin(state[2] / 2))
        if self._ghost is None or self._ghost.robot is not robot:
            if self._ghost is not None:
                self._ghost.remove()
            self._ghost = RobotNodes(self._scene, f"{self.name}/robot", robot, self.color, _OPACITY)
        ahead = feet.copy()
        ahead[:, :2] = (feet[:, :2] - state[:2]) @ rotation(float(state[2]))
        ahead[:, 2] -= level
        self._words.position = (0.0, 0.0, base[2] - level + _WORDS)
        self._ghost.place(np.array([0.0, 0.0, base[2] - level, base[3], base[4], 0.0]), ahead)

    def pose(self) -> tuple[float, float, float]:
        """Returns (x, y, heading) in m and rad."""
        x, y, _ = self.control.position
        w, _, _, z = self.control.wxyz
        return float(x) + self._place[0], float(y) + self._place[1], math.remainder(2 * math.atan2(z, w), 2 * math.pi)

    def _moved(self, event: Any) -> None:
        self._held = event.phase != "end"
        if not self._held:
            self._released(self.pose())
