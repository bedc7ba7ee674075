"""Manoeuvres: foot moves, base shifts and steps, i.e. all actions with feet off neutral.

Source: paper, Sec. V-A, with the rules and costs in docs/cost-model.md. Steps and base shifts take feet off neutral;
single feet roll back toward neutral. A foot steps only where an edge on its line stops it, and then to the nearest
foothold beyond the edge. The base shifts where a foot can step or is ahead of neutral. The robot file decides whether
steps and base shifts also go backward.
"""

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.actions.action import BASE_BACKWARD, BASE_FORWARD, foot_move_code, step_code
from hdsp.detailed.actions.state_costs import foot_row, merged_cost, separated, supported
from hdsp.detailed.states import foot_offset, foot_shift, pack, unpack
from hdsp.detailed.world.body import body_is_free
from hdsp.detailed.world.world import cell_index, step_effort, step_fits
from hdsp.robot.lattice import HEADINGS

_INF = np.inf


@njit(allocates=False)
def manoeuvres(world, key, can_step, unevenness, out_key, out_cost, out_action, n):
    """Writes the successors by manoeuvres after the first ``n``; returns the new number.

    Args:
        world, key, out_key, out_cost, out_action: as in ``successors``.
        can_step: whether some foot can step from here.
        unevenness: S under the four feet.
        n: number of successors before.
    """
    # Not inlined: its arrays would have their references counted at every state, and few states get here.
    n = _foot_moves(world, key, unevenness, out_key, out_cost, out_action, n)
    n = _base_shifts(world, key, can_step, unevenness, out_key, out_cost, out_action, n)
    if can_step:
        n = _steps(world, key, unevenness, out_key, out_cost, out_action, n)
    return n


@njit(inline="always")
def _foot_moves(world, key, unevenness, out_key, out_cost, out_action, n):
    t = world.tables
    uneven, contacts, k, price = world.uneven, t.contacts, world.constants.unevenness, world.constants.foot_move
    ix, iy, heading, _, _, _, _ = unpack(key)
    p = cell_index(world, ix, iy)
    for i in range(4):
        shift = foot_shift(i)
        offset = foot_offset(key, shift)
        before = unevenness[0] if i == 0 else unevenness[1] if i == 1 else unevenness[2] if i == 2 else unevenness[3]
        for backward in range(2):
            change = 1 - 2 * backward
            if (offset + t.lowest) * change >= 0:  # only toward neutral
                continue
            reached = uneven[p + contacts[foot_row(t, heading, i, offset + change)]]
            if reached == _INF:
                continue
            new = key + (np.int64(change) << shift)
            if not separated(world.constants, new) or not _base_is_free(world, new):
                continue
            out_key[n] = new
            out_cost[n] = price * (1.0 + 10.0 * k * 0.5 * (np.float64(before) + reached))
            out_action[n] = foot_move_code(i, backward)
            n += 1
    return n


@njit(inline="always")
def _base_shifts(world, key, can_step, unevenness, out_key, out_cost, out_action, n):
    t = world.tables
    uneven, contacts, k, price = world.uneven, t.contacts, world.constants.unevenness, world.constants.base_shift
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    cost = merged_cost(k, unevenness[0], unevenness[1], unevenness[2], unevenness[3])
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
        s0 = uneven[q + contacts[foot_row(t, heading, 0, o0 - by)]]
        s1 = uneven[q + contacts[foot_row(t, heading, 1, o1 - by)]]
        s2 = uneven[q + contacts[foot_row(t, heading, 2, o2 - by)]]
        s3 = uneven[q + contacts[foot_row(t, heading, 3, o3 - by)]]
        reached = merged_cost(k, s0, s1, s2, s3)
        if reached == _INF or not body_is_free(world, heading, q, o0 - by, o1 - by, o2 - by, o3 - by):
            continue
        out_key[n] = pack(ix + dx, iy + dy, heading, o0 - by, o1 - by, o2 - by, o3 - by)
        out_cost[n] = price * np.sqrt(np.float64(dx * dx + dy * dy)) * 0.5 * (cost + reached)
        out_action[n] = action
        n += 1
    return n


@njit(inline="always")
def _steps(world, key, unevenness, out_key, out_cost, out_action, n):
    t = world.tables
    c = world.constants
    standable, height, swing, edge = world.standable, world.height, world.swing, world.edge
    uneven, feet, contacts = world.uneven, t.feet, t.contacts
    line, steps, banned = t.line, world.steps, world.banned
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    p = cell_index(world, ix, iy)
    cost = merged_cost(c.unevenness, unevenness[0], unevenness[1], unevenness[2], unevenness[3])
    for i in range(4):
        shift = foot_shift(i)
        offset = foot_offset(key, shift)
        at = p + feet[foot_row(t, heading, i, offset)]
        possible = steps[at]
        if possible == 0 or not supported(c, t.lowest, i, o0, o1, o2, o3):
            continue
        if len(banned) > 0 and is_banned(banned, i, at, heading, o0, o1, o2, o3):
            continue
        before = height[at]
        for sign in (1, -1):
            if sign < 0 and not c.step_backward:
                continue
            toward = heading if sign == 1 else (heading + HEADINGS // 2) % HEADINGS
            if (possible >> np.uint64(toward)) & np.uint64(1) == 0:
                continue
            if standable[at + line[toward, 1]]:  # the foot can still roll on
                continue
            crossed = False
            highest = before
            for length in range(1, line.shape[1]):
                to = offset + sign * length
                if to < 0 or to >= t.n_offsets:
                    break
                highest = max(highest, swing[at + line[toward, length]])
                crossed = crossed or edge[at + line[toward, length]]
                row = foot_row(t, heading, i, to)
                landing = p + feet[row]
                reached = uneven[p + contacts[row]]
                if not crossed or reached == _INF:
                    continue
                after = height[landing]
                if not step_fits(before, after, max(highest, after), c.step_max_height, c.step_max_clearance):
                    continue
                new = key + (np.int64(sign * length) << shift)
                if not separated(c, new) or not _base_is_free(world, new):
                    continue
                s0, s1, s2, s3 = _with_foot(unevenness, i, reached)
                effort = step_effort(c.step, c.step_per_metre, c.step_per_height, length, before, after)
                out_key[n] = new
                out_cost[n] = effort * 0.5 * (cost + merged_cost(c.unevenness, s0, s1, s2, s3))
                out_action[n] = step_code(i, sign * length)
                n += 1
                break  # the nearest foothold; from there the foot can roll
    return n


@njit(allocates=False)
def _base_is_free(world, key):
    """Whether the base is free in a packed state with footholds for all feet."""
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    return body_is_free(world, heading, cell_index(world, ix, iy), o0, o1, o2, o3)


@njit()
def is_banned(banned, foot, cell, heading, o0, o1, o2, o3):
    """Whether a step is banned.

    A row in ``banned``, int64 [n, 7], holds the foot, its flat cell, the heading, the offsets of the next three feet
    relative to its own, and the tolerance for these offsets in cells. A base shift changes none of them: a step that is
    impossible from one base position is impossible from all.
    """
    offsets = (o0, o1, o2, o3)
    for k in range(len(banned)):
        if banned[k, 0] != foot or banned[k, 1] != cell or banned[k, 2] != heading:
            continue
        near = True
        for j in range(3):
            ahead = offsets[(foot + 1 + j) % 4] - offsets[foot]
            near = near and abs(ahead - banned[k, 3 + j]) <= banned[k, 6]
        if near:
            return True
    return False


@njit(inline="always")
def _with_foot(unevenness, i, value):
    """The four values with a new one for foot ``i``."""
    s0, s1, s2, s3 = unevenness
    return (
        value if i == 0 else s0, value if i == 1 else s1,
        value if i == 2 else s2, value if i == 3 else s3,
    )  # fmt: skip
