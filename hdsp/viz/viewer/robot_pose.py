"""Places of a robot's parts in three dimensions: base, two links for each leg, and wheels.

The lengths come from the robot's description. Both links of a leg are equally long, and a stretched leg reaches as far
as `Legs.max_length`. Knees bend backward. These choices serve the picture alone.

Convention: metres and radians; quaternions are (w, x, y, z).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hdsp.detailed.base_pose import base_poses
from hdsp.robot.robot import Robot
from hdsp.robot.urdf import wheel_radius
from hdsp.terrain.height_map import HeightMap

_TRUNK = 0.25  # height of the base, as a share of its length; the description gives its lower side alone


class Trunk(NamedTuple):
    """A cuboid of the base, in the base frame.

    Attributes:
        size: lengths along x, y, z, m.
        center: its centre, m.
    """

    size: tuple[float, float, float]
    center: tuple[float, float, float]


class Parts(NamedTuple):
    """Poses of the moving parts in the world frame.

    Attributes:
        base: position [3] and quaternion [4].
        links: float64 [4, 2, 7]: position of the middle of thigh and shank, quaternion; their x axes point to the foot.
        wheels: float64 [4, 7]: position of the centre, quaternion; the y axes are the axles.
    """

    base: np.ndarray
    links: np.ndarray
    wheels: np.ndarray


def link_length(robot: Robot) -> float:
    """Returns the length of each of the two links between hip and wheel, m."""
    return max((robot.legs.max_length - wheel_radius(robot)) / 2, 0.01)


def trunk(robot: Robot) -> list[Trunk]:
    """Returns the cuboids of the base: those boxes of the body whose lower side is highest."""
    highest = max(box.above for box in robot.body.boxes)
    boxes = [box for box in robot.body.boxes if box.above == highest]
    length = max(box.x_max - box.x_min for box in boxes)
    lower = highest - robot.stance.base_height
    height = max(_TRUNK * length, -lower + 0.02)
    return [
        Trunk(
            (box.x_max - box.x_min, 2 * box.half_width, height),
            ((box.x_min + box.x_max) / 2, 0.0, lower + height / 2),
        )
        for box in boxes
    ]


def standing(terrain: HeightMap, robot: Robot, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns configurations of a robot that stands on the ground in detailed states, as in a motion.

    Args:
        terrain: the map; ground that is unknown counts as high as that under the other feet.
        robot: the robot.
        states: float64 [n, 7], world coordinates.

    Returns:
        Base poses, float64 [n, 6] (x, y, z, roll, pitch, heading), and feet, float64 [n, 4, 3] (x, y, z).
    """
    states = np.atleast_2d(np.asarray(states, float))
    places = robot.foot_positions(states)
    heights = _without_gaps(np.asarray(terrain.height_at(places[..., 0], places[..., 1]), float), terrain)
    leaning = base_poses(robot, states[:, 3:], heights)
    above = robot.stance.base_height / np.cos(leaning[:, 1]) / np.cos(leaning[:, 2])
    base = np.column_stack([states[:, :2], leaning[:, 0] + above, leaning[:, 1:], states[:, 2]])
    return base, np.concatenate([places, heights[..., None]], axis=-1)


def _without_gaps(heights: np.ndarray, terrain: HeightMap) -> np.ndarray:
    """Heights under feet, float64 [n, 4], with the mean of the known ones, else the map's median, for NaN."""
    unknown = np.isnan(heights)
    if not unknown.any():
        return heights
    known = terrain.heights[np.isfinite(terrain.heights)]
    level = float(np.median(known)) if known.size else 0.0
    count = (~unknown).sum(axis=1)
    means = np.where(count > 0, np.nansum(heights, axis=1) / np.maximum(count, 1), level)
    return np.where(unknown, means[:, None], heights)


def parts(robot: Robot, base: np.ndarray, feet: np.ndarray, rolled: np.ndarray | None = None) -> Parts:
    """Returns the places of all parts in one configuration.

    Args:
        robot: the robot.
        base: float64 [6]: x, y, z, roll, pitch, heading; the origin lies between the hips.
        feet: float64 [4, 3], contact points of the wheels.
        rolled: float64 [4], angles by which the wheels have turned, rad; None: 0.
    """
    from scipy.spatial.transform import Rotation

    turned = Rotation.from_euler("ZYX", [base[5], base[4], base[3]])
    axes = turned.as_matrix()
    hips = base[:3] + robot.hips() @ axes.T
    centers = feet + wheel_radius(robot) * axes[:, 2]
    links = np.empty((4, 2, 7))
    for foot in range(4):
        knee = _knee(hips[foot], centers[foot], link_length(robot), -axes[:, 0])
        links[foot, 0] = _link(hips[foot], knee, axes[:, 1])
        links[foot, 1] = _link(knee, centers[foot], axes[:, 1])
    angles = np.zeros(4) if rolled is None else rolled
    axles = turned * Rotation.from_euler("y", angles[:, None])
    wheels = np.concatenate([centers, _scalar_first(axles.as_quat())], axis=1)
    return Parts(np.concatenate([base[:3], _scalar_first(turned.as_quat())]), links, wheels)


def _knee(hip: np.ndarray, center: np.ndarray, length: float, toward: np.ndarray) -> np.ndarray:
    """Knee between two links of equal length, bent ``toward`` a direction."""
    line = center - hip
    distance = float(np.linalg.norm(line))
    middle = (hip + center) / 2
    if distance >= 2 * length or distance < 1e-9:
        return middle
    bend = toward - line * (toward @ line) / distance**2
    return middle + bend / np.linalg.norm(bend) * np.sqrt(length**2 - distance**2 / 4)


def _link(start: np.ndarray, end: np.ndarray, side: np.ndarray) -> np.ndarray:
    """Pose [7] of a link: its middle, and a quaternion whose x axis points to its end."""
    from scipy.spatial.transform import Rotation

    along = (end - start) / max(float(np.linalg.norm(end - start)), 1e-9)
    across = side - along * (side @ along)
    across /= np.linalg.norm(across)
    axes = np.stack([along, across, np.cross(along, across)], axis=1)
    return np.concatenate([(start + end) / 2, _scalar_first(Rotation.from_matrix(axes).as_quat())])


def _scalar_first(quaternions: np.ndarray) -> np.ndarray:
    return np.roll(quaternions, 1, axis=-1)
