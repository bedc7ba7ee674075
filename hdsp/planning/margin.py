"""A margin around the body of a robot."""

import math
from dataclasses import replace

from hdsp.base.errors import InputError
from hdsp.planning.arguments import number
from hdsp.robot.robot import Robot
from hdsp.robot.shape import Box

#: m; half the diagonal of a cell, and the noise with which a robot knows its pose (docs/driving.md).
DRIVEN_MARGIN = 0.03


def with_margin(robot: Robot, margin: float) -> Robot:
    """Returns the robot with a body wider by a margin (m) on all sides, and lower by as much as it leans over it.

    The planner tests the body at the centres of cells. An obstacle in a cell lies up to half a diagonal, 18 mm, from
    its centre. With this margin a turned body touches no cell that the map shows as too high; between two states, while
    it turns, it may come a few millimetres nearer. Noise in the map needs more. Feet keep their own clearance.

    Raises:
        InputError: the margin is not a number >= 0, or brings the body down to the ground.
    """
    margin = number("margin", margin, 0.0)
    # The lower side of the body rises and falls with the ground under the feet.
    deeper = margin * math.hypot(*robot.slope.steepest())
    lowest = min(box.above for box in robot.body.boxes)
    if not deeper < lowest:
        raise InputError(f"margin is {margin}; the body of {robot.name} is only {lowest:g} m above the ground")
    boxes = tuple(_widened(box, margin, deeper) for box in robot.body.boxes)
    return replace(robot, body=replace(robot.body, boxes=boxes))


def _widened(box: Box, margin: float, deeper: float) -> Box:
    wider = {"x_min": box.x_min - margin, "x_max": box.x_max + margin, "half_width": box.half_width + margin}
    return replace(box, above=box.above - deeper, **wider)
