"""The detailed actions: all successors of a state. Driving and turning are here, feet and base in ``manoeuvres``.

Source: paper, Sec. V-A, with the cost model of docs/cost-model.md. The robot drives and turns on neutral feet; where
they stand at different heights, as on stairs, it only drives straight.
"""

from typing import NamedTuple

import numpy as np

from hdsp.detailed.manoeuvres import manoeuvres
from hdsp.detailed.state_costs import feet_cells, foot_row, level
from hdsp.detailed.states import TURN_LEFT, TURN_RIGHT, pack, unpack
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


@njit()
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
    t = world.tables
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    neutral = o0 == -t.lowest and o1 == -t.lowest and o2 == -t.lowest and o3 == -t.lowest
    n = 0
    if neutral:
        free = level(world, key)
        n = _drives(world, key, free, out_key, out_cost, out_action, n)
        if free:
            n = _turns(world, rules, key, out_key, out_cost, out_action, n)
    if rules.drive_only:
        return n
    foot, feet, steps, n_offsets, n_samples = world.foot, t.feet, world.steps, t.n_offsets, t.n_samples
    p = cell_index(world, ix, iy)
    p0, p1, p2, p3 = feet_cells(p, feet, n_offsets, n_samples, heading, o0, o1, o2, o3)
    ways = steps[p0] | steps[p1] | steps[p2] | steps[p3]
    can_step = (ways >> np.uint64(heading)) & np.uint64(1)
    if world.constants.step_backward:
        can_step |= (ways >> np.uint64((heading + HEADINGS // 2) % HEADINGS)) & np.uint64(1)
    if can_step == 0 and neutral:
        return n
    unevenness = foot[p0], foot[p1], foot[p2], foot[p3]
    return manoeuvres(world, key, can_step != 0, unevenness, out_key, out_cost, out_action, n)


@njit(inline="always")
def _drives(world, key, free, out_key, out_cost, out_action, n):
    # The innermost loop of every search: arrays are named once, because each access through a tuple counts references.
    t = world.tables
    foot, feet, base, size = world.foot, t.feet, world.base, len(world.foot)
    flat, first, count, base_sample = t.move_flat, t.move_first, t.move_count, t.base_sample
    move_dx, move_dy, length, deviation, straight = t.move_dx, t.move_dy, t.move_length, t.deviation, t.straight
    k = world.constants.unevenness
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    p = cell_index(world, ix, iy)
    b0 = heading * size
    r0, r1 = foot_row(t, heading, 0, o0), foot_row(t, heading, 1, o1)
    r2, r3 = foot_row(t, heading, 2, o2), foot_row(t, heading, 3, o3)
    p0, p1, p2, p3 = p + feet[r0], p + feet[r1], p + feet[r2], p + feet[r3]
    for m in range(20):
        if not free and not straight[heading, m]:
            continue
        step = flat[m]
        s0, s1, s2, s3 = foot[p0 + step], foot[p1 + step], foot[p2 + step], foot[p3 + step]
        largest = max(max(s0, s1), max(s2, s3))
        if largest == _INF:
            continue
        under = base[b0 + p + step]
        if under == 0:
            under = compute_base_term(world, heading, p + step)
        total = np.float64(max(largest, under - _ONE)) + s0 + s1 + s2 + s3
        for s in range(first[m], first[m] + count[m]):
            s0, s1, s2, s3 = (
                foot[p + feet[r0 + s]],
                foot[p + feet[r1 + s]],
                foot[p + feet[r2 + s]],
                foot[p + feet[r3 + s]],
            )
            under = base[b0 + p + base_sample[s]]
            if under == 0:
                under = compute_base_term(world, heading, p + base_sample[s])
            total += np.float64(max(max(max(s0, s1), max(s2, s3)), under - _ONE)) + s0 + s1 + s2 + s3
        if total == _INF:
            continue
        out_key[n] = key + (move_dx[m] << 42) + (move_dy[m] << 26)
        out_cost[n] = length[m] * deviation[heading, m] * (1.0 + k * total / (count[m] + 1))
        out_action[n] = m
        n += 1
    return n


@njit(inline="always")
def _turns(world, rules, key, out_key, out_cost, out_action, n):
    t = world.tables
    foot, feet, base, size = world.foot, t.feet, world.base, len(world.foot)
    turn, unevenness = world.constants.turn * rules.turn_cost_factor, world.constants.turn_unevenness
    n_offsets, n_samples = t.n_offsets, t.n_samples
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    p = cell_index(world, ix, iy)
    p0, p1, p2, p3 = feet_cells(p, feet, n_offsets, n_samples, heading, o0, o1, o2, o3)
    here = (np.float64(foot[p0]) + foot[p1]) + (np.float64(foot[p2]) + foot[p3])
    for action in (TURN_LEFT, TURN_RIGHT):
        new = (heading + (1 if action == TURN_LEFT else HEADINGS - 1)) % HEADINGS
        off = (new - rules.heading_center + HEADINGS // 2) % HEADINGS - HEADINGS // 2
        if abs(off) > rules.heading_window:
            continue
        under = base[new * size + p]
        if under == 0:
            under = compute_base_term(world, new, p)
        p0, p1, p2, p3 = feet_cells(p, feet, n_offsets, n_samples, new, o0, o1, o2, o3)
        there = (np.float64(foot[p0]) + foot[p1]) + (np.float64(foot[p2]) + foot[p3])
        if under == _INF or there == _INF:
            continue
        out_key[n] = pack(ix, iy, new, o0, o1, o2, o3)
        out_cost[n] = turn * (1.0 + unevenness * 0.5 * (here + there))
        out_action[n] = action
        n += 1
    return n
