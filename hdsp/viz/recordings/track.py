"""Motion states at regular times with all part poses, for recordings.

Convention: metres, radians, seconds; quaternions are (x, y, z, w).
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from hdsp.detailed.motion.motion import Motion
from hdsp.detailed.motion.motion_files import sample_times
from hdsp.robot.urdf import leg_positions, wheel_radius
from hdsp.terrain.map_frame import MapFrame
from hdsp.viz.viewer.robot_pose import link_length


class Track:
    """A sampled motion.

    Attributes:
        motion: the motion.
        state: its states, `MotionState` with arrays [n, ...].
        quaternions: float64 [n, 4], from the base frame to the map frame.
        rolled: float64 [n, 4], angles by which the wheels have turned.
        joints: float64 [n, 4, 3], leg joint positions (`hdsp.robot.urdf`).
    """

    def __init__(self, motion: Motion, rate: float):
        from scipy.spatial.transform import Rotation

        self.motion = motion
        self.state = state = motion.at(sample_times(motion, rate))
        turned = Rotation.from_euler("ZYX", state.base[:, [5, 4, 3]])
        self.quaternions = turned.as_quat(canonical=False)
        ahead = np.stack([np.cos(state.base[1:, 5]), np.sin(state.base[1:, 5])], axis=1)
        way = np.einsum("nfi,ni->nf", np.diff(state.feet[..., :2], axis=0), ahead)
        way *= state.carries[1:] & state.carries[:-1]
        self.rolled = np.cumsum(np.concatenate([np.zeros((1, 4)), way]), axis=0) / wheel_radius(motion.robot)
        self._axes = turned.as_matrix()
        self.joints = leg_positions(motion.robot, state.base, self._axes, state.feet)

    def __len__(self) -> int:
        return len(self.state.time)

    @cached_property
    def nanoseconds(self) -> list[int]:
        """State times, whole nanoseconds from the start."""
        return np.round(self.state.time * 1e9).astype(np.int64).tolist()

    @cached_property
    def joint_velocities(self) -> np.ndarray:
        """Leg joint velocities, float64 [n, 4, 3], m/s."""
        return np.gradient(self.joints, self.state.time, axis=0) if len(self) > 1 else np.zeros_like(self.joints)

    @cached_property
    def wheels(self) -> np.ndarray:
        """Wheel poses in the map frame, float64 [n, 4, 7]: centre, quaternion; the y axes are the axles."""
        from scipy.spatial.transform import Rotation

        turned = Rotation.from_quat(np.repeat(self.quaternions, 4, axis=0))
        quaternions = (turned * Rotation.from_euler("y", self.rolled.reshape(-1, 1))).as_quat()
        return np.concatenate([self._centers(), quaternions.reshape(-1, 4, 4)], axis=2)

    @cached_property
    def legs(self) -> np.ndarray:
        """Thigh and shank poses in the map frame, float64 [n, 4, 2, 7]: middle, quaternion; x points to the foot.

        Both links are equally long, and the knees bend backward, as in `hdsp.viz.viewer.robot_pose`.
        """
        robot = self.motion.robot
        hips = self.state.base[:, None, :3] + np.einsum("nij,fj->nfi", self._axes, robot.hips())
        centers = self._centers()
        line = centers - hips
        distance = np.maximum(np.linalg.norm(line, axis=2, keepdims=True), 1e-9)
        backward = -self._axes[:, None, :, 0]
        bend = backward - line * ((backward * line).sum(axis=2, keepdims=True) / distance**2)
        height = np.sqrt(np.maximum(link_length(robot) ** 2 - distance**2 / 4, 0.0))
        knees = (hips + centers) / 2 + height * bend / np.linalg.norm(bend, axis=2, keepdims=True)
        return np.stack([self._links(hips, knees), self._links(knees, centers)], axis=2)

    def _links(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        from scipy.spatial.transform import Rotation

        along = (end - start) / np.linalg.norm(end - start, axis=2, keepdims=True)
        left = self._axes[:, None, :, 1]
        across = left - along * (left * along).sum(axis=2, keepdims=True)
        across /= np.linalg.norm(across, axis=2, keepdims=True)
        axes = np.stack([along, across, np.cross(along, across)], axis=-1).reshape(-1, 3, 3)
        return np.concatenate([(start + end) / 2, Rotation.from_matrix(axes).as_quat().reshape(-1, 4, 4)], axis=2)

    def _centers(self) -> np.ndarray:
        return self.state.feet + wheel_radius(self.motion.robot) * self._axes[:, None, :, 2]


def source_transform(frame: MapFrame) -> tuple[str, np.ndarray, np.ndarray] | None:
    """Returns the source frame's name, and the map's position [3] and quaternion [4] in it; None without a source."""
    from scipy.spatial.transform import Rotation

    if frame.is_source:
        return None
    turned = Rotation.from_matrix(frame.to_source[:3, :3]).as_quat(canonical=True)
    return frame.name or "source", frame.to_source[:3, 3], turned
