"""A motion as a ROS 2 bag, by rosbags, without ROS.

Topics: ``/path`` (nav_msgs/Path, base poses), ``/base_trajectory`` (trajectory_msgs/MultiDOFJointTrajectory),
``/legs_trajectory`` (trajectory_msgs/JointTrajectory), ``/joint_states``, ``/tf``, ``/tf_static`` (the map in its
source frame), ``/contacts`` (std_msgs/String, JSON: contacts, margin, phase, action) and ``/robot_description`` (URDF).
Stamps and times from the start count from 0. The joints are those in `hdsp.robot.urdf`: three that slide for each leg,
along the base axes, and its wheel.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.detailed.motion.motion import Motion
from hdsp.detailed.motion.motion_files import map_frame_name
from hdsp.detailed.motion.phases import PHASES
from hdsp.robot.robot import FEET
from hdsp.robot.urdf import BASE_FRAME, leg_joints, robot_urdf
from hdsp.viz.recordings.track import Track, source_transform

_LATCHED = ("/robot_description", "/tf_static")


def write_ros_bag(motion: Motion, path: Path, rate: float) -> None:
    """Writes a motion as a bag with MCAP storage, whole or not at all.

    Args:
        motion: the motion.
        path: the bag's folder, which must not exist.
        rate: states per second.

    Raises:
        InputError: rosbags is missing, or the path cannot be written.
    """
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError as error:
        raise InputError("ROS 2 bags need rosbags: pip install 'hdsp[record]'") from error
    track = Track(motion, rate)
    store = get_typestore(Stores.ROS2_HUMBLE)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(dir=path.parent, prefix=f".{path.name}-") as folder:
            with Writer(Path(folder) / path.name, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
                _Messages(store, track).write(writer)
            (Path(folder) / path.name).replace(path)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error


class _Messages:
    """ROS 2 messages for a track."""

    def __init__(self, store: Any, track: Track):
        self._store, self._types, self._track = store, store.types, track
        self._frame = map_frame_name(track.motion.terrain.frame)
        self._source = source_transform(track.motion.terrain.frame)

    def write(self, writer: Any) -> None:
        text, tf = "std_msgs/msg/String", "tf2_msgs/msg/TFMessage"
        self._put(writer, "/robot_description", text, [(0, self._text(robot_urdf(self._track.motion.robot)))])
        if self._source is not None:
            name, place, turn = self._source
            static = self._make(tf, transforms=[self._transform(0, name, self._frame, place, turn)])
            self._put(writer, "/tf_static", tf, [(0, static)])
        for topic, kind, message in (
            ("/path", "nav_msgs/msg/Path", self._path()),
            ("/base_trajectory", "trajectory_msgs/msg/MultiDOFJointTrajectory", self._base()),
            ("/legs_trajectory", "trajectory_msgs/msg/JointTrajectory", self._legs()),
        ):
            self._put(writer, topic, kind, [(0, message)])
        moments = self._track.nanoseconds
        self._put(writer, "/tf", tf, zip(moments, map(self._frames, range(len(moments))), strict=True))
        joints = zip(moments, map(self._joints, range(len(moments))), strict=True)
        self._put(writer, "/joint_states", "sensor_msgs/msg/JointState", joints)
        contacts = zip(moments, map(self._contacts, range(len(moments))), strict=True)
        self._put(writer, "/contacts", text, contacts)

    def _put(self, writer: Any, topic: str, kind: str, messages: Iterable[tuple[int, Any]]) -> None:
        quality = [_latched()] if topic in _LATCHED else []
        connection = writer.add_connection(topic, kind, typestore=self._store, offered_qos_profiles=quality)
        for moment, message in messages:
            writer.write(connection, moment, self._store.serialize_cdr(message, kind))

    def _make(self, kind: str, **values: Any) -> Any:
        return self._types[kind](**values)

    def _text(self, words: str) -> Any:
        return self._make("std_msgs/msg/String", data=words)

    def _header(self, moment: int, frame: str) -> Any:
        seconds, rest = divmod(moment, 10**9)
        stamp = self._make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
        return self._make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def _since(self, k: int) -> Any:
        seconds, rest = divmod(self._track.nanoseconds[k], 10**9)
        return self._make("builtin_interfaces/msg/Duration", sec=seconds, nanosec=rest)

    def _vector(self, values: Any, kind: str = "Vector3") -> Any:
        x, y, z = (float(value) for value in values)
        return self._make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)

    def _turn(self, quaternion: Any) -> Any:
        x, y, z, w = (float(value) for value in quaternion)
        return self._make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def _motion(self, place: Any, turn: Any) -> Any:
        return self._make("geometry_msgs/msg/Transform", translation=self._vector(place), rotation=self._turn(turn))

    def _transform(self, moment: int, parent: str, child: str, place: Any, turn: Any) -> Any:
        header, moved = self._header(moment, parent), self._motion(place, turn)
        return self._make("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child, transform=moved)

    def _path(self) -> Any:
        poses = []
        for k, (base, turn) in enumerate(zip(self._track.state.base, self._track.quaternions, strict=True)):
            pose = self._make(
                "geometry_msgs/msg/Pose", position=self._vector(base[:3], "Point"), orientation=self._turn(turn)
            )
            header = self._header(self._track.nanoseconds[k], self._frame)
            poses.append(self._make("geometry_msgs/msg/PoseStamped", header=header, pose=pose))
        return self._make("nav_msgs/msg/Path", header=self._header(0, self._frame), poses=poses)

    def _base(self) -> Any:
        state, points = self._track.state, []
        for k, (base, turn) in enumerate(zip(state.base, self._track.quaternions, strict=True)):
            twist = self._make(
                "geometry_msgs/msg/Twist", linear=self._vector(state.base_velocity[k, :3]),
                angular=self._vector(angular_velocity(base, state.base_velocity[k])),
            )  # fmt: skip
            points.append(
                self._make(
                    "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint", transforms=[self._motion(base[:3], turn)],
                    velocities=[twist], accelerations=[], time_from_start=self._since(k),
                )
            )  # fmt: skip
        return self._make(
            "trajectory_msgs/msg/MultiDOFJointTrajectory", header=self._header(0, self._frame),
            joint_names=[BASE_FRAME], points=points,
        )  # fmt: skip

    def _legs(self) -> Any:
        track, points, nothing = self._track, [], np.zeros(0)
        for k in range(len(track)):
            points.append(
                self._make(
                    "trajectory_msgs/msg/JointTrajectoryPoint", positions=track.joints[k].ravel(),
                    velocities=track.joint_velocities[k].ravel(), accelerations=nothing, effort=nothing,
                    time_from_start=self._since(k),
                )
            )  # fmt: skip
        names = [name for foot in FEET for name in leg_joints(foot)]
        header = self._header(0, BASE_FRAME)
        return self._make("trajectory_msgs/msg/JointTrajectory", header=header, joint_names=names, points=points)

    def _joints(self, k: int) -> Any:
        names = [name for foot in FEET for name in (*leg_joints(foot), f"{foot}_wheel_joint")]
        positions = np.concatenate([self._track.joints[k], self._track.rolled[k, :, None]], axis=1).ravel()
        header = self._header(self._track.nanoseconds[k], BASE_FRAME)
        nothing = np.zeros(0)
        return self._make(
            "sensor_msgs/msg/JointState",
            header=header,
            name=names,
            position=positions,
            velocity=nothing,
            effort=nothing,
        )

    def _frames(self, k: int) -> Any:
        moment, base = self._track.nanoseconds[k], self._track.state.base[k]
        moved = self._transform(moment, self._frame, BASE_FRAME, base[:3], self._track.quaternions[k])
        return self._make("tf2_msgs/msg/TFMessage", transforms=[moved])

    def _contacts(self, k: int) -> Any:
        state = self._track.state
        words = {
            "contacts": dict(zip(FEET, state.carries[k].tolist(), strict=True)),
            "margin": float(state.margin[k]),
            "phase": PHASES[state.phase[k]],
            "action": int(state.action[k]),
        }
        return self._text(json.dumps(words))


def angular_velocity(base: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Returns the base's angular velocity in the map frame, float64 [3], rad/s.

    Args:
        base: float64 [6], with roll, pitch and heading.
        velocity: float64 [6], their derivatives, last three.
    """
    (pitch, heading), (roll_rate, pitch_rate, heading_rate) = base[4:6], velocity[3:6]
    ahead = np.array([np.cos(heading) * np.cos(pitch), np.sin(heading) * np.cos(pitch), -np.sin(pitch)])
    left = np.array([-np.sin(heading), np.cos(heading), 0.0])
    return roll_rate * ahead + pitch_rate * left + heading_rate * np.array([0.0, 0.0, 1.0])


def _latched() -> Any:
    """Quality for latched topics: newcomers get the last message."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    forever = QosTime(2147483647, 4294967295)
    return Qos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, forever, forever,
        QosLiveliness.AUTOMATIC, forever, False,
    )  # fmt: skip
