"""A robot as URDF: base, four legs with three sliding joints each, and wheels.

Legs in a robot file have no knees. Three prismatic joints along the base axes move each wheel centre relative
to its hip, so joint positions describe any configuration exactly (`leg_positions`). Masses and inertias are unknown and
left out; the model shows the robot and its frames.
"""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

from hdsp.base.errors import InputError
from hdsp.robot.robot import FEET, Robot

#: Frame between the hips, as in motions.
BASE_FRAME = "base_link"
#: Directions of a leg's joints, in order.
DIRECTIONS = ("x", "y", "z")

_EFFORT = "1000"  # N; URDF demands a number
_HEIGHT, _WHEEL_WIDTH = 0.2, 0.07  # m, of the drawn base and wheels


def leg_joints(foot: str) -> list[str]:
    """Returns a leg's three joint names."""
    return [f"{foot}_{direction}" for direction in DIRECTIONS]


def wheel_frame(foot: str) -> str:
    """Returns the name for a wheel's link and frame."""
    return f"{foot}_wheel"


def wheel_radius(robot: Robot) -> float:
    """Returns the wheel radius, m; without one in the file, the feet's clearance stands in for it.

    Raises:
        InputError: there is none, and the clearance is 0; `Robot.load` returns no such robot.
    """
    radius = robot.physics.wheel_radius or robot.drive.wheel_radius or robot.feet.clearance
    if not radius:
        raise InputError(f"robot {robot.name}: feet.clearance is 0; need physics.wheel_radius beside it")
    return radius


def leg_positions(robot: Robot, base: np.ndarray, rotations: np.ndarray, feet: np.ndarray) -> np.ndarray:
    """Returns joint positions, float64 [n, 4, 3], m: wheel centres relative to their hips, along the base axes.

    Args:
        robot: the robot.
        base: float64 [n, 6] as in a motion.
        rotations: float64 [n, 3, 3], from the base frame to the world frame.
        feet: float64 [n, 4, 3], lowest wheel points, world frame.
    """
    inside = np.einsum("nji,nfj->nfi", rotations, feet - base[:, None, :3])
    return inside - robot.hips() + (0.0, 0.0, wheel_radius(robot))


def robot_urdf(robot: Robot) -> str:
    """Returns the URDF text."""
    root = ElementTree.Element("robot", name=robot.name)
    base = _link(root, BASE_FRAME)
    highest = max((box.above for box in robot.body.boxes), default=0.0)
    for box in robot.body.boxes:
        if box.above == highest:
            size = f"{box.x_max - box.x_min:g} {2 * box.half_width:g} {_HEIGHT:g}"
            middle = box.above - robot.stance.base_height + _HEIGHT / 2
            _visual(base, f"{(box.x_min + box.x_max) / 2:g} 0 {middle:g}", "0 0 0", "box", size=size)
    long, speeds = robot.legs.max_length, robot.speeds
    for foot, hip in zip(FEET, robot.hips().tolist(), strict=True):
        parent, place = BASE_FRAME, hip
        for name, direction, speed in zip(
            leg_joints(foot), np.eye(3, dtype=int).tolist(), (speeds.foot, speeds.foot, speeds.lift), strict=True
        ):
            _link(root, f"{name}_slide")
            joint = _joint(root, name, "prismatic", parent, f"{name}_slide", place, direction)
            limit = {"lower": f"{-long:g}", "upper": f"{long:g}", "effort": _EFFORT, "velocity": f"{speed:g}"}
            ElementTree.SubElement(joint, "limit", limit)
            parent, place = f"{name}_slide", [0.0, 0.0, 0.0]
        wheel = _link(root, wheel_frame(foot))
        _visual(
            wheel, "0 0 0", "1.5707963 0 0", "cylinder", radius=f"{wheel_radius(robot):g}", length=f"{_WHEEL_WIDTH:g}"
        )
        _joint(root, f"{foot}_wheel_joint", "continuous", parent, wheel_frame(foot), place, [0, 1, 0])
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _link(root: ElementTree.Element, name: str) -> ElementTree.Element:
    return ElementTree.SubElement(root, "link", name=name)


def _visual(link: ElementTree.Element, place: str, turn: str, kind: str, **shape: str) -> None:
    visual = ElementTree.SubElement(link, "visual")
    ElementTree.SubElement(visual, "origin", xyz=place, rpy=turn)
    ElementTree.SubElement(ElementTree.SubElement(visual, "geometry"), kind, shape)


def _joint(root, name: str, kind: str, parent: str, child: str, place: list, axis: list) -> ElementTree.Element:
    joint = ElementTree.SubElement(root, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "origin", xyz=" ".join(f"{value:g}" for value in place), rpy="0 0 0")
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(joint, "axis", xyz=" ".join(str(value) for value in axis))
    return joint
