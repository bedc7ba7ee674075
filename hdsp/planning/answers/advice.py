"""Advice for a query without a plan: changes of the map or of the query that would or may help.

Each piece of advice rests on a test of the case at hand: the tolerance within which the nearest pose lies, the ground
in a conditioned map, a body that hits the ground with its margin only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hdsp.detailed.base_pose import base_poses
from hdsp.detailed.causes import Cause, Kind
from hdsp.planning.answers.nearest_pose import Nearest
from hdsp.robot.lattice import HEADINGS, Grid, rotation
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap

_TOLERANCE = 0.5  # m, largest distance from a goal that is still worth a tolerance
_ROUNDING = 0.02  # m, between a goal and the centre of its cell
_HALF_TURN = math.pi / HEADINGS  # rad, between a goal's heading and the nearest one on the lattice


def advice_for(
    terrain: HeightMap,
    measured: HeightMap | None,
    robot: Robot,
    wider: Robot,
    causes: Sequence[Cause],
    nearest: Nearest | None,
    feet_given: bool = False,
) -> tuple[str, ...]:
    """Returns advice in words.

    Args:
        terrain: the map.
        measured: the planner's map, without changes under the start; None if it is conditioned already.
        robot: the robot.
        wider: the robot with its margin.
        causes: why there is no plan.
        nearest: the pose in reach that is nearest to the goal; None without one.
        feet_given: whether the goal names the feet on which the robot arrives.
    """
    found = []
    if nearest is not None and feet_given:
        if nearest.at_goal:
            without = "" if any(nearest.pose[3:]) else "; without foot offsets there is a plan"
            found.append(f"the robot gets to the pose, but not onto these feet{without}")
    # With a tolerance, the robot arrives on neutral feet.
    elif nearest is not None and nearest.distance <= _TOLERANCE and not (any(nearest.pose[3:]) or nearest.at_goal):
        found.append(_tolerance(nearest.distance, nearest.turn))
    if measured is not None and (healed := _healed(measured, causes)):
        found.append(f"a conditioned map has {healed} there")
    if wider != robot and any(cause.kind == Kind.BODY and not _hits(terrain, robot, cause) for cause in causes):
        found.append("without the margin the body does not hit the ground there")
    return tuple(found)


def _tolerance(distance: float, turn: float) -> str:
    degrees = math.ceil(math.degrees(turn + _HALF_TURN) - 1e-6) if turn else 0
    if distance == 0:
        return f"a goal with a free heading, or a tolerance of {degrees} degrees, has a plan"
    also = f" and {degrees} degrees" if degrees else ""
    return f"with a goal tolerance of {distance + _ROUNDING:.2f} m{also} there is a plan"


def _healed(measured: HeightMap, causes: Sequence[Cause]) -> str | None:
    """Ground at the causes in a conditioned map, in words, if conditioning removes a cause."""
    if not any(cause.kind in (Kind.UNKNOWN, Kind.EDGE) for cause in causes):
        return None
    after = measured.conditioned().terrain
    grid = Grid(after.origin, after.shape)
    for cause in causes:
        x, y = grid.cell(cause.place)
        near = after.heights[max(x - 1, 0) : x + 2, max(y - 1, 0) : y + 2]
        if cause.kind == Kind.UNKNOWN and np.isfinite(after.heights[x, y]):
            return "known ground"
        if cause.kind == Kind.EDGE and np.nanmax(abs(near - after.heights[x, y])) <= (cause.limit or 0.0):
            return "no edge"
    return None


def _hits(terrain: HeightMap, robot: Robot, cause: Cause) -> bool:
    """Whether the body of a robot hits the ground at the place of a cause."""
    if cause.pose is None or cause.amount is None:
        return True
    state = np.array(cause.pose)
    feet = robot.foot_positions(state)
    heights = np.asarray(terrain.height_at(feet[:, 0], feet[:, 1]), float)
    if not np.isfinite(heights).all():
        return True
    ground, roll, pitch = base_poses(robot, state[None, 3:], heights[None])[0]
    ahead, left = (np.array(cause.place) - state[:2]) @ rotation(float(state[2]))
    above = cause.amount - (ground - math.tan(pitch) * ahead + math.tan(roll) / math.cos(pitch) * left)
    return any(
        box.x_min - 1e-6 <= ahead <= box.x_max + 1e-6 and abs(left) <= box.half_width + 1e-6 and above > box.above
        for box in robot.body.boxes
    )
