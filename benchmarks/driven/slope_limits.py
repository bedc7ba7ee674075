"""The steepest ground on which a simulated robot drives, beside the limits of its planner.

The ground is one ramp. The robot drives a metre up, a metre down (`pitch`), and a metre across (`roll`). Beyond its
limit of slope, it plans as if its limits were as large as the slope.
"""

import math
from dataclasses import replace
from typing import Any

from benchmarks.driven.runs import driven, solve
from benchmarks.driven.tasks import BELOW, Pose, Task, map_of
from hdsp.robot.robot import Robot
from hdsp.terrain.obstacles import Ramp, Scene

_SIZE = 5.0, 3.0  # m
_STEEPEST = math.radians(60)
_CLOSE = math.radians(0.5)
_WAYS: dict[str, tuple[tuple[Pose, Pose], ...]] = {
    "pitch": (((2.0, 1.5, 0.0), (3.0, 1.5, 0.0)), ((3.0, 1.5, math.pi), (2.0, 1.5, math.pi))),
    "roll": (((2.5, 1.0, math.pi / 2), (2.5, 2.0, math.pi / 2)),),
}


def slope_limits(robot: Robot) -> dict[str, dict[str, Any]]:
    """Returns, for `pitch` and `roll`, in degrees: the planner's limit, and the steepest ground that the robot drives.

    ``below`` tells whether the robot drives 2 degrees below its limit, ``ends`` how drives end on ground that is half a
    degree steeper than the steepest.
    """
    return {name: _limit(robot, name) for name in _WAYS}


def _limit(robot: Robot, name: str) -> dict[str, Any]:
    limit = robot.slope.max_pitch if name == "pitch" else robot.slope.max_roll
    low, high, ends = 0.0, _STEEPEST, ["not driven"]
    below = not _faults(robot, name, limit - BELOW)
    if below:
        low = limit - BELOW
        if faults := _faults(robot, name, limit):
            high, ends = limit, faults
        else:
            low = limit
    while high - low > _CLOSE:
        middle = (low + high) / 2
        if faults := _faults(robot, name, middle):
            high, ends = middle, faults
        else:
            low = middle
    return {
        "planned": round(math.degrees(limit), 1), "driven": round(math.degrees(low), 1), "below": below, "ends": ends
    }  # fmt: skip


def _faults(robot: Robot, name: str, angle: float) -> list[str]:
    """Ends of the drives that do not arrive on ground of this angle, rad."""
    robot, height = _with_limit(robot, angle), math.tan(angle) * _SIZE[0]
    scene = Scene((Ramp(_SIZE[0] / 2, _SIZE[1] / 2, 0.0, _SIZE[0], _SIZE[1], height),))
    faults = []
    for start, goal in _WAYS[name]:
        task = Task(map_of(scene, _SIZE), scene, start, goal)
        plan = solve(task, robot)
        end = "no_motion" if plan is None else driven(task, plan, 0)["ending"]
        if end != "arrived":
            faults.append(end)
    return faults


def _with_limit(robot: Robot, angle: float) -> Robot:
    """The robot with limits of slope, and of its base, that allow an angle (rad)."""
    slope, stance = robot.slope, robot.stance
    pitch, roll = (max(limit, angle + 0.02) for limit in (slope.max_pitch, slope.max_roll))
    return replace(
        robot,
        slope=replace(slope, max_pitch=pitch, max_roll=roll),
        stance=replace(stance, max_pitch=max(pitch, stance.max_pitch), max_roll=max(roll, stance.max_roll)),
    )
