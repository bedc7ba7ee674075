"""The detailed actions and what they cost: all successors of a state.

Source: paper, Sec. V-A, with the cost model of docs/cost-model.md. Steps are considered only over an edge. Moving a foot
and shifting the base are considered only where they have a purpose: while a foot is off its neutral position, or can step.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from hdsp.detailed.states import BASE_BACKWARD, BASE_FORWARD, FOOT_MOVE, STEP, TURN_LEFT, TURN_RIGHT, pack, unpack
from hdsp.detailed.world import base_term, cell_index, step_fits
from hdsp.lattice import HEADINGS, RESOLUTION

MAX_SUCCESSORS = 160

_INF = np.inf


class Rules(NamedTuple):
    """How a search may move, beyond what the robot can do.

    Attributes:
        heading_center: heading about which the window below lies.
        heading_window: most heading steps a state may differ from the centre; 32 or more means any heading.
        turn_cost_factor: multiplies the cost of turning.
    """

    heading_center: int = 0
    heading_window: int = HEADINGS
    turn_cost_factor: float = 1.0


@njit(cache=True, inline="always")
def foot_row(tables, heading, foot, offset):
    """Where the samples of a foot begin in ``tables.feet``."""
    return ((heading * 4 + foot) * tables.n_offsets + offset) * tables.n_samples


@njit(cache=True, inline="always")
def sampled_cost(world, p, base, r0, r1, r2, r3):
    """State cost C with the base's term ``base``, the base at flat cell ``p`` and the feet at table rows ``r``."""
    feet = world.tables.feet
    s0, s1 = world.foot[p + feet[r0]], world.foot[p + feet[r1]]
    s2, s3 = world.foot[p + feet[r2]], world.foot[p + feet[r3]]
    largest = max(max(s0, s1), max(max(s2, s3), base))
    return 1.0 + world.constants.unevenness * (np.float64(largest) + (np.float64(s0) + s1) + (np.float64(s2) + s3))


@njit(cache=True, error_model="numpy")
def state_cost(world, key):
    """State cost C of a packed state; inf if a foot cannot stand there or the body collides."""
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    p = cell_index(world, ix, iy)
    t = world.tables
    rows = foot_row(t, heading, 0, o0), foot_row(t, heading, 1, o1), foot_row(t, heading, 2, o2), foot_row(t, heading, 3, o3)
    return sampled_cost(world, p, base_term(world, heading, p), rows[0], rows[1], rows[2], rows[3])


@njit(cache=True, error_model="numpy")
def feet_unevenness(world, p, r0, r1, r2, r3):
    """Sum of S under the four feet; inf if one cannot stand."""
    feet = world.tables.feet
    s = np.float64(world.foot[p + feet[r0]]) + world.foot[p + feet[r1]]
    return s + (np.float64(world.foot[p + feet[r2]]) + world.foot[p + feet[r3]])


@njit(cache=True, error_model="numpy")
def separated(tables, constants, o0, o1, o2, o3):
    """Whether front and rear foot of each side keep their distance."""
    apart = 2 * constants.neutral_x - constants.min_separation
    return o1 - o0 <= apart and o2 - o3 <= apart


@njit(cache=True, error_model="numpy")
def supported(constants, lowest, lifted, o0, o1, o2, o3):
    """Whether the base centre lies in the triangle of the three feet that stay, ``support_margin`` cells inside its edges."""
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


@njit(cache=True, error_model="numpy")
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
    n = _drives(world, key, out_key, out_cost, out_action, 0)
    n = _turns(world, rules, key, out_key, out_cost, out_action, n)
    t = world.tables
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    p = cell_index(world, ix, iy)
    r0, r1 = foot_row(t, heading, 0, o0), foot_row(t, heading, 1, o1)
    r2, r3 = foot_row(t, heading, 2, o2), foot_row(t, heading, 3, o3)
    ways = world.steps[p + t.feet[r0]] | world.steps[p + t.feet[r1]] | world.steps[p + t.feet[r2]] | world.steps[p + t.feet[r3]]
    behind = (heading + HEADINGS // 2) % HEADINGS
    can_step = ((ways >> np.uint64(heading)) | (ways >> np.uint64(behind))) & np.uint64(1)
    neutral = -t.lowest
    if can_step == 0 and o0 == neutral and o1 == neutral and o2 == neutral and o3 == neutral:
        return n
    cost = sampled_cost(world, p, base_term(world, heading, p), r0, r1, r2, r3)
    n = _foot_moves(world, key, cost, out_key, out_cost, out_action, n)
    n = _base_shifts(world, key, cost, out_key, out_cost, out_action, n)
    if can_step != 0:
        n = _steps(world, key, cost, out_key, out_cost, out_action, n)
    return n


@njit(cache=True, error_model="numpy")
def _drives(world, key, out_key, out_cost, out_action, n):
    t = world.tables
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    p = cell_index(world, ix, iy)
    r0, r1 = foot_row(t, heading, 0, o0), foot_row(t, heading, 1, o1)
    r2, r3 = foot_row(t, heading, 2, o2), foot_row(t, heading, 3, o3)
    for m in range(20):
        q = p + t.move_flat[m]
        total = sampled_cost(world, q, base_term(world, heading, q), r0, r1, r2, r3)
        if total == _INF:
            continue
        for s in range(t.move_first[m], t.move_first[m] + t.move_count[m]):
            base = base_term(world, heading, p + t.base_sample[s])
            total += sampled_cost(world, p, base, r0 + s, r1 + s, r2 + s, r3 + s)
        if total == _INF:
            continue
        out_key[n] = key + (np.int64(t.move_dx[m]) << 42) + (np.int64(t.move_dy[m]) << 26)
        out_cost[n] = t.move_length[m] * t.deviation[heading, m] * total / (t.move_count[m] + 1)
        out_action[n] = m
        n += 1
    return n


@njit(cache=True, error_model="numpy")
def _turns(world, rules, key, out_key, out_cost, out_action, n):
    t = world.tables
    c = world.constants
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    p = cell_index(world, ix, iy)
    here = feet_unevenness(
        world, p, foot_row(t, heading, 0, o0), foot_row(t, heading, 1, o1),
        foot_row(t, heading, 2, o2), foot_row(t, heading, 3, o3),
    )  # fmt: skip
    for action in (TURN_LEFT, TURN_RIGHT):
        new = (heading + (1 if action == TURN_LEFT else HEADINGS - 1)) % HEADINGS
        off = (new - rules.heading_center + HEADINGS // 2) % HEADINGS - HEADINGS // 2
        if abs(off) > rules.heading_window or base_term(world, new, p) == _INF:
            continue
        there = feet_unevenness(
            world, p, foot_row(t, new, 0, o0), foot_row(t, new, 1, o1), foot_row(t, new, 2, o2), foot_row(t, new, 3, o3)
        )
        if there == _INF:
            continue
        out_key[n] = pack(ix, iy, new, o0, o1, o2, o3)
        out_cost[n] = c.turn * rules.turn_cost_factor * (1.0 + c.turn_unevenness * 0.5 * (here + there))
        out_action[n] = action
        n += 1
    return n


@njit(cache=True, error_model="numpy")
def _foot_moves(world, key, cost, out_key, out_cost, out_action, n):
    t = world.tables
    for foot in range(4):
        shift = 15 - 5 * foot
        offset = (key >> shift) & 0x1F
        for backward in range(2):
            change = 1 - 2 * backward
            if offset + change < 0 or offset + change >= t.n_offsets:
                continue
            new = key + (np.int64(change) << shift)
            _, _, _, o0, o1, o2, o3 = unpack(new)
            if not separated(t, world.constants, o0, o1, o2, o3):
                continue
            reached = state_cost(world, new)
            if reached == _INF:
                continue
            out_key[n] = new
            out_cost[n] = world.constants.foot_move * 0.5 * (cost + reached)
            out_action[n] = FOOT_MOVE + 2 * foot + backward
            n += 1
    return n


@njit(cache=True, error_model="numpy")
def _base_shifts(world, key, cost, out_key, out_cost, out_action, n):
    t = world.tables
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    for action in (BASE_FORWARD, BASE_BACKWARD):
        sign = 1 if action == BASE_FORWARD else -1
        dx, dy, by = sign * t.shifts[heading, 0], sign * t.shifts[heading, 1], sign * t.shifts[heading, 2]
        lowest, highest = min(min(o0, o1), min(o2, o3)) - by, max(max(o0, o1), max(o2, o3)) - by
        if lowest < 0 or highest >= t.n_offsets or not (0 <= ix + dx < world.nx and 0 <= iy + dy < world.ny):
            continue
        new = pack(ix + dx, iy + dy, heading, o0 - by, o1 - by, o2 - by, o3 - by)
        reached = state_cost(world, new)
        if reached == _INF:
            continue
        out_key[n] = new
        out_cost[n] = world.constants.base_shift * np.sqrt(np.float64(dx * dx + dy * dy)) * 0.5 * (cost + reached)
        out_action[n] = action
        n += 1
    return n


@njit(cache=True, error_model="numpy")
def _steps(world, key, cost, out_key, out_cost, out_action, n):
    t = world.tables
    c = world.constants
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    p = cell_index(world, ix, iy)
    offsets = (o0, o1, o2, o3)
    for foot in range(4):
        at = p + t.feet[foot_row(t, heading, foot, offsets[foot])]
        possible = world.steps[at]
        if possible == 0 or not supported(c, t.lowest, foot, o0, o1, o2, o3):
            continue
        before = world.height[at]
        shift = 15 - 5 * foot
        for sign in (1, -1):
            toward = heading if sign == 1 else (heading + HEADINGS // 2) % HEADINGS
            if (possible >> np.uint64(toward)) & np.uint64(1) == 0:
                continue
            edge = False
            highest = before
            for length in range(1, t.line.shape[1]):
                offset = offsets[foot] + sign * length
                if offset < 0 or offset >= t.n_offsets:
                    break
                on_line = at + t.line[toward, length]
                highest = max(highest, world.height[on_line])
                if world.foot[on_line] == _INF:
                    edge = True
                    continue
                if not edge:
                    continue
                new = key + (np.int64(sign * length) << shift)
                landing = p + t.feet[foot_row(t, heading, foot, offset)]
                after = world.height[landing]
                if not step_fits(before, after, max(highest, after), c.step_max_height, c.step_max_clearance):
                    continue
                _, _, _, n0, n1, n2, n3 = unpack(new)
                if not separated(t, c, n0, n1, n2, n3):
                    continue
                reached = state_cost(world, new)
                if reached == _INF:
                    continue
                effort = c.step + c.step_per_metre * length * RESOLUTION + c.step_per_height * abs(after - before)
                out_key[n] = new
                out_cost[n] = effort * 0.5 * (cost + reached)
                out_action[n] = STEP + 32 * foot + 16 + sign * length
                n += 1
    return n
