"""Speed and acceleration limits, which give motions their times."""

from typing import Annotated

from pydantic import Field

from hdsp.base.settings import Positive, checked, unit

_FASTEST = 100.0  # a larger value is in another unit

Speed = Annotated[Positive, Field(le=_FASTEST), unit("m/s")]
TurnSpeed = Annotated[Positive, Field(le=_FASTEST), unit("rad/s")]
Acceleration = Annotated[Positive, Field(le=_FASTEST), unit("m/s²")]
TurnAcceleration = Annotated[Positive, Field(le=_FASTEST), unit("rad/s²")]


@checked
class Speeds:
    """Largest speeds in a motion with times (``hdsp.detailed.motion.timing``). Plans and labels do not depend on them.

    Attributes:
        drive: base and wheels over the ground, while wheels roll.
        turn: base heading.
        foot: a foot along and across the base, rolling or in the air.
        lift: a foot up or down, relative to the base.
        shift: base over resting feet, along the ground.
        height: base up or down.
        lean: base roll and pitch, each.
    """

    drive: Speed = 0.5
    turn: TurnSpeed = 0.5
    foot: Speed = 0.3
    lift: Speed = 0.2
    shift: Speed = 0.15
    height: Speed = 0.1
    lean: TurnSpeed = 0.2


@checked
class Accelerations:
    """Largest accelerations in a motion with times, for the same quantities as ``Speeds``.

    Attributes:
        drive: base and wheels over the ground, while wheels roll.
        turn: base heading.
        foot: a foot along and across the base, rolling or in the air.
        lift: a foot up or down, relative to the base.
        shift: base over resting feet, along the ground.
        height: base up or down.
        lean: base roll and pitch, each.
    """

    drive: Acceleration = 0.5
    turn: TurnAcceleration = 1.0
    foot: Acceleration = 1.0
    lift: Acceleration = 1.0
    shift: Acceleration = 0.5
    height: Acceleration = 0.5
    lean: TurnAcceleration = 1.0
