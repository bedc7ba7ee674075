"""Masses, wheels and motors of a robot, for its simulation (``hdsp.planning.driving``)."""

from typing import Annotated

from pydantic import Field

from hdsp.base.settings import NotNegative, Positive, checked, unit

_LARGEST = 10.0  # m, of a wheel


@checked
class Physics:
    """Masses, wheels and motors for the simulation. Plans and labels do not depend on them.

    A key without a value gets one from the robot's size.

    Attributes:
        mass: whole mass; null = 450 kg for each cubic metre in the base.
        leg_share: share of the mass in the moving parts of the four legs, half of it in the wheels.
        friction: friction coefficient between ground and robot.
        wheel_radius: radius of the wheels; null = drive.wheel_radius, or feet.clearance without it.
        wheel_width: width of the wheels; null = 0.7 times the radius.
        leg_force: largest force of a leg along each of its axes; null = 1.2 times the weight.
        wheel_torque: largest torque at each wheel; null = 0.6 times weight and wheel radius.
        steer_speed: largest speed at which a wheel steers.
    """

    mass: Annotated[Positive, unit("kg")] | None = None
    leg_share: Annotated[NotNegative, Field(gt=0, le=0.8)] = 0.16
    friction: Annotated[Positive, Field(le=5)] = 0.8
    wheel_radius: Annotated[Positive, Field(le=_LARGEST), unit("m")] | None = None
    wheel_width: Annotated[Positive, Field(le=_LARGEST), unit("m")] | None = None
    leg_force: Annotated[Positive, unit("N")] | None = None
    wheel_torque: Annotated[Positive, unit("Nm")] | None = None
    steer_speed: Annotated[Positive, unit("rad/s")] = 3.0
