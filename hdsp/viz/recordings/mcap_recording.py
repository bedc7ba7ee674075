"""A motion as MCAP for Foxglove, rerun and other viewers, by foxglove-sdk.

Topics: ``/terrain`` (a mesh), ``/terrain_grid`` (cell heights, NaN = unknown), ``/path`` (base poses),
``/robot`` (its shapes, each in its own frame), ``/tf`` (frames over time), ``/state`` (JSON: contacts, margin, phase,
action, poses and velocities). The metadata record ``hdsp`` holds the robot, the frames and the limits. Times count from
the start of the motion.

Convention: as in motions; quaternions are (x, y, z, w).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.files import replacing
from hdsp.detailed.motion.motion import Motion
from hdsp.detailed.motion.motion_files import frame_facts, map_frame_name
from hdsp.detailed.motion.phases import PHASES
from hdsp.robot.robot import FEET
from hdsp.robot.urdf import BASE_FRAME, robot_urdf, wheel_frame, wheel_radius
from hdsp.terrain.height_map import HeightMap
from hdsp.viz.palette import FEET as FOOT_COLORS
from hdsp.viz.palette import ORANGE, UNKNOWN
from hdsp.viz.recordings.track import Track, source_transform
from hdsp.viz.viewer.ground_mesh import ground_mesh, surface_of
from hdsp.viz.viewer.robot_pose import link_length, trunk
from hdsp.viz.viewer.textures import height_colors, rgb

_BASE, _LINK, _RUBBER = "#4C6A92", "#B8BEC6", "#303030"
_LINKS = ("thigh", "shank")
_WIDTHS = 0.055, 0.04  # m, of thigh and shank
_TYRE = 0.07  # m, width of a wheel
_STATE = {
    "type": "object",
    "title": "hdsp.MotionState",
    "properties": {
        **{name: {"type": "number"} for name in ("time", "margin")},
        **{name: {"type": "string"} for name in ("phase", "frame")},
        "action": {"type": "integer"},
        "contacts": {"type": "object", "additionalProperties": {"type": "boolean"}},
        **{
            name: {"type": "array", "items": {"type": "number"}}
            for name in ("base", "base_velocity", "feet", "feet_velocity")
        },
    },
}


def write_mcap(motion: Motion, path: Path, rate: float) -> None:
    """Writes a motion, whole or not at all.

    Args:
        motion: the motion.
        path: MCAP file.
        rate: states per second.

    Raises:
        InputError: foxglove-sdk is missing, or the path cannot be written.
    """
    try:
        import foxglove
    except ModuleNotFoundError as error:
        raise InputError("recordings as MCAP need foxglove-sdk: pip install 'hdsp[record]'") from error
    track = Track(motion, rate)
    with replacing(path) as temporary:
        context = foxglove.Context()
        with foxglove.open_mcap(temporary, context=context) as writer:
            writer.write_metadata("hdsp", _facts(motion))
            writer.attach(
                log_time=0, create_time=0, name=f"{motion.robot.name}.urdf", media_type="application/xml",
                data=robot_urdf(motion.robot).encode(),
            )  # fmt: skip
            _Recorder(context, track).record()


def _facts(motion: Motion) -> dict[str, str]:
    limits = {name: motion.robot.to_dict()[name] for name in ("speeds", "accelerations")}
    frame = frame_facts(motion.terrain.frame)
    facts = {"robot": motion.robot.name, "duration": f"{motion.duration:.9f}", "frame": json.dumps(frame)}
    return facts | {"limits": json.dumps(limits), "feet": json.dumps(FEET), "phases": json.dumps(PHASES)}


class _Recorder:
    """Writes a track's messages to a context's channels."""

    def __init__(self, context: Any, track: Track):
        from foxglove import Channel, channels, messages

        self._m, self._track = messages, track
        self._frame = map_frame_name(track.motion.terrain.frame)
        self._scenes = {t: channels.SceneUpdateChannel(t, context=context) for t in ("/terrain", "/robot")}
        self._grid = channels.GridChannel("/terrain_grid", context=context)
        self._path = channels.PosesInFrameChannel("/path", context=context)
        self._tf = channels.FrameTransformsChannel("/tf", context=context)
        self._state = Channel("/state", schema=_STATE, context=context)

    def record(self) -> None:
        m, track = self._m, self._track
        terrain = track.motion.terrain
        self._scenes["/terrain"].log(m.SceneUpdate(entities=[self._ground(terrain)]), log_time=0)
        self._scenes["/robot"].log(m.SceneUpdate(entities=self._shapes()), log_time=0)
        self._grid.log(self._cells(terrain), log_time=0)
        places, turns = track.state.base[:, :3], track.quaternions
        poses = [self._pose(place, turn) for place, turn in zip(places, turns, strict=True)]
        self._path.log(m.PosesInFrame(timestamp=m.Timestamp(0), frame_id=self._frame, poses=poses), log_time=0)
        source = source_transform(terrain.frame)
        names = [BASE_FRAME, *(f"{foot}_{link}" for foot in FEET for link in _LINKS), *map(wheel_frame, FEET)]
        base = np.concatenate([places, turns], axis=1)[:, None]
        whole = np.concatenate([base, track.legs.reshape(-1, 8, 7), track.wheels], axis=1)
        for k, moment in enumerate(track.nanoseconds):
            transforms = [self._transform(moment, self._frame, n, p) for n, p in zip(names, whole[k], strict=True)]
            if source is not None:
                name, place, turn = source
                transforms.append(self._transform(moment, name, self._frame, np.concatenate([place, turn])))
            self._tf.log(m.FrameTransforms(transforms=transforms), log_time=moment)
            self._state.log(self._words(k), log_time=moment)

    def _words(self, k: int) -> dict[str, Any]:
        state = self._track.state
        return {
            "time": float(state.time[k]),
            "frame": self._frame,
            "phase": PHASES[state.phase[k]],
            "action": int(state.action[k]),
            "margin": float(state.margin[k]),
            "contacts": dict(zip(FEET, state.carries[k].tolist(), strict=True)),
            "base": state.base[k].tolist(),
            "base_velocity": state.base_velocity[k].tolist(),
            "feet": state.feet[k].ravel().tolist(),
            "feet_velocity": state.feet_velocity[k].ravel().tolist(),
        }

    def _transform(self, moment: int, parent: str, child: str, pose: np.ndarray) -> Any:
        m = self._m
        return m.FrameTransform(
            timestamp=m.Timestamp(*divmod(moment, 10**9)), parent_frame_id=parent, child_frame_id=child,
            translation=m.Vector3(**_named("xyz", pose[:3])), rotation=m.Quaternion(**_named("xyzw", pose[3:])),
        )  # fmt: skip

    def _pose(self, place: Any, turn: Any = (0.0, 0.0, 0.0, 1.0)) -> Any:
        m = self._m
        return m.Pose(position=m.Vector3(**_named("xyz", place)), orientation=m.Quaternion(**_named("xyzw", turn)))

    def _color(self, color: str, opacity: float = 1.0) -> Any:
        return self._m.Color(**_named("rgb", np.array(rgb(color)) / 255), a=opacity)

    def _entity(self, name: str, frame: str, **primitives: Any) -> Any:
        m = self._m
        return m.SceneEntity(timestamp=m.Timestamp(0), frame_id=frame, id=name, frame_locked=True, **primitives)

    def _cells(self, terrain: HeightMap) -> Any:
        m, columns = self._m, terrain.shape[0]
        field = m.PackedElementField(name="height", offset=0, type=m.PackedElementFieldNumericType.Float32)
        return m.Grid(
            timestamp=m.Timestamp(0), frame_id=self._frame, pose=self._pose((*terrain.origin, 0.0)),
            column_count=columns, cell_size=m.Vector2(x=terrain.resolution, y=terrain.resolution),
            row_stride=4 * columns, cell_stride=4, fields=[field],
            data=np.ascontiguousarray(terrain.heights.T, "<f4").tobytes(),
        )  # fmt: skip

    def _ground(self, terrain: HeightMap) -> Any:
        m, parts = self._m, []
        colors = height_colors(terrain)[..., :3] / 255.0
        unknown = np.isnan(terrain.heights)
        # Viewers round far coordinates to float32.
        local = surface_of(HeightMap(terrain.heights, resolution=terrain.resolution))
        for cells, color in ((~unknown, None), (unknown, UNKNOWN)):
            mesh = ground_mesh(local, cells, walls=color is None)
            if not len(mesh.faces):
                continue
            ends = np.array(terrain.shape)
            place = np.clip(np.floor(mesh.uv * ends - 1e-4), 0, ends - 1).astype(int)
            shades = None if color else [m.Color(r=r, g=g, b=b, a=1.0) for r, g, b in colors[tuple(place.T)].tolist()]
            parts.append(
                m.TriangleListPrimitive(
                    pose=self._pose((*terrain.origin, 0.0)),
                    points=[m.Point3(x=x, y=y, z=z) for x, y, z in mesh.vertices.tolist()],
                    color=self._color(color or _LINK), colors=shades, indices=mesh.faces.ravel().tolist(),
                )
            )  # fmt: skip
        return self._entity("terrain", self._frame, triangles=parts)

    def _shapes(self) -> list[Any]:
        m, robot = self._m, self._track.motion.robot
        boxes = [
            m.CubePrimitive(
                pose=self._pose(box.center), size=m.Vector3(**_named("xyz", box.size)),
                color=self._color(ORANGE if number else _BASE),
            )
            for number, box in enumerate(trunk(robot))
        ]  # fmt: skip
        found = [self._entity("base", BASE_FRAME, cubes=boxes)]
        radius, length = wheel_radius(robot), link_length(robot)
        upright = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))  # a cylinder's axis is z, an axle y
        for foot, color in zip(FEET, FOOT_COLORS, strict=True):
            for link, width in zip(_LINKS, _WIDTHS, strict=True):
                size = m.Vector3(x=length, y=width, z=width)
                cube = m.CubePrimitive(pose=self._pose((0.0, 0.0, 0.0)), size=size, color=self._color(_LINK))
                found.append(self._entity(f"{foot}_{link}", f"{foot}_{link}", cubes=[cube]))
            tyre, hub = (
                m.CylinderPrimitive(
                    pose=self._pose((0.0, 0.0, 0.0), upright), size=m.Vector3(x=2 * r, y=2 * r, z=width),
                    bottom_scale=1.0, top_scale=1.0, color=self._color(shade),
                )
                for r, width, shade in ((radius, _TYRE, _RUBBER), (0.45 * radius, 1.15 * _TYRE, color))
            )  # fmt: skip
            spoke = m.CubePrimitive(
                pose=self._pose((0.0, 0.0, 0.0)), size=m.Vector3(x=1.5 * radius, y=1.1 * _TYRE, z=0.2 * radius),
                color=self._color(color),
            )  # fmt: skip
            found.append(self._entity(wheel_frame(foot), wheel_frame(foot), cylinders=[tyre, hub], cubes=[spoke]))
        return found


def _named(names: str, values: Any) -> dict[str, float]:
    return {name: float(value) for name, value in zip(names, values, strict=True)}
