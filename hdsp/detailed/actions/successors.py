"""All successors of a state. This module drives and turns; ``manoeuvres`` moves feet and base.

Source: paper, Sec. V-A, with the cost model in docs/cost-model.md. The robot drives and turns on neutral feet. With
feet at different heights, it does so only on a slope; with an edge between the feet, e.g. on stairs, it only drives
straight.
"""

from typing import NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.actions.action import ARC, ARCS, DRIVES, TURN_LEFT, TURN_RIGHT, arc_turn
from hdsp.detailed.actions.manoeuvres import manoeuvres
from hdsp.detailed.actions.state_costs import feet_cells
from hdsp.detailed.states import FEET_MASK, HEADING_SHIFT, neutral_feet, unpack
from hdsp.detailed.world.body import FREE, look_at_body, on_slope
from hdsp.detailed.world.world import cell_index
from hdsp.robot.lattice import HEADINGS

MAX_SUCCESSORS = 160

_INF = np.inf


class Rules(NamedTuple):
    """Restrictions on a search, besides the robot's own.

    Attributes:
        heading_center: middle heading in the window.
        heading_window: largest difference to the middle heading, in heading steps; 32 or more allows all headings.
        turn_cost_factor: factor on turning costs, and on the costs of arcs.
        drive_only: only driving and turning, on neutral feet: a three-dimensional problem.
    """

    heading_center: int = 0
    heading_window: int = HEADINGS
    turn_cost_factor: float = 1.0
    drive_only: bool = False


def allowed_headings(rules: Rules) -> np.ndarray:
    """Headings within the window, bool [64]."""
    off = (np.arange(HEADINGS) - rules.heading_center + HEADINGS // 2) % HEADINGS - HEADINGS // 2
    return abs(off) <= rules.heading_window


@njit(allocates=False)
def successors(world, rules, key, out_key, out_cost, out_action):
    """Writes all successors of a valid state.

    Args:
        world: terrain and robot.
        rules: restrictions on the search.
        key: packed state.
        out_key, out_cost, out_action: output arrays, int64, float64, uint8 [MAX_SUCCESSORS].

    Returns:
        Number of successors.
    """
    if key & FEET_MASK == neutral_feet(world.tables.lowest):
        return pose_successors(world, rules, key, out_key, out_cost, out_action)
    return 0 if rules.drive_only else other_successors(world, key, out_key, out_cost, out_action)


@njit(allocates=False)
def other_successors(world, key, out_key, out_cost, out_action):
    """``successors`` for feet off neutral."""
    t = world.tables
    uneven, steps = world.uneven, world.steps
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    p = cell_index(world, ix, iy)
    p0, p1, p2, p3 = feet_cells(p, t.feet, t.n_offsets, t.n_samples, heading, o0, o1, o2, o3)
    can_step = _can_step(steps[p0] | steps[p1] | steps[p2] | steps[p3], heading, world.constants.step_backward)
    p0, p1, p2, p3 = feet_cells(p, t.contacts, t.n_offsets, t.n_samples, heading, o0, o1, o2, o3)
    unevenness = uneven[p0], uneven[p1], uneven[p2], uneven[p3]
    return manoeuvres(world, key, can_step, unevenness, out_key, out_cost, out_action, 0)


@njit(inline="always")
def _can_step(ways, heading, backward):
    ahead = (ways >> np.uint64(heading)) & np.uint64(1)
    behind = (ways >> np.uint64((heading + HEADINGS // 2) % HEADINGS)) & np.uint64(1)
    return ahead != 0 or (backward and behind != 0)


@njit(inline="always")
def pose_successors(world, rules, key, out_key, out_cost, out_action):
    """``successors`` for neutral feet."""
    t = world.tables
    uneven, height, feet, contacts, steps = world.uneven, world.height, t.feet, t.contacts, world.steps
    ix, iy, heading, _, _, _, _ = unpack(key)
    p = cell_index(world, ix, iy)
    rows = neutral_rows(t, heading)
    p0, p1, p2, p3 = p + feet[rows[0]], p + feet[rows[1]], p + feet[rows[2]], p + feet[rows[3]]
    h0, h1, h2, h3 = height[p0], height[p1], height[p2], height[p3]
    level = max(max(h0, h1), max(h2, h3)) - min(min(h0, h1), min(h2, h3)) <= world.constants.level
    level = level or on_slope(world, heading, p)
    price = t.drive_price[0 if level else 1, heading]
    n = _drives(world, key, heading, p, rows, price, out_key, out_cost, out_action)
    if level and world.constants.on_the_spot:
        n = _turns(world, rules, key, heading, p, rows, out_key, out_cost, out_action, n)
    elif level:
        n = _arcs(world, rules, key, heading, p, rows, out_key, out_cost, out_action, n)
    ways = steps[p0] | steps[p1] | steps[p2] | steps[p3]
    if not rules.drive_only and _can_step(ways, heading, world.constants.step_backward):
        p0, p1, p2, p3 = p + contacts[rows[0]], p + contacts[rows[1]], p + contacts[rows[2]], p + contacts[rows[3]]
        unevenness = uneven[p0], uneven[p1], uneven[p2], uneven[p3]
        n = manoeuvres(world, key, True, unevenness, out_key, out_cost, out_action, n)
    return n


@njit(inline="always")
def neutral_rows(tables, heading):
    """First samples for four neutral feet in ``tables.feet`` and ``tables.contacts``."""
    between = tables.n_offsets * tables.n_samples
    first = (heading * 4 * tables.n_offsets - tables.lowest) * tables.n_samples
    return first, first + between, first + 2 * between, first + 3 * between


@njit(inline="always")
def _drives(world, key, heading, p, rows, price, out_key, out_cost, out_action):
    # The innermost loop of every search.
    t = world.tables
    uneven, contacts, base, k = world.uneven, t.contacts, world.base, world.constants.unevenness
    r0, r1, r2, r3 = rows
    p0, p1, p2, p3 = p + contacts[r0], p + contacts[r1], p + contacts[r2], p + contacts[r3]
    b = heading * len(world.standable) + p
    n = 0
    for m in range(DRIVES):
        if price[m] == _INF:
            continue
        step = t.move_flat[m]
        s0, s1, s2, s3 = uneven[p0 + step], uneven[p1 + step], uneven[p2 + step], uneven[p3 + step]
        largest = max(max(s0, s1), max(s2, s3))
        if largest == _INF:
            continue
        body = base[b + step]
        if body == 0:
            body = look_at_body(world, heading, p + step)
        if body != FREE:
            continue
        total = np.float64(largest) + s0 + s1 + s2 + s3
        first = t.move_first[m]
        for s in range(first, first + t.move_count[m]):
            s0, s1 = uneven[p + contacts[r0 + s]], uneven[p + contacts[r1 + s]]
            s2, s3 = uneven[p + contacts[r2 + s]], uneven[p + contacts[r3 + s]]
            body = base[b + t.base_sample[s]]
            if body == 0:
                body = look_at_body(world, heading, p + t.base_sample[s])
            if body != FREE:
                total = _INF
                break
            total += np.float64(max(max(s0, s1), max(s2, s3))) + s0 + s1 + s2 + s3
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
    here = _summed_unevenness(world.uneven, t.contacts, p, rows)
    for action in (TURN_LEFT, TURN_RIGHT):
        new = (heading + (1 if action == TURN_LEFT else HEADINGS - 1)) % HEADINGS
        off = (new - rules.heading_center + HEADINGS // 2) % HEADINGS - HEADINGS // 2
        if abs(off) > rules.heading_window:
            continue
        body = world.base[new * len(world.standable) + p]
        if body == 0:
            body = look_at_body(world, new, p)
        there = _summed_unevenness(world.uneven, t.contacts, p, neutral_rows(t, new))
        if body != FREE or there == _INF:
            continue
        out_key[n] = key + ((new - heading) << HEADING_SHIFT)
        out_cost[n] = c.turn * rules.turn_cost_factor * (1.0 + c.turn_unevenness * 0.5 * (here + there))
        out_action[n] = action
        n += 1
    return n


@njit(allocates=False)
def _arcs(world, rules, key, heading, p, rows, out_key, out_cost, out_action, n):
    here = _summed_unevenness(world.uneven, world.tables.contacts, p, rows)
    for arc in range(ARCS):
        new = (heading + arc_turn(arc)) % HEADINGS
        off = (new - rules.heading_center + HEADINGS // 2) % HEADINGS - HEADINGS // 2
        if abs(off) > rules.heading_window:
            continue
        cost = arc_cost(world, p, heading, arc, here)
        if cost == _INF:
            continue
        out_key[n] = key + world.tables.arcs[heading, arc, 3] + ((new - heading) << HEADING_SHIFT)
        out_cost[n] = rules.turn_cost_factor * cost
        out_action[n] = ARC + arc
        n += 1
    return n


@njit(inline="always")
def arc_cost(world, p, heading, arc, here):
    """Cost of an arc by one heading step: driving, over its samples and the end, plus turning; inf if impossible.

    Args:
        world: terrain and robot.
        p: flat cell of the base.
        heading: heading index.
        arc: number of the arc.
        here: summed unevenness under neutral feet.
    """
    t, c, uneven, k = world.tables, world.constants, world.uneven, world.constants.unevenness
    price, row = t.drive_price[0, heading, DRIVES + arc], t.arcs[heading, arc]
    if price == _INF:
        return _INF
    new = (heading + arc_turn(arc)) % HEADINGS
    q, count = p + row[2], row[4]
    r0, r1, r2, r3 = neutral_rows(t, new)
    s0, s1 = uneven[q + t.contacts[r0]], uneven[q + t.contacts[r1]]
    s2, s3 = uneven[q + t.contacts[r2]], uneven[q + t.contacts[r3]]
    there = np.float64(s0) + s1 + s2 + s3
    if there == _INF or not _stands_free(world, new, q):
        return _INF
    total = there + max(max(s0, s1), max(s2, s3))
    for s in range(count):
        first = 5 + 5 * s
        s0, s1 = uneven[p + row[first + 1]], uneven[p + row[first + 2]]
        s2, s3 = uneven[p + row[first + 3]], uneven[p + row[first + 4]]
        total += np.float64(max(max(s0, s1), max(s2, s3))) + s0 + s1 + s2 + s3
        turned = 2 * (s + 1) >= count + 1
        if total == _INF or not _stands_free(world, new if turned else heading, p + row[first]):
            return _INF
    drive = price * (1.0 + k * total / (count + 1))
    turn = c.turn * (1.0 + c.turn_unevenness * 0.5 * (here + there))
    return drive + turn


@njit(inline="always")
def _stands_free(world, heading, p):
    body = world.base[heading * len(world.standable) + p]
    if body == 0:
        body = look_at_body(world, heading, p)
    return body == FREE


@njit(inline="always")
def _summed_unevenness(uneven, contacts, p, rows):
    r0, r1, r2, r3 = rows
    left = np.float64(uneven[p + contacts[r0]]) + uneven[p + contacts[r1]]
    return left + (np.float64(uneven[p + contacts[r2]]) + uneven[p + contacts[r3]])
