"""A terrain, a path over it, and the reasons where there is none, as nodes of a viser scene."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from hdsp.detailed.actions.action import Action
from hdsp.detailed.motion.local_motion import local_place, relative_map, relative_points
from hdsp.detailed.motion.motion import Motion
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.viz.failure_marks import Failure
from hdsp.viz.palette import BLACK, FEET, SKY, VERMILLION
from hdsp.viz.viewer.ground_mesh import Mesh, ground_mesh, surface_of
from hdsp.viz.viewer.robot_nodes import RobotNodes
from hdsp.viz.viewer.robot_pose import standing
from hdsp.viz.viewer.textures import height_colors, mark_colors, rgb, unknown_colors

_ABOVE = 0.012  # m, of layers above the ground
_TRACK = 0.02  # m, of tracks above the ground
_PIN = 0.5  # m, height of the pin at a cause


class PlanScene:
    """Draws into the scene of a viser server.

    Arguments are in world coordinates; nodes are relative to ``place``, because browsers draw in single precision.

    Args:
        server: the server; see `local_server.open_server`.
        terrain: the map.
        robot: the robot.
        aside: distance by which the first view lies to the right of the map's centre, as a share of its size; space
            for a panel at the right.

    Attributes:
        terrain: the map.
        surface: the map with the nearest known heights in unknown cells, as it is drawn.
        place: world position (x, y) of the scene's origin, m.
    """

    def __init__(self, server: Any, terrain: HeightMap, robot: Robot, aside: float = 0.0):
        self._aside = aside
        self.server, self.terrain, self.robot = server, terrain, robot
        self.body: RobotNodes | None = None
        self._layers: dict[str, Any] = {}
        self._groups: dict[str, Any] = {}
        self.draw_terrain(terrain)

    @property
    def scene(self) -> Any:
        return self.server.scene

    def draw_terrain(self, terrain: HeightMap) -> None:
        """Draws the ground, with hatched surfaces over unknown cells, and looks at it from above."""
        self.terrain, self.place = terrain, local_place(terrain)
        self.surface = surface_of(terrain)
        self._ground = relative_map(self.surface, self.place)
        unknown = np.isnan(terrain.heights)
        ground = ground_mesh(self._ground, ~unknown)
        self.scene.add_glb("/terrain", textured(ground, height_colors(terrain)), cast_shadow=False)
        self.unknown = None
        if unknown.any():
            surface = ground_mesh(self._ground, unknown, walls=False)
            self.unknown = self.scene.add_glb("/unknown", textured(surface, unknown_colors(terrain)), cast_shadow=False)
        (x, y), size = self._ground.center, max(terrain.size)
        x += self._aside * size
        self._level = level = float(np.median(ground.vertices[:, 2])) if len(ground.vertices) else 0.0
        camera = self.server.initial_camera
        camera.position = (x - 0.25 * size, y - 0.85 * size, level + 0.85 * size)
        camera.look_at = (x, y - 0.03 * size, level)

    def draw_layer(self, name: str, colors: np.ndarray, visible: bool = True) -> None:
        """Drapes colours, uint8 [nx, ny, 4], over the ground; another layer of the same name is replaced."""
        surface = ground_mesh(self._ground, colors[..., 3] > 0, raised=_ABOVE, walls=False)
        self.remove_layer(name)
        if len(surface.faces):
            self._layers[name] = self.scene.add_glb(
                f"/layers/{name}", textured(surface, colors), cast_shadow=False, receive_shadow=False, visible=visible
            )

    def draw_lines(self, name: str, ends: np.ndarray, colors: np.ndarray) -> None:
        """Draws line segments, float [n, 2, 3], with colours, uint8 [n, 3], as a layer."""
        self.remove_layer(name)
        if len(ends):
            both, ends = np.repeat(colors[:, None], 2, axis=1), relative_points(ends, self.place)
            self._layers[name] = self.scene.add_line_segments(
                f"/layers/{name}", ends.astype(np.float32), both, thickness=1.0, thickness_units="screen"
            )

    def remove_layer(self, name: str) -> None:
        """Removes a layer, if it is there."""
        node = self._layers.pop(name, None)
        if node is not None:
            node.remove()

    def draw_path(self, states: np.ndarray, actions: Sequence[Action], motion: Motion | None = None) -> None:
        """Draws the tracks of base and feet, and the steps; the motion's, if there is one.

        Args:
            states: float64 [n, 7], world coordinates; without states, an earlier path disappears.
            actions: the n - 1 actions between the states.
            motion: the refined plan.
        """
        self.clear_path()
        if len(states) < 2:
            return
        self._add_group("path")
        states = relative_points(states, self.place)
        base, feet = standing(self._ground, self.robot, states)
        swings = [k for k, action in enumerate(actions) if action.stepping_foot is not None]
        if motion is not None:
            base, feet = (relative_points(values, self.place) for values in (motion.base, motion.feet))
        # The track of the base runs over the ground, where it is not hidden by the robot.
        ground = np.column_stack([base[:, :2], feet[..., 2].mean(axis=1) + _TRACK])
        self._line("/path/base", ground, BLACK, 4.0)
        for foot, color in enumerate(FEET):
            self._line(f"/path/foot_{foot}", feet[:, foot] + (0, 0, _TRACK), color, 2.5)
        landings = []
        _, placed = standing(self._ground, self.robot, states)
        for k in swings:
            stepping = actions[k].stepping_foot
            assert stepping is not None
            landings.append([placed[k, stepping], placed[k + 1, stepping]])
        if landings:
            ends = np.array(landings) + (0, 0, 2 * _TRACK)
            self.scene.add_arrows(
                "/path/steps", ends.astype(np.float32), rgb(VERMILLION), shaft_radius=0.012, head_radius=0.03,
                head_length=0.06,
            )  # fmt: skip

    def clear_path(self) -> None:
        """Removes the path."""
        self._remove_group("path")

    def _add_group(self, name: str) -> None:
        self._groups[name] = self.scene.add_frame(f"/{name}", show_axes=False)

    def _remove_group(self, name: str) -> None:
        """Removes a node and all nodes below it, if it is there."""
        node = self._groups.pop(name, None)
        if node is not None:
            node.remove()

    def _line(self, name: str, points: np.ndarray, color: str, width: float) -> None:
        moved = np.concatenate([[True], (abs(np.diff(points, axis=0)) > 1e-6).any(axis=1)])
        points = points[moved].astype(np.float32)
        if len(points) < 2:
            return
        ends = np.stack([points[:-1], points[1:]], axis=1)
        self.scene.add_line_segments(name, ends, rgb(color), thickness=width, thickness_units="screen")

    def draw_failure(self, failure: Failure | None) -> None:
        """Draws pins at the causes of a failure, impossible poses, and the area in reach; None removes them."""
        self._remove_group("failure")
        self.remove_layer("in reach")
        if failure is None:
            return
        self._add_group("failure")
        if failure.reached is not None:
            self.draw_layer("in reach", mark_colors(failure.reached, SKY))
        for number, mark in enumerate(failure.marks, 1):
            self._pin(f"/failure/cause_{number}", mark.place, f"{number}: {mark.label.rstrip(',')}", VERMILLION)
        poses = dict.fromkeys(mark.pose for mark in failure.marks if mark.pose is not None)
        for number, pose in enumerate(poses):
            self.add_ghost(f"/failure/pose_{number}", np.asarray(pose), VERMILLION, 0.45)
        if failure.nearest is not None:
            self.add_ghost("/failure/nearest", np.asarray(failure.nearest), SKY, 0.45)
            self._pin("/failure/nearest_label", failure.nearest[:2], "nearest pose in reach", SKY)

    def _pin(self, name: str, place: Sequence[float], words: str, color: str) -> None:
        x, y = relative_points(place[:2], self.place).tolist()
        z = float(np.nan_to_num(self._ground.height_at(x, y), nan=self._level))
        ends = np.array([[(x, y, z), (x, y, z + _PIN)]], np.float32)
        self.scene.add_line_segments(name, ends, rgb(color), thickness=3.0, thickness_units="screen")
        self.scene.add_icosphere(f"{name}/head", 0.05, rgb(color), position=(x, y, z + _PIN))
        self.scene.add_label(f"{name}/words", words, position=(x, y, z + _PIN + 0.12), anchor="bottom-center")

    def add_ghost(self, name: str, state: np.ndarray, color: str, opacity: float) -> None:
        """Adds a see-through robot in a state, float64 [7]."""
        base, feet = standing(self._ground, self.robot, relative_points(state, self.place))
        RobotNodes(self.scene, name, self.robot, color, opacity).place(base[0], feet[0])

    def place_robot(self, base: np.ndarray, feet: np.ndarray, rolled: np.ndarray | None = None) -> None:
        """Shows the robot in one configuration, see `robot_pose.parts`."""
        if self.body is None or self.body.robot is not self.robot:
            self.remove_robot()
            self.body = RobotNodes(self.scene, "/robot", self.robot)
        with self.server.atomic():
            self.body.place(relative_points(base, self.place), relative_points(feet, self.place), rolled)

    def remove_robot(self) -> None:
        """Removes the robot."""
        if self.body is not None:
            self.body.remove()
            self.body = None


def textured(mesh: Mesh, colors: np.ndarray) -> bytes:
    """Returns a mesh with the colours of map cells, uint8 [nx, ny, 4], as a binary glTF file."""
    import trimesh
    from PIL import Image

    picture = Image.fromarray(np.ascontiguousarray(colors.transpose(1, 0, 2)[::-1]), "RGBA")
    see_through = bool((colors[..., 3] < 255).any())
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=picture, metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True,
        alphaMode="BLEND" if see_through else "OPAQUE",
    )  # fmt: skip
    visual = trimesh.visual.TextureVisuals(uv=mesh.uv, material=material)
    made = trimesh.Trimesh(mesh.vertices, mesh.faces, visual=visual, process=False)
    return cast(bytes, made.export(file_type="glb"))
