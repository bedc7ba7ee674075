"""The detailed actions and what they cost: all successors of a state.

Source: paper, Sec. V-A, with the cost model of docs/cost-model.md. The robot drives and turns on neutral feet; where
they stand at different heights, as on stairs, it only drives straight. Feet leave neutral by steps and base shifts, and
single feet roll back toward neutral. A foot steps only where it needs to: when it cannot roll on because of an edge on
its line, and then to the nearest foothold beyond. The base shifts where a foot can step or is ahead of neutral. Whether
steps and base shifts also go backward is up to the robot.
"""

from typing import NamedTuple

import numpy as np

from hdsp.detailed.states import BASE_BACKWARD, BASE_FORWARD, FOOT_MOVE, STEP, TURN_LEFT, TURN_RIGHT, pack, unpack
from hdsp.detailed.world import base_term, cell_index, compute_base_term, step_fits
from hdsp.jit import njit
from hdsp.lattice import HEADINGS, RESOLUTION

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


@njit(inline="always")
def foot_row(tables, heading, foot, offset):
    """Where the samples of a foot begin in ``tables.feet``."""
    return ((heading * 4 + foot) * tables.n_offsets + offset) * tables.n_samples


@njit(inline="always")
def _feet_cells(p, feet, n_offsets, n_samples, heading, o0, o1, o2, o3):
    """Flat cells of the four feet. Takes arrays and numbers, since each tuple handed on counts references."""
    row = heading * 4 * n_offsets
    return (
        p + feet[(row + o0) * n_samples], p + feet[(row + n_offsets + o1) * n_samples],
        p + feet[(row + 2 * n_offsets + o2) * n_samples], p + feet[(row + 3 * n_offsets + o3) * n_samples],
    )  # fmt: skip


@njit()
def state_cost(world, key):
    """State cost C of a packed state; inf if a foot cannot stand there or the body collides."""
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    p = cell_index(world, ix, iy)
    t = world.tables
    foot, feet = world.foot, t.feet
    s0, s1 = foot[p + feet[foot_row(t, heading, 0, o0)]], foot[p + feet[foot_row(t, heading, 1, o1)]]
    s2, s3 = foot[p + feet[foot_row(t, heading, 2, o2)]], foot[p + feet[foot_row(t, heading, 3, o3)]]
    return merged_cost(world.constants.unevenness, base_term(world, heading, p), s0, s1, s2, s3)


@njit(inline="always")
def separated(constants, key):
    """Whether front and rear foot of each side keep their distance in a packed state."""
    apart = 2 * constants.neutral_x - constants.min_separation
    _, _, _, o0, o1, o2, o3 = unpack(key)
    return o1 - o0 <= apart and o2 - o3 <= apart


@njit(inline="always")
def level(world, key):
    """Whether the feet of a packed state stand at about the same height."""
    t = world.tables
    height, feet, n_offsets, n_samples = world.height, t.feet, t.n_offsets, t.n_samples
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    p = cell_index(world, ix, iy)
    p0, p1, p2, p3 = _feet_cells(p, feet, n_offsets, n_samples, heading, o0, o1, o2, o3)
    h0, h1, h2, h3 = height[p0], height[p1], height[p2], height[p3]
    return max(max(h0, h1), max(h2, h3)) - min(min(h0, h1), min(h2, h3)) <= world.constants.level


@njit(inline="always")
def supported(constants, lowest, lifted, o0, o1, o2, o3):
    """Whether the base centre lies in the triangle of the three feet that stay, ``support_margin`` cells inside its
    edges."""
    x, y = constants.neutral_x + lowest, constants.neutral_y
    back = -constants.neutral_x + lowest
    px = (x + o0, back + o1, back + o2, x + o3)
    py = (y, y, -y, -y)
    a, b, c = (lifted + 1) % 4, (lifted + 2) % 4, (lifted + 3) % 4
    # The feet run counter-clockwise, so the centre is inside if it is to the left of each edge.
    for i, j in ((a, b), (b, c), (c, a)):
        ex, ey = px[j] - px[i], py[j] - py[i]
        left = (ey * px[i] - ex * py[i]) / np.sqrt(ex * ex + ey * ey)
        if left < constants.support_margin - 1e-9:
            return False
    return True


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
    p0, p1, p2, p3 = _feet_cells(p, feet, n_offsets, n_samples, heading, o0, o1, o2, o3)
    ways = steps[p0] | steps[p1] | steps[p2] | steps[p3]
    can_step = (ways >> np.uint64(heading)) & np.uint64(1)
    if world.constants.step_backward:
        can_step |= (ways >> np.uint64((heading + HEADINGS // 2) % HEADINGS)) & np.uint64(1)
    if can_step == 0 and neutral:
        return n
    unevenness = foot[p0], foot[p1], foot[p2], foot[p3]
    return _manoeuvres(world, key, can_step != 0, unevenness, out_key, out_cost, out_action, n)


@njit()
def _manoeuvres(world, key, can_step, unevenness, out_key, out_cost, out_action, n):
    # Apart from the rest, and not inlined: what it names would be counted at every state, and few get here.
    ix, iy, heading, _, _, _, _ = unpack(key)
    under = base_term(world, heading, cell_index(world, ix, iy))
    n = _foot_moves(world, key, under, unevenness, out_key, out_cost, out_action, n)
    n = _base_shifts(world, key, can_step, under, unevenness, out_key, out_cost, out_action, n)
    if can_step:
        n = _steps(world, key, under, unevenness, out_key, out_cost, out_action, n)
    return n


@njit(inline="always")
def merged_cost(k, under, s0, s1, s2, s3):
    """State cost C from the largest S under the body and the S of the feet (unitless)."""
    largest = max(max(s0, s1), max(max(s2, s3), under))
    return 1.0 + k * (np.float64(largest) + s0 + s1 + s2 + s3)


@njit(inline="always")
def with_foot(unevenness, i, value):
    """The four values with the one of foot ``i`` replaced."""
    s0, s1, s2, s3 = unevenness
    return (
        value if i == 0 else s0, value if i == 1 else s1,
        value if i == 2 else s2, value if i == 3 else s3,
    )  # fmt: skip


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
    p0, p1, p2, p3 = _feet_cells(p, feet, n_offsets, n_samples, heading, o0, o1, o2, o3)
    here = (np.float64(foot[p0]) + foot[p1]) + (np.float64(foot[p2]) + foot[p3])
    for action in (TURN_LEFT, TURN_RIGHT):
        new = (heading + (1 if action == TURN_LEFT else HEADINGS - 1)) % HEADINGS
        off = (new - rules.heading_center + HEADINGS // 2) % HEADINGS - HEADINGS // 2
        if abs(off) > rules.heading_window:
            continue
        under = base[new * size + p]
        if under == 0:
            under = compute_base_term(world, new, p)
        p0, p1, p2, p3 = _feet_cells(p, feet, n_offsets, n_samples, new, o0, o1, o2, o3)
        there = (np.float64(foot[p0]) + foot[p1]) + (np.float64(foot[p2]) + foot[p3])
        if under == _INF or there == _INF:
            continue
        out_key[n] = pack(ix, iy, new, o0, o1, o2, o3)
        out_cost[n] = turn * (1.0 + unevenness * 0.5 * (here + there))
        out_action[n] = action
        n += 1
    return n


@njit(inline="always")
def _foot_moves(world, key, under, unevenness, out_key, out_cost, out_action, n):
    t = world.tables
    foot, feet, k, price = world.foot, t.feet, world.constants.unevenness, world.constants.foot_move
    ix, iy, heading, _, _, _, _ = unpack(key)
    p = cell_index(world, ix, iy)
    for i in range(4):
        shift = 15 - 5 * i
        offset = (key >> shift) & 0x1F
        before = unevenness[0] if i == 0 else unevenness[1] if i == 1 else unevenness[2] if i == 2 else unevenness[3]
        for backward in range(2):
            change = 1 - 2 * backward
            if (offset + t.lowest) * change >= 0:  # only toward neutral
                continue
            reached = foot[p + feet[foot_row(t, heading, i, offset + change)]]
            if reached == _INF:
                continue
            new = key + (np.int64(change) << shift)
            if not separated(world.constants, new):
                continue
            out_key[n] = new
            out_cost[n] = price * (1.0 + 10.0 * k * 0.5 * (np.float64(before) + reached))
            out_action[n] = FOOT_MOVE + 2 * i + backward
            n += 1
    return n


@njit(inline="always")
def _base_shifts(world, key, can_step, under, unevenness, out_key, out_cost, out_action, n):
    t = world.tables
    foot, feet, k, price = world.foot, t.feet, world.constants.unevenness, world.constants.base_shift
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    cost = merged_cost(k, under, unevenness[0], unevenness[1], unevenness[2], unevenness[3])
    for action in (BASE_FORWARD, BASE_BACKWARD):
        if action == BASE_BACKWARD and not world.constants.shift_backward:
            continue
        sign = 1 if action == BASE_FORWARD else -1
        leading = max(max(o0, o1), max(o2, o3)) if sign == 1 else min(min(o0, o1), min(o2, o3))
        if not can_step and sign * (leading + t.lowest) <= 0:  # nobody to follow
            continue
        dx, dy, by = sign * t.shifts[heading, 0], sign * t.shifts[heading, 1], sign * t.shifts[heading, 2]
        lowest, highest = min(min(o0, o1), min(o2, o3)) - by, max(max(o0, o1), max(o2, o3)) - by
        if lowest < 0 or highest >= t.n_offsets:
            continue
        q = cell_index(world, ix + dx, iy + dy)
        there = base_term(world, heading, q)
        s0, s1 = foot[q + feet[foot_row(t, heading, 0, o0 - by)]], foot[q + feet[foot_row(t, heading, 1, o1 - by)]]
        s2, s3 = foot[q + feet[foot_row(t, heading, 2, o2 - by)]], foot[q + feet[foot_row(t, heading, 3, o3 - by)]]
        reached = merged_cost(k, there, s0, s1, s2, s3)
        if reached == _INF:
            continue
        out_key[n] = pack(ix + dx, iy + dy, heading, o0 - by, o1 - by, o2 - by, o3 - by)
        out_cost[n] = price * np.sqrt(np.float64(dx * dx + dy * dy)) * 0.5 * (cost + reached)
        out_action[n] = action
        n += 1
    return n


@njit(inline="always")
def _steps(world, key, under, unevenness, out_key, out_cost, out_action, n):
    t = world.tables
    c = world.constants
    foot, feet, height, swing, edge = world.foot, t.feet, world.height, world.swing, world.edge
    line, steps = t.line, world.steps
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    p = cell_index(world, ix, iy)
    cost = merged_cost(c.unevenness, under, unevenness[0], unevenness[1], unevenness[2], unevenness[3])
    for i in range(4):
        shift = 15 - 5 * i
        offset = (key >> shift) & 0x1F
        at = p + feet[foot_row(t, heading, i, offset)]
        possible = steps[at]
        if possible == 0 or not supported(c, t.lowest, i, o0, o1, o2, o3):
            continue
        before = height[at]
        for sign in (1, -1):
            if sign < 0 and not c.step_backward:
                continue
            toward = heading if sign == 1 else (heading + HEADINGS // 2) % HEADINGS
            if (possible >> np.uint64(toward)) & np.uint64(1) == 0:
                continue
            if foot[at + line[toward, 1]] < _INF:  # the foot can still roll on
                continue
            crossed = False
            highest = before
            for length in range(1, line.shape[1]):
                to = offset + sign * length
                if to < 0 or to >= t.n_offsets:
                    break
                highest = max(highest, swing[at + line[toward, length]])
                crossed = crossed or edge[at + line[toward, length]]
                landing = p + feet[foot_row(t, heading, i, to)]
                reached = foot[landing]
                if not crossed or reached == _INF:
                    continue
                after = height[landing]
                if not step_fits(before, after, max(highest, after), c.step_max_height, c.step_max_clearance):
                    continue
                new = key + (np.int64(sign * length) << shift)
                if not separated(c, new):
                    continue
                s0, s1, s2, s3 = with_foot(unevenness, i, reached)
                effort = c.step + c.step_per_metre * length * RESOLUTION + c.step_per_height * abs(after - before)
                out_key[n] = new
                out_cost[n] = effort * 0.5 * (cost + merged_cost(c.unevenness, under, s0, s1, s2, s3))
                out_action[n] = STEP + 32 * i + 16 + sign * length
                n += 1
                break  # the nearest foothold; from there the foot can roll
    return n
