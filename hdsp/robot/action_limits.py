"""Driving, turning, foot motions and steps of a robot: limits and costs."""

import math
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from hdsp.base.settings import NotNegative, Positive, checked, fault, unit
from hdsp.robot.lattice import metres
from hdsp.robot.quantities import (
    Deviation,
    FactorOrNever,
    Inclination,
    Metres,
    NotNegativeMetres,
    NotNegativeRadians,
    PositiveMetres,
)

LONGEST_STEP = 15  # cells; the largest step length in an action code (hdsp.detailed.actions.action)


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
