"""Feet, body and legs of a robot, and the limits of its stance."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from hdsp.base.settings import NotNegative, checked, fault, unit
from hdsp.robot.lattice import metres, offset_steps
from hdsp.robot.quantities import Lean, Metres, NotNegativeMetres, PositiveMetres

OFFSETS = 32  # lattice steps; the number of foot offsets in a state code


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
    clearance: Annotated[NotNegativeMetres, Field(le=1.0)]
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
        if self.min_separation > 2 * self.neutral_x:
            need = f"at most {2 * self.neutral_x:g} m, the distance of neutral feet (twice neutral_x)"
            raise fault("min_separation", self.min_separation, need)
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
        boxes: rectangles that have to stay free, each above its height; at least one.
    """

    boxes: Annotated[tuple[Box, ...], Field(min_length=1)]


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
    max_roll: Lean
    max_pitch: Lean
    reach_x: NotNegativeMetres
    reach_y: NotNegativeMetres
    mass_x: Metres
    mass_z: Metres
    margin: NotNegativeMetres
    swing_clearance: NotNegativeMetres
