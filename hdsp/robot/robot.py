"""The robot as data: geometry, limits and cost constants. Presets are YAML files in ``hdsp/robot/presets``.

To add a robot, write one YAML file like ``presets/momaro.yaml`` and pass its path wherever a robot is named.
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

_PRESETS = resources.files("hdsp.robot") / "presets"

#: Order of the feet in every array that has an axis of four.
FEET = ("front_left", "rear_left", "rear_right", "front_right")

_LONGEST_STEP = 15  # cells; the code of an action has no larger number (hdsp.detailed.states)
_OFFSETS = 32  # lattice steps; the code of a state has no more foot offsets

Metres = Annotated[float, unit("m")]
PositiveMetres = Annotated[Positive, unit("m")]
NotNegativeMetres = Annotated[NotNegative, unit("m")]
NotNegativeRadians = Annotated[NotNegative, unit("rad")]
#: Angle between the heading and a direction.
Deviation = Annotated[float, Field(gt=0, le=math.pi), unit("rad")]


@checked
class Feet:
    """Positions of the feet in the robot frame, the room that they need, and the ground that they feel.

    Attributes:
        neutral_x: neutral position of the front left foot, ahead of the base centre; the rear feet mirror it.
        neutral_y: neutral position of the front left foot, to the left of the base centre; the right feet mirror it.
        offset_min: reach of a foot backward, relative to its neutral position; 0 or negative.
        offset_max: reach of a foot forward, relative to its neutral position.
        clearance: distance that a foot keeps from edges no wheel passes.
        min_separation: least distance between the front and the rear foot of one side.
        neutral_preference: state cost of one metre off the neutral position when feet are chosen.
        contact_inward: distance from the foot to the middle of the ground that it feels, toward the body, along x and
            along y.
        contact_half_width: half the side of the square of ground that a foot feels; its most uneven cell counts.
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
        if max(abs(self.offset_min), abs(self.offset_max)) < metres(_OFFSETS):
            low, high = offset_steps([self.offset_min, self.offset_max])
            if low <= 0 <= high and high - low < _OFFSETS:
                return self
        need = f"offsets that include 0 and span less than {metres(_OFFSETS):g} m"
        raise fault("offset_max", self.offset_max, f"{need} (offset_min is {self.offset_min:g} m)")


@checked
class Rectangle:
    """A rectangle in the robot frame: x in [x_min, x_max], |y| <= half_width.

    Attributes:
        x_min: rear end of the rectangle.
        x_max: front end of the rectangle.
        half_width: half the width of the rectangle.
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
    """A rectangle that has to stay free above a height. Heights are measured from the lower one of two grounds: the
    ground under the base centre, and the mean of the ground under the neutral feet.

    Attributes:
        above: height above which nothing may rise into the rectangle.
    """

    above: PositiveMetres


@checked
class Body:
    """The body of the robot.

    Attributes:
        boxes: rectangles that have to stay free, each above its height.
    """

    boxes: tuple[Box, ...]


@checked
class DeviationCost:
    """Factor on the cost of driving by the angle between heading and direction of travel, linear between its knots.

    Attributes:
        ahead: factor straight ahead.
        side: factor at all angles between side_from and side_to.
        behind: factor straight back.
        side_from: angle from which on the factor is the one of driving sideways.
        side_to: angle up to which the factor is the one of driving sideways.
    """

    ahead: Positive
    side: Positive
    behind: Positive
    side_from: Deviation
    side_to: Deviation

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.side_from > self.side_to:
            raise fault("side_from", self.side_from, f"at most side_to, {self.side_to:g}")
        return self

    def __call__(self, deviation: float) -> float:
        knots = [0.0, self.side_from, self.side_to, math.pi]
        return float(np.interp(deviation, knots, [self.ahead, self.side, self.side, self.behind]))


@checked
class Drive:
    """Driving, and the ground on which wheels can.

    Attributes:
        max_height_difference: largest height difference between neighbouring cells that a wheel passes.
        unevenness_radius: distance from a foot within which height differences make it uneven.
        unevenness_cost: rise of the cost factor per metre of summed height differences.
        straight_deviation: largest angle between heading and direction of travel on feet that are not level.
        level: largest height difference between feet that are level.
        deviation_cost: factor by the direction of travel.
    """

    max_height_difference: PositiveMetres
    unevenness_radius: PositiveMetres
    unevenness_cost: Annotated[Positive, unit("1/m")]
    straight_deviation: NotNegativeRadians
    level: NotNegativeMetres
    deviation_cost: DeviationCost


@checked
class Turn:
    """Turning on the spot.

    Attributes:
        cost: cost of one heading step of the detailed lattice (5.625 degrees).
        unevenness_cost: rise of the cost factor per metre of the summed unevenness of the feet.
    """

    cost: Positive
    unevenness_cost: Annotated[NotNegative, unit("1/m")]


@checked
class FootMove:
    """Driving of one foot along x under a base that rests.

    Attributes:
        cost_per_metre: cost of one metre, times the cost factor of that foot.
    """

    cost_per_metre: Annotated[Positive, unit("1/m")]


@checked
class BaseShift:
    """Motion of the base along x over feet that rest.

    Attributes:
        cost_per_metre: cost of one metre.
        backward: whether the base also moves backward.
    """

    cost_per_metre: Annotated[Positive, unit("1/m")]
    backward: bool


@checked
class Step:
    """A step of one foot along x.

    Attributes:
        backward: whether feet also step backward.
        max_length: largest distance between the two footholds; 0 = the robot does not step.
        max_height: largest height difference between the two footholds.
        max_clearance: largest height of the ground between the two footholds, above the lower one.
        cost: cost of any step.
        cost_per_metre: cost of one metre of length.
        cost_per_height: cost of one metre of height difference.
        support_margin: least distance of the base centre from the edges of the support polygon of the other three feet;
            negative = outside of it.
    """

    backward: bool
    max_length: Annotated[NotNegativeMetres, Field(le=metres(_LONGEST_STEP))]
    max_height: NotNegativeMetres
    max_clearance: NotNegativeMetres
    cost: NotNegative
    cost_per_metre: Annotated[NotNegative, unit("1/m")]
    cost_per_height: Annotated[NotNegative, unit("1/m")]
    support_margin: Metres


@checked
class Legs:
    """Hips and lengths of the legs. Plans and labels do not depend on them.

    Attributes:
        hip_x: hip of the front left leg, ahead of the base centre; the rear legs mirror it.
        hip_y: hip of the front left leg, to the left of the base centre; the right legs mirror it.
        min_length: least distance from the hip to the point where the foot touches the ground.
        max_length: largest distance from the hip to the point where the foot touches the ground.
    """

    hip_x: NotNegativeMetres
    hip_y: NotNegativeMetres
    min_length: NotNegativeMetres
    max_length: NotNegativeMetres


@checked
class Stance:
    """Limits of the base when a plan becomes a motion (``hdsp.detailed.motion.refinement``). Plans and labels do not
    depend on them.

    Attributes:
        base_height: height of the hips above the ground on neutral feet; ``Box.above`` is measured on a robot that
            stands so.
        max_roll: largest roll of the base.
        max_pitch: largest pitch of the base.
        reach_x: largest motion of the base over resting feet, ahead or back.
        reach_y: largest motion of the base over resting feet, sideways.
        mass_x: centre of mass ahead of the origin of the base, which lies between the hips.
        mass_z: centre of mass above the origin of the base.
        margin: least distance of the centre of mass from the edges of the support polygon, seen from above.
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


#: Parts of a robot on which motions depend, but neither plans nor labels.
_OF_MOTIONS = ("legs", "stance")


@checked
class Robot:
    """All that the planner knows about a robot.

    Convention: metres and radians in the robot frame, x forward, y left; feet in the order of ``FEET``. Costs are
    unitless.

    Attributes:
        name: name of the robot; trained abstractions go by it.
        feet: positions of the feet, their room and their ground.
        body: the space that the body needs.
        drive: driving, and the ground on which wheels can.
        turn: turning on the spot.
        foot_move: driving of one foot along x.
        base_shift: motion of the base over resting feet.
        step: steps of single feet.
        legs: hips and lengths of the legs.
        stance: limits of the base when a plan becomes a motion.
    """

    name: Name
    feet: Feet
    body: Body
    drive: Drive
    turn: Turn
    foot_move: FootMove
    base_shift: BaseShift
    step: Step
    legs: Legs
    stance: Stance

    @model_validator(mode="after")
    def _check(self) -> Self:
        legs, height = self.legs, self.stance.base_height
        if not legs.min_length <= height <= legs.max_length:
            reach = f"{legs.min_length:g} to {legs.max_length:g} m (legs.min_length, legs.max_length)"
            raise fault("stance.base_height", height, f"a height that the legs reach, {reach}")
        return self

    @classmethod
    def load(cls, source: "str | Path | dict | Robot") -> "Robot":
        """A robot from the name of a preset, the path of a YAML file, or a mapping with the same keys.

        Raises:
            InputError: for an unknown preset, a missing file, an unknown or missing key, or a value out of range.
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
