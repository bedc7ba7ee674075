"""A robot as MJCF, MuJoCo's XML format: base, four legs that push wheels, motors.

A leg has three slides along the base axes, the joints in `hdsp.robot.urdf`: up and down like a telescope, along and
across the base. Where the robot drives sideways, a steering joint follows; the wheel comes last. Wheels touch the
ground with ellipsoids, so that a leaning wheel touches in one point.

Convention: SI units; joint positions are those of `hdsp.robot.urdf.leg_positions`.
"""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from hdsp.robot.robot import FEET, Robot
from hdsp.robot.urdf import BASE_FRAME, leg_joints, wheel_frame, wheel_radius
from hdsp.viz.palette import FEET as FOOT_COLORS
from hdsp.viz.viewer.robot_pose import trunk
from hdsp.viz.viewer.textures import rgb

#: m/s²
GRAVITY = 9.81
#: Part of the mass of a leg that its wheel has.
_IN_WHEEL = 0.5
_DENSITY = 450.0  # kg/m³, of a base without a given mass
_SAG = 0.03  # m; deflection of a slide under the robot's weight
_BASE, _RUBBER = "#4C6A92", "#34373B"


@dataclass(frozen=True)
class Dimensions:
    """Values of the simulation, complete for every robot.

    Attributes:
        mass, leg_mass: whole robot, moving part of one leg with its wheel, kg.
        radius, width: of the wheels, m.
        leg_force, wheel_torque: largest force along each axis of a leg (N), largest torque at a wheel (Nm).
        friction: coefficient.
        steers: whether the wheels steer.
        stiffness, damping: of a slide that holds its position, N/m and Ns/m.
        wheel_gain: torque per speed difference at a wheel, Nms.
    """

    mass: float
    leg_mass: float
    radius: float
    width: float
    leg_force: float
    wheel_torque: float
    friction: float
    steers: bool
    stiffness: float
    damping: float
    wheel_gain: float

    @property
    def weight(self) -> float:
        """Weight, N."""
        return self.mass * GRAVITY

    @classmethod
    def of(cls, robot: Robot) -> Dimensions:
        """Returns the robot's values, with those from its size where its file has none."""
        given = robot.physics
        mass = given.mass or _DENSITY * sum(float(np.prod(box.size)) for box in trunk(robot))
        radius = wheel_radius(robot)
        weight, leg_mass = mass * GRAVITY, mass * given.leg_share / 4
        stiffness = weight / _SAG
        return cls(
            mass, leg_mass, radius, given.wheel_width or 0.7 * radius, given.leg_force or 1.2 * weight,
            given.wheel_torque or 0.6 * weight * radius, given.friction, robot.drive.factor(np.pi / 2) < np.inf,
            stiffness, 2.0 * np.sqrt(stiffness * leg_mass), radius**2 * weight / 4 / 0.1,
        )  # fmt: skip


def robot_mjcf(robot: Robot) -> str:
    """Returns a robot alone, as MJCF text."""
    root = ElementTree.Element("mujoco", model=robot.name)
    add_robot(root, robot, np.array([0.0, 0.0, robot.stance.base_height]))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def add_robot(root: ElementTree.Element, robot: Robot, place: np.ndarray) -> None:
    """Adds a robot and its motors to a model.

    Args:
        root: element ``mujoco``.
        robot: the robot.
        place: base position, float64 [3], m.
    """
    size = Dimensions.of(robot)
    _settings(root)
    world, actuators = child(root, "worldbody"), child(root, "actuator")
    base = ElementTree.SubElement(world, "body", name=BASE_FRAME, pos=_text(place))
    ElementTree.SubElement(base, "freejoint", name=BASE_FRAME)
    _base(base, robot, size)
    for foot, hip, color in zip(FEET, robot.hips(), FOOT_COLORS, strict=True):
        _leg(base, actuators, robot, size, foot, hip, color)


def _settings(root: ElementTree.Element) -> None:
    child(root, "compiler").set("angle", "radian")
    child(root, "compiler").set("autolimits", "true")
    child(root, "option").attrib |= {
        "timestep": "0.002", "integrator": "implicitfast", "cone": "elliptic", "impratio": "10", "iterations": "20",
        "gravity": f"0 0 {-GRAVITY}",
    }  # fmt: skip


def add_light(root: ElementTree.Element) -> None:
    """Adds light and a white sky, for pictures."""
    visual, asset = child(root, "visual"), child(root, "asset")
    ElementTree.SubElement(visual, "headlight", ambient=".42 .42 .42", diffuse=".15 .15 .15", specular="0 0 0")
    ElementTree.SubElement(visual, "global", offwidth="1920", offheight="1440")
    ElementTree.SubElement(visual, "quality", shadowsize="4096")
    ElementTree.SubElement(visual, "map", znear="0.01", shadowclip="4")
    ElementTree.SubElement(
        asset, "texture", name="sky", type="skybox", builtin="flat", rgb1="1 1 1", rgb2="1 1 1", width="8", height="48"
    )
    ElementTree.SubElement(
        child(root, "worldbody"), "light", pos="0 0 8", dir=".3 .45 -1", type="directional", castshadow="true",
        diffuse=".5 .5 .5", specular="0 0 0",
    )  # fmt: skip


def _base(base: ElementTree.Element, robot: Robot, size: Dimensions) -> None:
    """Inertia and shapes; the centre of mass with neutral legs is the one in the robot file."""
    stance, boxes = robot.stance, trunk(robot)
    own = size.mass - 4 * size.leg_mass
    wheels = np.array([0.0, 0.0, size.radius - stance.base_height])
    center = (size.mass * np.array([stance.mass_x, 0.0, stance.mass_z]) - 4 * size.leg_mass * wheels) / own
    length, width, height = np.max([box.size for box in boxes], axis=0)
    inertia = own / 12 * np.array([width**2 + height**2, length**2 + height**2, length**2 + width**2])
    ElementTree.SubElement(base, "inertial", pos=_text(center), mass=f"{own:g}", diaginertia=_text(inertia))
    for box in boxes:
        _geom(base, "box", box.center, np.array(box.size) / 2, color=_BASE)
    bottom = min(box.center[2] - box.size[2] / 2 for box in boxes)
    highest = max(box.above for box in robot.body.boxes)
    for part in robot.body.boxes:
        if part.above < highest:
            low = part.above - stance.base_height
            middle = (part.x_min + part.x_max) / 2, 0.0, (low + bottom) / 2
            half = (part.x_max - part.x_min) / 2, part.half_width, max(bottom - low, 0.02) / 2
            _geom(base, "box", middle, half, color=None)


def _leg(base, actuators, robot: Robot, size: Dimensions, foot: str, hip: np.ndarray, color: str) -> None:
    leg = ElementTree.SubElement(base, "body", name=f"{foot}_leg", pos=_text(hip))
    carried = size.leg_mass * (1 - _IN_WHEEL)
    spread = 0.4 * carried * size.radius**2
    ElementTree.SubElement(leg, "inertial", pos="0 0 0", mass=f"{carried:g}", diaginertia=_text([spread] * 3))
    for name, axis in zip(leg_joints(foot), np.eye(3, dtype=int), strict=True):
        ElementTree.SubElement(leg, "joint", name=name, type="slide", axis=_text(axis))
        _motor(actuators, name, size.leg_force, size.stiffness, size.damping)
    if size.steers:
        name = f"{foot}_steering"
        ElementTree.SubElement(leg, "joint", name=name, type="hinge", axis="0 0 1", armature=f"{2 * spread:g}")
        _motor(actuators, name, 10 * size.wheel_torque, 2500.0 * 4 * spread, 2 * 50.0 * 4 * spread)
    wheel = ElementTree.SubElement(leg, "body", name=wheel_frame(foot))
    mass, half = size.leg_mass * _IN_WHEEL, size.width / 2
    across, along = mass * (3 * size.radius**2 + size.width**2) / 12, mass * size.radius**2 / 2
    ElementTree.SubElement(wheel, "inertial", pos="0 0 0", mass=f"{mass:g}", diaginertia=_text([across, along, across]))
    name = f"{foot}_wheel_joint"
    ElementTree.SubElement(wheel, "joint", name=name, type="hinge", axis="0 1 0")
    _motor(actuators, name, size.wheel_torque, 0.0, size.wheel_gain)
    tyre = _geom(wheel, "ellipsoid", (0, 0, 0), (size.radius, half, size.radius), color=None, name=f"{foot}_tyre")
    tyre.attrib |= {"friction": f"{size.friction:g} 0.005 0.0001", "solref": "0.01 1"}
    upright = "0.7071068 0.7071068 0 0"
    for share, thick, shade in ((1.0, 0.5, _RUBBER), (0.5, 0.58, color)):
        _seen(wheel, "cylinder", f"{share * size.radius:g} {thick * size.width:g}", shade, quat=upright)
    _seen(wheel, "box", _text([0.75 * size.radius, 0.6 * size.width, 0.09 * size.radius]), color)


def _motor(actuators: ElementTree.Element, joint: str, limit: float, stiffness: float, damping: float) -> None:
    """Motor with force ``ctrl - stiffness * position - damping * speed``, whose damping the integrator knows."""
    ElementTree.SubElement(
        actuators, "general", name=joint, joint=joint, biastype="affine", gainprm="1",
        biasprm=f"0 {-stiffness:g} {-damping:g}", forcerange=f"{-limit:g} {limit:g}",
    )  # fmt: skip


def _geom(body, kind: str, place, half, color: str | None, **names: str) -> ElementTree.Element:
    """A shape that touches the ground; without a colour it is not drawn."""
    values = {
        "type": kind, "pos": _text(place), "size": _text(half), "rgba": _rgba(color or _BASE), "mass": "0",
        "contype": "0", "conaffinity": "1", "group": "0" if color else "3", **names,
    }  # fmt: skip
    return ElementTree.SubElement(body, "geom", values)


def _seen(body: ElementTree.Element, kind: str, size: str, color: str, **more: str) -> None:
    values = {"type": kind, "size": size, "rgba": _rgba(color), "mass": "0", "contype": "0", "conaffinity": "0"}
    ElementTree.SubElement(body, "geom", values | more)


def _rgba(color: str) -> str:
    return _text(np.array([*rgb(color), 255]) / 255)


def _text(values) -> str:
    return " ".join(f"{value:.7g}" for value in np.asarray(values, float).tolist())


def child(root: ElementTree.Element, name: str) -> ElementTree.Element:
    """Returns the element with a name directly below another one, a new one if there is none."""
    found = root.find(name)
    return ElementTree.SubElement(root, name) if found is None else found
