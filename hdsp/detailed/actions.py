"""The detailed actions: all successors of a state. Driving and turning are here, feet and base in ``manoeuvres``.

Source: paper, Sec. V-A, with the cost model of docs/cost-model.md. The robot drives and turns on neutral feet; where
they stand at different heights, as on stairs, it only drives straight.
"""

from typing import NamedTuple

import numpy as np

from hdsp.detailed.manoeuvres import manoeuvres
from hdsp.detailed.state_costs import feet_cells
from hdsp.detailed.states import FEET_MASK, TURN_LEFT, TURN_RIGHT, neutral_feet, unpack
from hdsp.detailed.world import cell_index, compute_base_term
from hdsp.jit import njit
from hdsp.lattice import HEADINGS

MAX_SUCCESSORS = 160

_INF = np.inf
_ONE = np.float32(1)


class Rules(NamedTuple):
    """How a search may move, beyond what the robot can do.

    Attributes:
        heading_center: heading about which the window below lies.
        heading_window: most heading steps a state may differ from the centre; 32 or more means any heading.
        turn_cost_factor: multiplies the cost of turning.
        drive_only: only driving and turning, which takes place on neutral feet: a problem of three dimensions.
    """

    heading_center: int = 0
    heading_window: int = HEADINGS
    turn_cost_factor: float = 1.0
    drive_only: bool = False


@njit(allocates=False)
def successors(world, rules, key, out_key, out_cost, out_action):
    """Write all successors of a valid state.

    Args:
        world: terrain and robot.
        rules: restrictions of this search.
        key: packed state.
        out_key, out_cost, out_action: arrays int64, float64, uint8 [MAX_SUCCESSORS] to write to.

    Returns:
        Number of successors written.
    """
    if key & FEET_MASK == neutral_feet(world.tables.lowest):
        return pose_successors(world, rules, key, out_key, out_cost, out_action)
    return 0 if rules.drive_only else other_successors(world, key, out_key, out_cost, out_action)


@njit(allocates=False)
def other_successors(world, key, out_key, out_cost, out_action):
    """``successors`` of a state with feet off neutral."""
    t = world.tables
    foot, steps = world.foot, world.steps
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    p = cell_index(world, ix, iy)
    p0, p1, p2, p3 = feet_cells(p, t.feet, t.n_offsets, t.n_samples, heading, o0, o1, o2, o3)
    can_step = _can_step(steps[p0] | steps[p1] | steps[p2] | steps[p3], heading, world.constants.step_backward)
    unevenness = foot[p0], foot[p1], foot[p2], foot[p3]
    return manoeuvres(world, key, can_step, unevenness, out_key, out_cost, out_action, 0)


@njit(inline="always")
def _can_step(ways, heading, backward):
    ahead = (ways >> np.uint64(heading)) & np.uint64(1)
    behind = (ways >> np.uint64((heading + HEADINGS // 2) % HEADINGS)) & np.uint64(1)
    return ahead != 0 or (backward and behind != 0)


@njit(inline="always")
def pose_successors(world, rules, key, out_key, out_cost, out_action):
    """``successors`` of a state on neutral feet."""
    t = world.tables
    foot, height, feet, steps = world.foot, world.height, t.feet, world.steps
    ix, iy, heading, _, _, _, _ = unpack(key)
    p = cell_index(world, ix, iy)
    rows = neutral_rows(t, heading)
    p0, p1, p2, p3 = p + feet[rows[0]], p + feet[rows[1]], p + feet[rows[2]], p + feet[rows[3]]
    h0, h1, h2, h3 = height[p0], height[p1], height[p2], height[p3]
    level = max(max(h0, h1), max(h2, h3)) - min(min(h0, h1), min(h2, h3)) <= world.constants.level
    price = t.drive_price[0 if level else 1, heading]
    n = _drives(world, key, heading, p, rows, price, out_key, out_cost, out_action)
    if level:
        n = _turns(world, rules, key, heading, p, rows, out_key, out_cost, out_action, n)
    ways = steps[p0] | steps[p1] | steps[p2] | steps[p3]
    if not rules.drive_only and _can_step(ways, heading, world.constants.step_backward):
        unevenness = foot[p0], foot[p1], foot[p2], foot[p3]
        n = manoeuvres(world, key, True, unevenness, out_key, out_cost, out_action, n)
    return n


@njit(inline="always")
def neutral_rows(tables, heading):
    """Where the samples of the four feet begin in ``tables.feet`` if they are neutral."""
    between = tables.n_offsets * tables.n_samples
    first = (heading * 4 * tables.n_offsets - tables.lowest) * tables.n_samples
    return first, first + between, first + 2 * between, first + 3 * between


@njit(inline="always")
def _drives(world, key, heading, p, rows, price, out_key, out_cost, out_action):
    # The innermost loop of every search.
    t = world.tables
    foot, feet, base, k = world.foot, t.feet, world.base, world.constants.unevenness
    r0, r1, r2, r3 = rows
    p0, p1, p2, p3 = p + feet[r0], p + feet[r1], p + feet[r2], p + feet[r3]
    b = heading * len(foot) + p
    n = 0
    for m in range(20):
        if price[m] == _INF:
            continue
        step = t.move_flat[m]
        s0, s1, s2, s3 = foot[p0 + step], foot[p1 + step], foot[p2 + step], foot[p3 + step]
        largest = max(max(s0, s1), max(s2, s3))
        if largest == _INF:
            continue
        under = base[b + step]
        if under == 0:
            under = compute_base_term(world, heading, p + step)
        total = np.float64(max(largest, under - _ONE)) + s0 + s1 + s2 + s3
        first = t.move_first[m]
        for s in range(first, first + t.move_count[m]):
            s0, s1 = foot[p + feet[r0 + s]], foot[p + feet[r1 + s]]
            s2, s3 = foot[p + feet[r2 + s]], foot[p + feet[r3 + s]]
            under = base[b + t.base_sample[s]]
            if under == 0:
                under = compute_base_term(world, heading, p + t.base_sample[s])
            total += np.float64(max(max(max(s0, s1), max(s2, s3)), under - _ONE)) + s0 + s1 + s2 + s3
        if total == _INF:
            continue
        out_key[n] = key + t.move_key[m]
        out_cost[n] = price[m] * (1.0 + k * total / (t.move_count[m] + 1))
        out_action[n] = m
        n += 1
    return n


@njit(inline="always")
def _turns(world, rules, key, heading, p, rows, out_key, out_cost, out_action, n):
    t, c = world.tables, world.constants
    here = _summed_unevenness(world.foot, t.feet, p, rows)
    for action in (TURN_LEFT, TURN_RIGHT):
        new = (heading + (1 if action == TURN_LEFT else HEADINGS - 1)) % HEADINGS
        off = (new - rules.heading_center + HEADINGS // 2) % HEADINGS - HEADINGS // 2
        if abs(off) > rules.heading_window:
            continue
        under = world.base[new * len(world.foot) + p]
        if under == 0:
            under = compute_base_term(world, new, p)
        there = _summed_unevenness(world.foot, t.feet, p, neutral_rows(t, new))
        if under == _INF or there == _INF:
            continue
        out_key[n] = key + ((new - heading) << 20)
        out_cost[n] = c.turn * rules.turn_cost_factor * (1.0 + c.turn_unevenness * 0.5 * (here + there))
        out_action[n] = action
        n += 1
    return n


@njit(inline="always")
def _summed_unevenness(foot, feet, p, rows):
    r0, r1, r2, r3 = rows
    return (np.float64(foot[p + feet[r0]]) + foot[p + feet[r1]]) + (np.float64(foot[p + feet[r2]]) + foot[p + feet[r3]])
