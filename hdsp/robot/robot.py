"""The robot as data: geometry, limits and cost constants. Presets are YAML files in ``hdsp/robot/presets``.

To add a robot, write one YAML file like ``presets/momaro.yaml`` and pass its path wherever a robot is named.
"""

import hashlib
import json
import math
from dataclasses import asdict, dataclass, fields, is_dataclass
from importlib import resources
from operator import attrgetter
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import yaml

from hdsp.base.errors import InputError
from hdsp.robot.lattice import RESOLUTION, offset_steps

_PRESETS = resources.files("hdsp.robot") / "presets"

#: Order of the feet in every array that has an axis of four.
FEET = ("front_left", "rear_left", "rear_right", "front_right")


@dataclass(frozen=True)
class Feet:
    """Where the feet are (m, robot frame), how much room they need, and which ground they feel.

    Attributes:
        neutral_x, neutral_y: of the front left foot; the others mirror it.
        offset_min, offset_max: reach along x, relative to the neutral position.
        clearance: no undrivable edge may lie this close.
        min_separation: between the front and the rear foot of one side.
        neutral_preference: state cost that one metre off the neutral position is worth when feet are chosen.
        contact_inward, contact_half_width: a foot pays for the most uneven ground in a square of this half width, whose
            middle is this far from the foot toward the body, in x and in y.
    """

    neutral_x: float
    neutral_y: float
    offset_min: float
    offset_max: float
    clearance: float
    min_separation: float
    neutral_preference: float
    contact_inward: float
    contact_half_width: float


@dataclass(frozen=True)
class Rectangle:
    """A rectangle in the robot frame, m: x in [x_min, x_max], |y| <= half_width."""

    x_min: float
    x_max: float
    half_width: float


@dataclass(frozen=True)
class Box(Rectangle):
    """A rectangle over which nothing may rise more than ``above`` metres over the ground: the lower of the ground under
    the base centre and the mean of that under the neutral feet."""

    above: float


@dataclass(frozen=True)
class Body:
    boxes: tuple[Box, ...]


@dataclass(frozen=True)
class DeviationCost:
    """Factor on driving by the angle between heading and direction of travel (rad): 1 ahead, ``side`` between
    ``side_from`` and ``side_to``, ``behind`` at pi, linear in between."""

    ahead: float
    side: float
    behind: float
    side_from: float
    side_to: float

    def __call__(self, deviation: float) -> float:
        knots = [0.0, self.side_from, self.side_to, math.pi]
        return float(np.interp(deviation, knots, [self.ahead, self.side, self.side, self.behind]))


@dataclass(frozen=True)
class Drive:
    max_height_difference: float
    unevenness_radius: float
    unevenness_cost: float
    straight_deviation: float
    level: float
    deviation_cost: DeviationCost


@dataclass(frozen=True)
class Turn:
    cost: float
    unevenness_cost: float


@dataclass(frozen=True)
class FootMove:
    cost_per_metre: float


@dataclass(frozen=True)
class BaseShift:
    cost_per_metre: float
    backward: bool


@dataclass(frozen=True)
class Step:
    backward: bool
    max_length: float
    max_height: float
    max_clearance: float
    cost: float
    cost_per_metre: float
    cost_per_height: float
    support_margin: float


@dataclass(frozen=True)
class Legs:
    """Hips in the frame of the base (m; those of the rear and right legs mirror these), and how long legs can be (m,
    from the hip to where the foot touches the ground)."""

    hip_x: float
    hip_y: float
    min_length: float
    max_length: float


@dataclass(frozen=True)
class Stance:
    """How a plan is made a motion (``hdsp.detailed.motion.refinement``); metres and radians.

    Attributes:
        base_height: of the hips above the ground on neutral feet; ``Box.above`` is measured on a robot that stands so.
        max_roll, max_pitch: how far the base may lean.
        reach_x, reach_y: how far the base may move over resting feet, ahead or behind and sideways.
        mass_x, mass_z: centre of mass in the frame of the base, which has its origin between the hips.
        margin: least distance of the centre of mass from the edges of the support polygon, seen from above.
        swing_clearance: how far above the highest ground on its way a foot swings.
    """

    base_height: float
    max_roll: float
    max_pitch: float
    reach_x: float
    reach_y: float
    mass_x: float
    mass_z: float
    margin: float
    swing_clearance: float


#: Parts of a robot on which motions depend, but neither plans nor labels.
_OF_MOTIONS = ("legs", "stance")


@dataclass(frozen=True)
class Robot:
    """Everything the planner knows about a robot.

    Convention: metres and radians in the robot frame, x forward, y left; feet in the order of ``FEET``.
    """

    name: str
    feet: Feet
    body: Body
    drive: Drive
    turn: Turn
    foot_move: FootMove
    base_shift: BaseShift
    step: Step
    legs: Legs
    stance: Stance

    @classmethod
    def load(cls, source: "str | Path | dict | Robot") -> "Robot":
        """A robot from the name of a preset, the path of a YAML file, or a mapping with the same keys.

        Raises:
            InputError: for an unknown preset, a missing file, an unknown or missing key, or a value out of range.
        """
        if isinstance(source, Robot):
            return source
        if isinstance(source, str | Path):
            source = _read_yaml(source)
        robot = _build(cls, source, "robot")
        _check(robot)
        return robot

    @staticmethod
    def presets() -> list[str]:
        """Names of the robots that come with the package."""
        return sorted(f.name[:-5] for f in _PRESETS.iterdir() if f.name.endswith(".yaml"))

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)

    def hash(self) -> str:
        """Hex digest of all values on which plans and labels depend; the same on any machine."""
        values = {part: value for part, value in self.to_dict().items() if part not in _OF_MOTIONS}
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()

    def neutral_feet(self) -> np.ndarray:
        """Neutral foot positions (x, y) in the robot frame, float64 [4, 2], m."""
        x, y = self.feet.neutral_x, self.feet.neutral_y
        return np.array([(x, y), (-x, y), (-x, -y), (x, -y)])

    def foot_positions(self, states) -> np.ndarray:
        """World (x, y) of the four feet, float64 [..., 4, 2] m, at detailed states [..., 7] (m, m, rad, 4 x m).

        Convention: foot offsets are along the x axis of the robot, from the neutral positions.
        """
        states = np.asarray(states, float)
        ahead = self.neutral_feet()[:, 0] + states[..., 3:]
        aside = self.neutral_feet()[:, 1]
        cos, sin = np.cos(states[..., 2:3]), np.sin(states[..., 2:3])
        turned = np.stack([cos * ahead - sin * aside, sin * ahead + cos * aside], axis=-1)
        return turned + states[..., None, :2]

    def hips(self) -> np.ndarray:
        """Hips (x, y, z) in the frame of the base, float64 [4, 3], m."""
        x, y = self.legs.hip_x, self.legs.hip_y
        return np.array([(x, y, 0.0), (-x, y, 0.0), (-x, -y, 0.0), (x, -y, 0.0)])

    def offset_range(self) -> tuple[int, int]:
        """Smallest and largest foot offset, in lattice steps."""
        low, high = offset_steps([self.feet.offset_min, self.feet.offset_max])
        return int(low), int(high)

    def reach(self) -> float:
        """Distance (m) from the base centre beyond which no part of the robot, nor a foothold, ever is."""
        x = self.feet.neutral_x + max(self.feet.offset_max, -self.feet.offset_min) + self.step.max_length
        corners = [math.hypot(max(abs(r.x_min), abs(r.x_max)), r.half_width) for r in self.body.boxes]
        return max(math.hypot(x, self.feet.neutral_y), *corners)


def _read_yaml(source: str | Path) -> dict:
    path = Path(source)
    if path.suffix in (".yaml", ".yml"):
        if not path.is_file():
            raise InputError(f"robot file {path} does not exist")
        text = path.read_text()
    elif str(source) in Robot.presets():
        text = _PRESETS.joinpath(f"{source}.yaml").read_text()
    else:
        presets = ", ".join(Robot.presets())
        raise InputError(f"unknown robot {str(source)!r}: presets are {presets}, or give a .yaml file")
    return yaml.safe_load(text)


def _build(kind: type, values: Any, where: str):
    """Build a (nested) dataclass from plain values, naming any key that does not fit."""
    if not isinstance(values, dict):
        raise InputError(f"{where}: need a mapping, got {values!r}")
    names = {f.name for f in fields(kind)}
    if unknown := sorted(set(values) - names):
        raise InputError(f"{where}: unknown key {unknown[0]!r}; allowed are {', '.join(sorted(names))}")
    if missing := sorted(names - set(values)):
        raise InputError(f"{where}: key {missing[0]!r} is missing")
    hints = get_type_hints(kind)
    return kind(**{name: _convert(hints[name], values[name], f"{where}.{name}") for name in names})


def _convert(hint: Any, value: Any, where: str):
    if is_dataclass(hint):
        return _build(hint, value, where)
    if hint == tuple[Box, ...]:
        if not isinstance(value, list | tuple):
            raise InputError(f"{where}: need a list of boxes, got {value!r}")
        return tuple(_build(Box, item, f"{where}[{i}]") for i, item in enumerate(value))
    if hint is bool:
        if not isinstance(value, bool):
            raise InputError(f"{where}: need true or false, got {value!r}")
        return value
    if hint is float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise InputError(f"{where}: need a finite number, got {value!r}")
        return float(value)
    return hint(value)


def _check(robot: Robot) -> None:
    limits = [(name, 0.0, True) for name in _POSITIVE] + [(name, 0.0, False) for name in _NOT_NEGATIVE]
    for name, least, above in limits:
        value = attrgetter(name)(robot)
        if value < least or (above and value == least):
            raise InputError(f"robot.{name} is {value:g}; it must {'be positive' if above else 'not be negative'}")
    if robot.step.max_length > _LONGEST_STEP * RESOLUTION + 1e-9:
        raise InputError(
            f"robot.step.max_length is {robot.step.max_length:g} m; it must not exceed {_LONGEST_STEP * RESOLUTION:g} m"
        )
    legs, height = robot.legs, robot.stance.base_height
    if not legs.min_length <= height <= legs.max_length:
        raise InputError(
            f"robot.stance.base_height is {height:g} m; legs of {legs.min_length:g} to {legs.max_length:g} m "
            "(robot.legs.min_length, max_length) must reach the ground from there"
        )
    inward, nearest = robot.feet.contact_inward, min(robot.feet.neutral_x, robot.feet.neutral_y)
    if inward > nearest:
        raise InputError(
            f"robot.feet.contact_inward is {inward:g} m; it must not exceed {nearest:g} m, what the feet are off the "
            "middle of the body"
        )
    low, high = robot.offset_range()
    if not (low <= 0 <= high and high - low < 32):
        raise InputError(
            f"robot.feet: offsets {robot.feet.offset_min:g} to {robot.feet.offset_max:g} m must include 0 "
            f"and span less than {32 * RESOLUTION:g} m"
        )


_POSITIVE = (
    "feet.neutral_x", "feet.neutral_y", "drive.max_height_difference", "drive.unevenness_radius",
    "drive.unevenness_cost", "drive.deviation_cost.ahead", "drive.deviation_cost.side", "drive.deviation_cost.behind",
    "drive.deviation_cost.side_from", "turn.cost", "foot_move.cost_per_metre", "base_shift.cost_per_metre",
)  # fmt: skip
_NOT_NEGATIVE = (
    "feet.clearance", "feet.min_separation", "feet.neutral_preference", "feet.contact_inward",
    "feet.contact_half_width", "turn.unevenness_cost", "step.max_length", "step.max_height", "step.max_clearance",
    "step.cost", "step.cost_per_metre", "step.cost_per_height", "legs.hip_x", "legs.hip_y", "legs.min_length",
    "stance.max_roll", "stance.max_pitch", "stance.reach_x", "stance.reach_y", "stance.margin",
    "stance.swing_clearance",
)  # fmt: skip
_LONGEST_STEP = 15  # cells; what the code of an action can say (hdsp.detailed.states)
