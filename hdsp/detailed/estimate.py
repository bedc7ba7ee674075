"""The heuristic as the kernels see it: a flat array plus a lookup rule, never a call back into Python.

``h = max(geometric, table) + feet``, where any part can be switched off.
"""

from typing import NamedTuple

import numpy as np

from hdsp.detailed.states import unpack
from hdsp.jit import njit
from hdsp.lattice import HEADINGS, RESOLUTION


class Estimate(NamedTuple):
    """Parameters of ``estimate``.

    Attributes:
        distance: cost per cell of straight distance to the goal's base position.
        turn: cost per heading step to the goal's heading.
        goal_x, goal_y, goal_heading: base of the goal, lattice units.
        foot: cost per cell by which feet differ from the goal's configuration, up to a common shift.
        goal_feet: int64 [4], foot offsets of the goal counted from the lowest.
        table: float32 [headings, nx, ny] flattened, costs to go; empty = none.
        table_nx, table_ny: its extent.
        cells: detailed cells per table cell.
        heading_steps: detailed headings per table heading.
        outside: added to the geometric part where the table is inf or ends; inf to cut such states off.
    """

    distance: float
    turn: float
    goal_x: int
    goal_y: int
    goal_heading: int
    foot: float
    goal_feet: np.ndarray
    table: np.ndarray
    table_nx: int
    table_ny: int
    cells: int
    heading_steps: int
    outside: float


NO_TABLE = np.empty(0, dtype=np.float32)


@njit(inline="always")
def _feet(e, o0, o1, o2, o3):
    """Least total length by which feet must move one by one to match the goal, whatever the base does, in cells."""
    d0, d1 = o0 - e.goal_feet[0], o1 - e.goal_feet[1]
    d2, d3 = o2 - e.goal_feet[2], o3 - e.goal_feet[3]
    # Sum of distances to the median: two largest minus two smallest.
    lo1, hi1, lo2, hi2 = min(d0, d1), max(d0, d1), min(d2, d3), max(d2, d3)
    return abs(max(hi1, hi2) - min(lo1, lo2)) + abs(min(hi1, hi2) - max(lo1, lo2))


@njit(inline="always")
def estimate(e, key):
    """Estimated cost from a packed state to the goal, float64."""
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    dx, dy = np.float64(ix - e.goal_x), np.float64(iy - e.goal_y)
    turned = abs((heading - e.goal_heading + HEADINGS // 2) % HEADINGS - HEADINGS // 2)
    h = e.distance * np.sqrt(dx * dx + dy * dy) + e.turn * turned
    if len(e.table) > 0:
        a, b = ix // e.cells, iy // e.cells
        k = ((heading + e.heading_steps // 2) // e.heading_steps) % (HEADINGS // e.heading_steps)
        looked_up = np.float64(np.inf)
        if a < e.table_nx and b < e.table_ny:
            looked_up = np.float64(e.table[(k * e.table_nx + a) * e.table_ny + b])
        if looked_up == np.inf:
            h += e.outside
        else:
            h = max(h, looked_up)
    if e.foot > 0:
        h += e.foot * _feet(e, o0, o1, o2, o3)
    return h


def geometric_estimate(world, goal) -> Estimate:
    """The admissible geometric heuristic: distance, difference of headings and of foot configurations, each at the least
    it can cost on even ground (paper, Sec. VI-B).

    Args:
        world: terrain and robot.
        goal: int64 [7], lattice units.
    """
    c = world.constants
    return Estimate(
        distance=min(RESOLUTION * float(world.tables.deviation.min()), c.base_shift),
        turn=c.turn,
        goal_x=int(goal[0]),
        goal_y=int(goal[1]),
        goal_heading=int(goal[2]),
        foot=_least_foot_cost(world),
        goal_feet=np.asarray(goal[3:], dtype=np.int64) - world.tables.lowest,
        table=NO_TABLE,
        table_nx=0,
        table_ny=0,
        cells=1,
        heading_steps=1,
        outside=0.0,
    )


def pose_estimate(world, to_go: np.ndarray, feet) -> Estimate:
    """Costs-to-go of the relaxed problem, float32 [64, nx, ny], plus the feet that still have to reach ``feet`` [4]."""
    goal = np.array([0, 0, 0, *feet], dtype=np.int64)
    table = np.ascontiguousarray(to_go, dtype=np.float32).ravel()
    return geometric_estimate(world, goal)._replace(
        distance=0.0, turn=0.0, table=table, table_nx=to_go.shape[1], table_ny=to_go.shape[2], outside=np.inf
    )


def _least_foot_cost(world) -> float:
    """Least cost per cell by which one foot moves relative to the others."""
    c, longest = world.constants, world.tables.line.shape[1] - 1
    return min(c.foot_move, c.step_per_metre * RESOLUTION + c.step / max(longest, 1))
