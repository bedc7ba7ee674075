"""A plan as a table: base poses in the frame of the map and in the frame of its source, feet and actions."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hdsp.base.files import replacing
from hdsp.detailed.actions.action import Action
from hdsp.detailed.base_pose import base_poses
from hdsp.robot.robot import FEET, Robot
from hdsp.terrain.height_map import HeightMap

#: Columns of the base pose in the source of the map, where that frame is another one than the map's.
SOURCE_COLUMNS = ("source_x", "source_y", "source_z", "source_qx", "source_qy", "source_qz", "source_qw")


@dataclass(frozen=True, eq=False)
class SourcePoses:
    """Base poses in the frame of the file or cloud from which the map was made (``HeightMap.frame``).

    Attributes:
        positions: float64 [n, 3], m: the point on the ground between the feet, under the base.
        quaternions: float64 [n, 4]: x, y, z, w; rotation from the base frame (x ahead, y left, z up) to the source.
        frame: source frame's name; "" if it has none.
        crs: its coordinate reference system; "" if unknown.
    """

    positions: np.ndarray
    quaternions: np.ndarray
    frame: str
    crs: str


def ground_poses(terrain: HeightMap, robot: Robot, states: np.ndarray) -> np.ndarray:
    """Returns the base poses of states float64 [n, 7] in the frame of the map; see ``Plan.ground_poses``."""
    if len(states) == 0:
        return np.empty((0, 6))
    feet = robot.foot_positions(states)
    leaning = base_poses(robot, states[:, 3:], terrain.height_at(feet[..., 0], feet[..., 1]))
    return np.column_stack([states[:, :2], leaning, states[:, 2]])


def source_poses(terrain: HeightMap, poses: np.ndarray) -> SourcePoses:
    """Returns base poses from `ground_poses` in the frame of the map's source."""
    from scipy.spatial.transform import Rotation

    frame = terrain.frame
    quaternions = np.empty((0, 4))
    if len(poses):
        turned = Rotation.from_matrix(frame.to_source[:3, :3]) * Rotation.from_euler("ZYX", poses[:, [5, 4, 3]])
        quaternions = turned.as_quat(canonical=True)
    return SourcePoses(frame.points_to_source(poses[:, :3]), quaternions, frame.name, frame.crs)


def write_table(
    path: str | Path, terrain: HeightMap, robot: Robot, states: np.ndarray, actions: Sequence[Action]
) -> Path:
    """Writes a plan as CSV, whole or not at all; see ``Plan.write``."""
    names = ["action", "x", "y", "z", "heading", *FEET]
    poses = ground_poses(terrain, robot, states)
    values = np.column_stack([poses[:, :3], states[:, 2:]])
    formats = ["{:.4f}"] * 3 + ["{:.6f}"] + ["{:.4f}"] * len(FEET)
    if not terrain.frame.is_source:
        source = source_poses(terrain, poses)
        names += SOURCE_COLUMNS
        values = np.column_stack([values, source.positions, source.quaternions])
        formats += ["{:.4f}"] * 3 + ["{:.6f}"] * 4
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(names)
        for action, row in zip([""] * len(states[:1]) + [*actions], values.tolist(), strict=True):
            table.writerow([action, *(form.format(value) for form, value in zip(formats, row, strict=True))])
    return Path(path)
