"""A margin around the base of a robot."""

from dataclasses import replace

import numpy as np

from hdsp.base.errors import InputError
from hdsp.robot.robot import Box, Robot


def with_margin(robot: Robot, margin: float) -> Robot:
    """Returns the robot with a base wider by a margin (m) on all sides.

    The planner tests the body at the centres of cells. An obstacle in a cell lies up to half a diagonal, 18 mm, from
    its centre. With this margin a turned base touches no cell that the map shows as too high. Noise in the map needs
    more. Feet keep their own clearance. The room between the legs stays the same: on stairs the next edge nearly fills
    it.

    Raises:
        InputError: the margin is not a number >= 0.
    """
    if not (np.isfinite(margin) and margin >= 0):
        raise InputError(f"margin is {margin}; it must be a finite number >= 0, in m")
    base = max((box.above for box in robot.body.boxes), default=0.0)
    boxes = tuple(_widened(box, margin) if box.above == base else box for box in robot.body.boxes)
    return replace(robot, body=replace(robot.body, boxes=boxes))


def _widened(box: Box, margin: float) -> Box:
    return replace(box, x_min=box.x_min - margin, x_max=box.x_max + margin, half_width=box.half_width + margin)
