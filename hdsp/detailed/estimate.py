"""The heuristic as the kernels see it: a flat array plus a lookup rule, never a call back into Python.

``h = max(geometric, table) + feet``, where any part can be switched off.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from hdsp.detailed.states import unpack
from hdsp.lattice import HEADINGS


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


@njit(cache=True, error_model="numpy", inline="always")
def _feet(e, o0, o1, o2, o3):
    """Least total length by which feet must move one by one to match the goal, whatever the base does, in cells."""
    d0, d1 = o0 - e.goal_feet[0], o1 - e.goal_feet[1]
    d2, d3 = o2 - e.goal_feet[2], o3 - e.goal_feet[3]
    # Sum of distances to the median: two largest minus two smallest.
    lo1, hi1, lo2, hi2 = min(d0, d1), max(d0, d1), min(d2, d3), max(d2, d3)
    return abs(max(hi1, hi2) - min(lo1, lo2)) + abs(min(hi1, hi2) - max(lo1, lo2))


@njit(cache=True, error_model="numpy", inline="always")
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
