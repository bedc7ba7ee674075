"""Advice for a query without a plan: changes of the map or of the query that would or may help.

Each piece of advice rests on a test of the case at hand: the tolerance within which the nearest pose lies, the size of
a hole, an edge around a cell or two, a body that hits the ground with its margin only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hdsp.detailed.base_pose import base_poses
from hdsp.detailed.causes import Cause, Kind
from hdsp.planning.nearest_pose import Nearest
from hdsp.robot.lattice import Grid, rotation
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap

_TOLERANCE = 0.5  # m, largest distance from a goal that is still worth a tolerance
_ROUNDING = 0.02  # m, between a goal and the centre of its cell
_HOLE = 400  # cells; a larger hole is no fault of the sensor
_WINDOW = 3  # cells around an edge
_AROUND = 20  # cells around a hole within which it must end


def advice_for(
    terrain: HeightMap,
    robot: Robot,
    wider: Robot,
    causes: Sequence[Cause],
    nearest: Nearest | None,
) -> tuple[str, ...]:
    """Returns advice in words.

    Args:
        terrain: the map.
        robot: the robot.
        wider: the robot with its margin.
        causes: why there is no plan.
        nearest: the pose in reach that is nearest to the goal; None without one.
    """
    found = []
    # With a tolerance, the robot arrives on neutral feet.
    if nearest is not None and nearest.distance <= _TOLERANCE and not any(nearest.pose[3:]):
        found.append(_tolerance(nearest.distance, nearest.turn))
    grid = Grid(terrain.origin, terrain.shape)
    if any(cause.kind == Kind.UNKNOWN and _is_small_hole(terrain, grid, cause) for cause in causes):
        found.append("conditioning of the map may fill the unknown cells there")
    elif any(cause.kind == Kind.EDGE and _is_noise(terrain, grid, cause) for cause in causes):
        found.append("conditioning of the map may remove the edge there, which is around a cell or two")
    if wider != robot and any(cause.kind == Kind.BODY and not _hits(terrain, robot, cause) for cause in causes):
        found.append("without the margin the body does not hit the ground there")
    return tuple(found)


def _tolerance(distance: float, turn: float) -> str:
    degrees = math.ceil(math.degrees(turn) - 1e-6)
    if distance == 0:
        return f"a goal with a free heading, or a tolerance of {degrees} degrees, has a plan"
    also = f" and {degrees} degrees" if degrees else ""
    return f"with a goal tolerance of {distance + _ROUNDING:.2f} m{also} there is a plan"


def _is_small_hole(terrain: HeightMap, grid: Grid, cause: Cause) -> bool:
    """Whether the unknown cells around a cause are few."""
    from scipy.ndimage import label

    x, y = grid.cell(cause.place)
    low = max(x - _AROUND, 0), max(y - _AROUND, 0)
    part = np.isnan(terrain.heights[low[0] : x + _AROUND + 1, low[1] : y + _AROUND + 1])
    holes, _ = label(part, np.ones((3, 3)))
    hole = holes == holes[x - low[0], y - low[1]]
    ends = [hole[0], hole[-1], hole[:, 0], hole[:, -1]]
    return int(hole.sum()) <= _HOLE and not any(side.any() for side in ends)


def _is_noise(terrain: HeightMap, grid: Grid, cause: Cause) -> bool:
    """Whether at most two cells around a cause rise from, or fall below, the other ground there by an edge."""
    x, y = grid.cell(cause.place)
    near = np.pad(terrain.heights, _WINDOW, constant_values=np.nan)[x : x + 2 * _WINDOW + 1, y : y + 2 * _WINDOW + 1]
    return int((abs(near - np.nanmedian(near)) > (cause.limit or 0.0)).sum()) <= 2


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
