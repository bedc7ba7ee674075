"""Costs-to-go between abstract states, with the work of the feet.

A table holds costs-to-go of abstract states: base at an anchor, feet at their reference there. A detailed state lies
between up to eight of them and has feet elsewhere. Each anchor gives a value for it: the cost-to-go of the anchor,
corrected foot by foot. The value of the state is the mean over the anchors, weighted as in trilinear interpolation.

The correction compares a foot with its reference on the line along which feet move:

- Each edge between both places is one step. The costs-to-go of the anchor contain the steps that are still to be done
  from its reference. A step is added if the foot stands behind the reference, and subtracted if it stands ahead.
- Feet follow the base by rolling, at a price per cell; a step takes a foot ahead without rolling. Rolling is counted
  for each cell by which the foot stands behind its reference, except for the lengths of steps between.

Along a manoeuvre, an action then changes the value by its own cost: g + h stays nearly constant while feet climb. A
step counts as done only if the costs-to-go fall in its direction, because a step beside the way gains nothing.

Many orders of base shifts and rolling lead to the same state, and all of their states have nearly equal g + h. A state
in which a foot puts off rolling by more than one base shift comes after the others: the same feet can be reached by
rolling at once.
"""

from typing import NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.base.records import by_reference
from hdsp.detailed.actions.state_costs import foot_row, merged_cost
from hdsp.detailed.states import FEET_MASK, foot_offset, foot_shift, neutral_feet, unpack
from hdsp.detailed.world.world import cell_index, step_effort
from hdsp.robot.lattice import ABSTRACT_ANCHOR, ABSTRACT_HEADINGS, CELLS_PER_ABSTRACT, HEADINGS_PER_ABSTRACT

_NEAR = 2  # cells; a reference within an edge's clearance belongs to a foothold that is no farther away
_AHEAD = 8  # cells; farthest look ahead for falling costs-to-go
#: Price of rolling that a foot puts off, relative to its cost: so high that other states come first.
PUT_OFF = 100.0


@by_reference
class CostsToGo(NamedTuple):
    """Costs-to-go at abstract states.

    Attributes:
        values: float32 [16 * nx * ny], inf where unknown; empty: no table.
        feet: int32 [16 * nx * ny], reference feet as packed bits (``hdsp.detailed.states``), -1 for neutral feet.
        uneven: bool [nx * ny], whether an edge may lie between a foot and its reference.
        nx, ny: size in abstract cells.
    """

    values: np.ndarray
    feet: np.ndarray
    uneven: np.ndarray
    nx: int
    ny: int


def no_costs_to_go() -> CostsToGo:
    """Returns an empty table."""
    nothing = np.empty(0, np.float32), np.empty(0, np.int32), np.empty(0, np.bool_)
    return CostsToGo(*nothing, 0, 0)


@njit(allocates=False)
def interpolated(world, table, key):
    """Cost-to-go of a packed state, float64; inf without a known abstract state around it."""
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    t, c = world.tables, world.constants
    x, y = ix - ABSTRACT_ANCHOR, iy - ABSTRACT_ANCHOR
    a0, b0, k0 = x // CELLS_PER_ABSTRACT, y // CELLS_PER_ABSTRACT, heading // HEADINGS_PER_ABSTRACT
    far_x, far_y, far_k = x % CELLS_PER_ABSTRACT, y % CELLS_PER_ABSTRACT, heading % HEADINGS_PER_ABSTRACT
    a, b = min(ix // CELLS_PER_ABSTRACT, table.nx - 1), min(iy // CELLS_PER_ABSTRACT, table.ny - 1)
    neutral = key & FEET_MASK == neutral_feet(t.lowest)
    prices = 1.0, 0.0, 0.0, 0.0, 0.0  # of a step, relative to its effort, and of rolling each foot by a cell
    correct = not neutral or table.uneven[a * table.ny + b]
    if correct:
        p = cell_index(world, ix, iy)
        s0 = world.uneven[p + t.contacts[foot_row(t, heading, 0, o0)]]
        s1 = world.uneven[p + t.contacts[foot_row(t, heading, 1, o1)]]
        s2 = world.uneven[p + t.contacts[foot_row(t, heading, 2, o2)]]
        s3 = world.uneven[p + t.contacts[foot_row(t, heading, 3, o3)]]
        cost = merged_cost(c.unevenness, s0, s1, s2, s3)
        if cost == np.inf:
            return np.inf
        roll, more = c.foot_move, 10.0 * c.unevenness * c.foot_move
        prices = cost, roll + more * s0, roll + more * s1, roll + more * s2, roll + more * s3
    total, weights = 0.0, 0.0
    for i in range(2):
        a, in_x = a0 + i, (far_x if i else CELLS_PER_ABSTRACT - far_x)
        if in_x == 0 or a < 0 or a >= table.nx:
            continue
        for j in range(2):
            b, in_y = b0 + j, (far_y if j else CELLS_PER_ABSTRACT - far_y)
            if in_y == 0 or b < 0 or b >= table.ny:
                continue
            for n in range(2):
                in_k = far_k if n else HEADINGS_PER_ABSTRACT - far_k
                if in_k == 0:
                    continue
                place = ((k0 + n) % ABSTRACT_HEADINGS * table.nx + a) * table.ny + b
                value = np.float64(table.values[place])
                if value == np.inf:
                    continue
                if correct:
                    moved_x, moved_y = CELLS_PER_ABSTRACT * i - far_x, CELLS_PER_ABSTRACT * j - far_y
                    along = moved_x * t.ahead[heading, 0] + moved_y * t.ahead[heading, 1]
                    value += _correction(world, table, key, place, np.int64(np.rint(along)), prices)
                weight = np.float64(in_x * in_y * in_k)
                total += weight * value
                weights += weight
    if weights == 0:
        return np.inf
    between = max(total / weights, 0.0)
    return between if neutral else between + PUT_OFF * _put_off(world, key)


@njit(allocates=False)
def _correction(world, table, key, place, along, prices):
    """Cost of the work by which the feet of a state are behind their reference at an anchor; negative if ahead.

    Args:
        world: terrain and robot.
        table: the table.
        key: packed state.
        place: index of the anchor's abstract state.
        along: distance of the anchor ahead of the base, cells.
        prices: of a step, relative to its effort, and of rolling each foot by one cell.
    """
    t = world.tables
    ix, iy, heading, _, _, _, _ = unpack(key)
    p = cell_index(world, ix, iy)
    steps, rolling = 0.0, 0.0
    for foot in range(4):
        offset = foot_offset(key, foot_shift(foot))
        reference = -t.lowest
        if table.feet[place] >= 0:
            reference = foot_offset(np.int64(table.feet[place]), foot_shift(foot))
        roll = prices[1] if foot == 0 else prices[2] if foot == 1 else prices[3] if foot == 2 else prices[4]
        at = min(max(reference + along, 0), t.n_offsets - 1)
        work = _steps_between(world, heading, foot, p, min(offset, at), max(offset, at), prices[0], roll)
        if at >= offset:
            steps += work
            rolling += roll * (reference - offset)
        elif work > 0 and _falls(world, table, ix, iy, heading, min(offset - reference, _AHEAD)):
            steps -= work
            rolling -= roll * (offset - reference)
        else:
            rolling += roll * abs(reference - offset)
    # Near a goal that leaves the feet free, no rolling remains.
    return steps + min(rolling, np.float64(table.values[place]))


@njit(allocates=False)
def _put_off(world, key):
    """Cost of the rolling that feet put off by more than one base shift: up to neutral or to the next edge."""
    t = world.tables
    ix, iy, heading, _, _, _, _ = unpack(key)
    p = cell_index(world, ix, iy)
    cells = 0
    for foot in range(4):
        offset = foot_offset(key, foot_shift(foot))
        reached = offset
        while reached < -t.lowest and world.standable[p + t.feet[foot_row(t, heading, foot, reached + 1)]]:
            reached += 1
        cells += max(reached - offset - t.shifts[heading, 2], 0)
    return world.constants.foot_move * cells


@njit(inline="always")
def _falls(world, table, ix, iy, heading, cells):
    """Whether the cost-to-go falls from a base pose to the pose ``cells`` ahead."""
    t = world.tables
    here = _nearest_value(table, ix, iy, heading)
    x, y = np.int64(np.rint(cells * t.ahead[heading, 0])), np.int64(np.rint(cells * t.ahead[heading, 1]))
    return _nearest_value(table, ix + x, iy + y, heading) < here


@njit(inline="always")
def _nearest_value(table, ix, iy, heading):
    a, b = ix // CELLS_PER_ABSTRACT, iy // CELLS_PER_ABSTRACT
    if a < 0 or b < 0 or a >= table.nx or b >= table.ny:
        return np.float32(np.inf)
    k = (heading + HEADINGS_PER_ABSTRACT // 2) // HEADINGS_PER_ABSTRACT % ABSTRACT_HEADINGS
    return table.values[(k * table.nx + a) * table.ny + b]


@njit(allocates=False)
def _steps_between(world, heading, foot, p, low, high, cost, roll):
    """Cost of the steps of a foot from one offset to a higher one, less the rolling that they save."""
    t, c, standable, height = world.tables, world.constants, world.standable, world.height
    before = low  # last foothold
    least = max(low - _NEAR, 0)
    while before >= least and not standable[p + t.feet[foot_row(t, heading, foot, before)]]:
        before -= 1
    at = max(before, low) + 1
    if before < least:
        before = -1  # none
    last = min(high + _NEAR, t.n_offsets - 1)
    work = 0.0
    while at <= last:
        cell = p + t.feet[foot_row(t, heading, foot, at)]
        if standable[cell]:
            if before >= 0 and at - before > 1:
                level = height[p + t.feet[foot_row(t, heading, foot, before)]]
                effort = step_effort(c.step, c.step_per_metre, c.step_per_height, at - before, level, height[cell])
                work += max(cost * effort - roll * (at - before), 0.0)
            before = at
            if at >= high:
                break
        at += 1
    return work
