"""Robot description: geometry, limits and cost constants as data. Presets are YAML files in ``hdsp/robot/presets``.

A new robot needs one YAML file like ``presets/momaro.yaml``; its path works wherever a robot name does.
"""

import hashlib
import json
import math
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from hdsp.base.errors import InputError
from hdsp.base.settings import Name, NotNegative, Positive, checked, fault, load_settings, parse_yaml, read_yaml, unit
from hdsp.robot.lattice import metres, offset_steps
from hdsp.robot.motion_limits import Accelerations, Speeds
from hdsp.robot.physics import Physics

_PRESETS = resources.files("hdsp.robot") / "presets"

#: Foot order in every array with a foot axis.
FEET = ("front_left", "rear_left", "rear_right", "front_right")

_LARGEST = 10.0  # m; a larger length is in another unit
LONGEST_STEP = 15  # cells; the largest step length in an action code (hdsp.detailed.actions.action)
OFFSETS = 32  # lattice steps; the number of foot offsets in a state code

Metres = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST), unit("m")]
PositiveMetres = Annotated[Positive, Field(le=_LARGEST), unit("m")]
NotNegativeMetres = Annotated[NotNegative, Field(le=_LARGEST), unit("m")]
NotNegativeRadians = Annotated[NotNegative, unit("rad")]
#: Inclination of the ground.
Inclination = Annotated[Positive, Field(lt=math.pi / 2), unit("rad")]
#: Factor on a cost; ``.inf`` in a robot file: not possible.
FactorOrNever = Annotated[float, Field(gt=0, allow_inf_nan=True)]
#: Angle between heading and direction.
Deviation = Annotated[float, Field(gt=0, le=math.pi), unit("rad")]


@checked
class Feet:
    """Foot positions in the robot frame, the feet's clearance, and their contact ground.

    Attributes:
        neutral_x: front left foot's neutral position, ahead of the base centre; the rear feet mirror it.
        neutral_y: front left foot's neutral position, to the left of the base centre; the right feet mirror it.
        offset_min: backward foot reach, relative to the neutral position; 0 or negative.
        offset_max: forward foot reach, relative to the neutral position.
        clearance: distance that a foot keeps from edges no wheel passes.
        min_separation: least distance between front foot and rear foot on one side.
        neutral_preference: state cost per metre away from the neutral position, when feet are chosen.
        contact_inward: distance from a foot to the centre of its contact ground, toward the body, along x and along y.
        contact_half_width: half the side of the square contact ground; the foot stands on its highest cell.
    """

    neutral_x: PositiveMetres
    neutral_y: PositiveMetres
    offset_min: Metres
    offset_max: Metres
    clearance: NotNegativeMetres
    min_separation: NotNegativeMetres
    neutral_preference: Annotated[NotNegative, unit("1/m")]
    contact_inward: NotNegativeMetres
    contact_half_width: NotNegativeMetres

    @model_validator(mode="after")
    def _check(self) -> Self:
        nearest = min(self.neutral_x, self.neutral_y)
        if self.contact_inward > nearest:
            need = f"at most {nearest:g} m, the distance of the feet from the middle of the body"
            raise fault("contact_inward", self.contact_inward, need)
        if max(abs(self.offset_min), abs(self.offset_max)) < metres(OFFSETS):
            low, high = offset_steps([self.offset_min, self.offset_max])
            if low <= 0 <= high and high - low < OFFSETS:
                return self
        need = f"offsets that include 0 and span less than {metres(OFFSETS):g} m"
        raise fault("offset_max", self.offset_max, f"{need} (offset_min is {self.offset_min:g} m)")


@checked
class Rectangle:
    """Rectangle in the robot frame: x in [x_min, x_max], abs(y) <= half_width.

    Attributes:
        x_min: rear end of the rectangle.
        x_max: front end of the rectangle.
        half_width: half the rectangle's width.
    """

    x_min: Metres
    x_max: Metres
    half_width: PositiveMetres

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.x_min < self.x_max:
            raise fault("x_min", self.x_min, f"less than x_max, {self.x_max:g} m")
        return self


@checked
class Box(Rectangle):
    """Rectangle that has to stay free above a height.

    The height counts from the ground of the base, the plane through the ground under the feet
    (`hdsp.detailed.base_pose`).

    Attributes:
        above: height above which nothing may rise into the rectangle.
    """

    above: PositiveMetres


@checked
class Body:
    """Robot body.

    Attributes:
        boxes: rectangles that have to stay free, each above its height.
    """

    boxes: tuple[Box, ...]


@checked
class DeviationCost:
    """Drive cost factor by the angle between heading and travel direction, linear between its knots.

    Attributes:
        ahead: factor straight ahead.
        side: factor at all angles between side_from and side_to; .inf = the same as drive.sideways false.
        behind: factor straight back; .inf = the robot does not drive backward.
        side_from: smallest angle with the side factor.
        side_to: largest angle with the side factor.
    """

    ahead: Positive
    side: FactorOrNever
    behind: FactorOrNever
    side_from: Deviation
    side_to: Deviation

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.side_from > self.side_to:
            raise fault("side_from", self.side_from, f"at most side_to, {self.side_to:g}")
        return self

    def __call__(self, deviation: float) -> float:
        if deviation > self.side_to + 1e-9 and math.isinf(self.behind):
            return math.inf
        behind = self.side if math.isinf(self.behind) else self.behind
        knots = [0.0, self.side_from, self.side_to, math.pi]
        return float(np.interp(deviation, knots, [self.ahead, self.side, self.side, behind]))


@checked
class Drive:
    """Driving, and its ground limits.

    An edge is a height difference between neighbouring cells. The highest edge that a wheel passes is either
    max_height_difference, or rolled_share of wheel_radius.

    Attributes:
        unevenness_radius: distance from a foot within which height differences count as unevenness.
        unevenness_cost: increase in the cost factor per metre of summed height differences.
        straight_deviation: largest angle between heading and travel direction, ahead or back, for a robot that cannot
            drive sideways, and for every robot while its feet are not level.
        level: largest height difference among level feet.
        deviation_cost: factor by travel direction.
        sideways: whether the robot drives in all directions, as with steered wheels.
        max_height_difference: highest edge that a wheel passes; null = from the wheel.
        wheel_radius: radius of the wheels; null = max_height_difference is given.
        rolled_share: highest edge that a wheel rolls over, as a share of its radius; null = max_height_difference is
            given.
    """

    unevenness_radius: PositiveMetres
    unevenness_cost: Annotated[Positive, unit("1/m")]
    straight_deviation: NotNegativeRadians
    level: NotNegativeMetres
    deviation_cost: DeviationCost
    sideways: bool = True
    max_height_difference: PositiveMetres | None = None
    wheel_radius: PositiveMetres | None = None
    rolled_share: Annotated[float, Field(gt=0, le=1)] | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        wheel = self.wheel_radius, self.rolled_share
        ways = "either max_height_difference, or wheel_radius and rolled_share"
        if self.max_height_difference is not None and wheel != (None, None):
            key = "wheel_radius" if self.wheel_radius is not None else "rolled_share"
            raise fault(key, getattr(self, key), f"{ways}; max_height_difference is {self.max_height_difference:g} m")
        if self.max_height_difference is None and None in wheel:
            key = "rolled_share" if self.wheel_radius is not None else "max_height_difference"
            raise fault(key, None, ways)
        return self

    @property
    def highest_edge(self) -> float:
        """Highest edge that a wheel passes, m."""
        if self.max_height_difference is not None:
            return self.max_height_difference
        assert self.wheel_radius is not None and self.rolled_share is not None
        return self.wheel_radius * self.rolled_share

    def factor(self, deviation: float) -> float:
        """Drive cost factor at an angle (rad, [0, pi]) between heading and travel direction; inf = not possible.

        A robot that cannot drive sideways drives within ``straight_deviation`` of its heading, ahead or back. It pays
        its way along the heading and its way across: the factor ahead or behind, times ``cos + sin`` of the angle.
        """
        if self.sideways and math.isfinite(self.deviation_cost.side):
            return self.deviation_cost(deviation)
        off = min(deviation, math.pi - deviation)
        if off > self.straight_deviation + 1e-9:
            return math.inf
        straight = self.deviation_cost.ahead if deviation <= math.pi / 2 else self.deviation_cost.behind
        return straight * (math.cos(off) + math.sin(off))


@checked
class Slope:
    """Steepest ground under a foot.

    Both limits are the half axes of an ellipse: the gradient of the ground in the robot frame lies within
    (tan max_pitch, tan max_roll). The base leans with the ground, up to the same limits.

    Attributes:
        max_pitch: largest inclination of the ground ahead.
        max_roll: largest inclination of the ground across.
    """

    max_pitch: Inclination
    max_roll: Inclination

    def steepest(self) -> tuple[float, float]:
        """Returns the largest gradients ahead and across."""
        return math.tan(self.max_pitch), math.tan(self.max_roll)


@checked
class Turn:
    """Rotation, on the spot or while the robot drives.

    Attributes:
        cost: cost per detailed heading step (5.625 degrees); on an arc in addition to the cost of driving.
        unevenness_cost: increase in the cost factor per metre of unevenness, summed over the feet.
        on_the_spot: whether the robot turns on the spot; otherwise it drives arcs, ahead and back.
        radius: least radius of an arc; null for a robot that turns on the spot.
    """

    cost: Positive
    unevenness_cost: Annotated[NotNegative, unit("1/m")]
    on_the_spot: bool = True
    radius: Annotated[PositiveMetres, Field(le=3.0)] | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.on_the_spot and self.radius is not None:
            raise fault("radius", self.radius, "null, or on_the_spot false")
        if not self.on_the_spot and self.radius is None:
            raise fault("radius", None, "the least radius of an arc (m), because on_the_spot is false")
        return self


@checked
class FootMove:
    """Drive motion of one foot along x under a resting base.

    Attributes:
        cost_per_metre: cost per metre, times this foot's cost factor.
    """

    cost_per_metre: Annotated[Positive, unit("1/m")]


@checked
class BaseShift:
    """Base motion along x over resting feet.

    Attributes:
        cost_per_metre: cost per metre.
        backward: whether the base also moves backward.
    """

    cost_per_metre: Annotated[Positive, unit("1/m")]
    backward: bool


@checked
class Step:
    """Step with one foot along x.

    Attributes:
        backward: whether feet also step backward.
        max_length: largest distance between the two footholds; 0 = the robot does not step.
        max_height: largest height difference between the two footholds.
        max_clearance: largest ground height between the two footholds, above the lower one.
        cost: fixed cost per step.
        cost_per_metre: cost per metre in length.
        cost_per_height: cost per metre in height difference.
        support_margin: least distance between the base centre and the edges of the other feet's support polygon;
            negative = outside it.
    """

    backward: bool
    max_length: Annotated[NotNegativeMetres, Field(le=metres(LONGEST_STEP))]
    max_height: NotNegativeMetres
    max_clearance: NotNegativeMetres
    cost: NotNegative
    cost_per_metre: Annotated[NotNegative, unit("1/m")]
    cost_per_height: Annotated[NotNegative, unit("1/m")]
    support_margin: Metres


@checked
class Legs:
    """Hips and leg lengths. Plans and labels do not depend on them.

    Attributes:
        hip_x: front left hip, ahead of the base centre; the rear hips mirror it.
        hip_y: front left hip, to the left of the base centre; the right hips mirror it.
        min_length: least distance between a hip and its foot's ground contact.
        max_length: largest distance between a hip and its foot's ground contact.
    """

    hip_x: NotNegativeMetres
    hip_y: NotNegativeMetres
    min_length: NotNegativeMetres
    max_length: NotNegativeMetres


@checked
class Stance:
    """Base limits when a plan becomes a motion (``hdsp.detailed.motion.refinement``). Plans and labels do not depend on
    them.

    Attributes:
        base_height: hip height above the ground on neutral feet; ``Box.above`` is measured on a robot at this height.
        max_roll: largest base roll.
        max_pitch: largest base pitch.
        reach_x: largest base motion over resting feet, ahead or back.
        reach_y: largest base motion over resting feet, sideways.
        mass_x: centre of mass, ahead of the base origin between the hips.
        mass_z: centre of mass, above the base origin.
        margin: least distance between the centre of mass and the support polygon's edges, seen from above.
        swing_clearance: height of a swinging foot above the highest ground on its way.
    """

    base_height: NotNegativeMetres
    max_roll: NotNegativeRadians
    max_pitch: NotNegativeRadians
    reach_x: NotNegativeMetres
    reach_y: NotNegativeMetres
    mass_x: Metres
    mass_z: Metres
    margin: NotNegativeMetres
    swing_clearance: NotNegativeMetres


#: Robot parts with influence on motions, but not on plans or labels.
_OF_MOTIONS = ("legs", "stance", "speeds", "accelerations", "physics")


@checked
class Robot:
    """All values that the planner knows about a robot.

    Convention: metres and radians in the robot frame, x forward, y left; feet in ``FEET`` order. Costs are unitless.

    Attributes:
        name: robot name; trained abstractions refer to it.
        feet: foot positions, clearance and contact ground.
        body: space for the body.
        drive: driving, and its ground limits.
        slope: steepest ground.
        turn: rotation.
        foot_move: drive motion of one foot along x.
        base_shift: base motion over resting feet.
        step: steps with single feet.
        legs: hips and leg lengths.
        stance: base limits when a plan becomes a motion.
        speeds: largest speeds in a motion.
        accelerations: largest accelerations in a motion.
        physics: masses, wheels and motors in a simulation.
    """

    name: Name
    feet: Feet
    body: Body
    drive: Drive
    slope: Slope
    turn: Turn
    foot_move: FootMove
    base_shift: BaseShift
    step: Step
    legs: Legs
    stance: Stance
    speeds: Speeds = Speeds()
    accelerations: Accelerations = Accelerations()
    physics: Physics = Physics()

    @model_validator(mode="after")
    def _check(self) -> Self:
        for lean in ("max_pitch", "max_roll"):
            of_base, of_ground = getattr(self.stance, lean), getattr(self.slope, lean)
            if of_base < of_ground:
                raise fault(f"stance.{lean}", of_base, f"at least slope.{lean}, {of_ground:g}: the base leans with it")
        legs, height = self.legs, self.stance.base_height
        if not legs.min_length <= height <= legs.max_length:
            reach = f"{legs.min_length:g} to {legs.max_length:g} m (legs.min_length, legs.max_length)"
            raise fault("stance.base_height", height, f"a height that the legs reach, {reach}")
        return self

    def __repr__(self) -> str:
        wheels = f"wheels pass edges of {self.drive.highest_edge:g} m"
        steps = f"steps of up to {self.step.max_length:g} m in length, {self.step.max_height:g} m in height"
        return f"Robot({self.name}: {wheels}, {steps if self.step.max_length else 'no steps'})"

    @classmethod
    def load(cls, source: "str | Path | dict | Robot") -> "Robot":
        """Loads a robot from a preset name, a YAML file path, or a mapping with the same keys.

        Raises:
            InputError: the preset or file does not exist, a key is unknown or missing, or a value is out of range.

        Example:
            >>> robot = Robot.load("momaro")
            >>> robot.name, robot.step.max_height
            ('momaro', 0.3)
        """
        if not isinstance(source, str | Path):
            return load_settings(cls, source, "robot")
        path = Path(source)
        if path.suffix in (".yaml", ".yml"):
            document = read_yaml(path, "robot file")
        elif str(source) in cls.presets():
            document = parse_yaml(_PRESETS.joinpath(f"{source}.yaml").read_text(), f"preset {source}")
        else:
            presets = ", ".join(cls.presets())
            raise InputError(f"unknown robot {str(source)!r}: presets are {presets}, or give a .yaml file")
        return load_settings(cls, document.values, "robot", document)

    @staticmethod
    def presets() -> list[str]:
        """Returns the preset names."""
        return sorted(f.name[:-5] for f in _PRESETS.iterdir() if f.name.endswith(".yaml"))

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)

    def hash(self) -> str:
        """Returns a hex digest over all values with influence on plans and labels; the same on any machine."""
        values = {part: value for part, value in self.to_dict().items() if part not in _OF_MOTIONS}
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()

    def neutral_feet(self) -> np.ndarray:
        """Returns the neutral foot positions (x, y) in the robot frame, float64 [4, 2], m."""
        x, y = self.feet.neutral_x, self.feet.neutral_y
        return np.array([(x, y), (-x, y), (-x, -y), (x, -y)])

    def foot_positions(self, states) -> np.ndarray:
        """Returns the feet's world positions (x, y), float64 [..., 4, 2] m, at detailed states [..., 7] (m, m, rad, 4 x
        m).

        Convention: foot offsets are along the robot's x axis, from the neutral positions.
        """
        states = np.asarray(states, float)
        ahead = self.neutral_feet()[:, 0] + states[..., 3:]
        aside = self.neutral_feet()[:, 1]
        cos, sin = np.cos(states[..., 2:3]), np.sin(states[..., 2:3])
        turned = np.stack([cos * ahead - sin * aside, sin * ahead + cos * aside], axis=-1)
        return turned + states[..., None, :2]

    def hips(self) -> np.ndarray:
        """Returns the hips (x, y, z) in the base frame, float64 [4, 3], m."""
        x, y = self.legs.hip_x, self.legs.hip_y
        return np.array([(x, y, 0.0), (-x, y, 0.0), (-x, -y, 0.0), (x, -y, 0.0)])

    def offset_range(self) -> tuple[int, int]:
        """Returns the smallest and largest foot offset in lattice steps."""
        low, high = offset_steps([self.feet.offset_min, self.feet.offset_max])
        return int(low), int(high)

    def reach(self) -> float:
        """Returns the distance (m) from the base centre that no robot part and no foothold ever exceeds."""
        x = self.feet.neutral_x + max(self.feet.offset_max, -self.feet.offset_min) + self.step.max_length
        corners = [math.hypot(max(abs(r.x_min), abs(r.x_max)), r.half_width) for r in self.body.boxes]
        return max(math.hypot(x, self.feet.neutral_y), *corners)
