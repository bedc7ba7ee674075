"""A relaxed problem of three dimensions: what the detailed search could at best do at each base pose.

It has two layers. On neutral feet the robot drives and turns exactly as the detailed search does. From a neutral pose
at which a foot can step it may go over into the layer of any feet: there a pose is possible if the body is free and
each foot finds some foothold, the base shifts along its heading at the least state cost over all feet, and where
neutral feet can stand the robot may go back to them. What cannot be reached here cannot be reached in seven dimensions,
and costs here never exceed the true ones: this proves infeasibility and is a consistent heuristic.

Feet that a base shift leaves behind must follow. If the base only shifts forward, each cell costs what four feet need
at least to follow by a cell (``follow``), and a state whose feet are ahead has that much less to go: costs to go are
``table(layer, pose) - follow * sum(offsets)``, with offsets counted from the lowest.
"""

from typing import NamedTuple

import numpy as np

from hdsp.detailed.actions import MAX_SUCCESSORS, Rules, successors
from hdsp.detailed.estimate import least_foot_cost
from hdsp.detailed.state_costs import feet_cells, foot_row, state_cost
from hdsp.detailed.states import pack
from hdsp.detailed.world import World, base_term, cell_index
from hdsp.jit import njit
from hdsp.lattice import HEADINGS


class Relaxed(NamedTuple):
    """What can be reached from one state, and the edges between. A pose is ``(slot * nx + ix) * ny + iy``; slots are
    the allowed headings in turn.

    Attributes:
        first: heading of slot 0.
        follow: cost per cell that a foot follows a base shift.
        distance: float32 [2, poses]; cost from the start to a state there, but for ``follow`` times by how much its
            offsets are ahead of those of the start; layer 0 on neutral feet, 1 on any.
        edge: float32 [poses, 22]; costs of driving and turning on neutral feet, where layer 0 was reached.
        some: float32 [poses]; least state cost over all feet, inf where impossible, 0 where nobody asked.
        stepping: bool [poses]; whether a foot can step, where layer 0 was reached.
        cut: bool [1]; whether the limit kept anything out.
    """

    first: int
    follow: float
    distance: np.ndarray
    edge: np.ndarray
    some: np.ndarray
    stepping: np.ndarray
    cut: np.ndarray


def explore(world: World, rules: Rules, start: np.ndarray, limit: float) -> Relaxed:
    """All that the relaxed problem reaches from a state, int64 [7] with an allowed heading, within a finite cost."""
    slots = min(2 * rules.heading_window + 1, HEADINGS)
    first = (rules.heading_center - rules.heading_window) % HEADINGS if slots < HEADINGS else 0
    follow = 0.0 if world.constants.shift_backward else least_foot_cost(world)
    n = slots * world.nx * world.ny
    relaxed = Relaxed(
        first=first,
        follow=follow,
        distance=np.full((2, n), np.inf, dtype=np.float32),
        edge=np.empty((n, 22), dtype=np.float32),
        some=np.zeros(n, dtype=np.float32),
        stepping=np.zeros(n, dtype=np.bool_),
        cut=np.zeros(1, dtype=np.bool_),
    )
    layer, pose = _nodes(world, relaxed, start[None])
    most = limit + follow * float((start[3:] - world.tables.lowest).sum())
    flat = relaxed.distance.reshape(-1)
    relaxed.cut[0] = _spread(world, rules, relaxed, flat, layer * n + pose, np.zeros(1), most, False)
    return relaxed


def least_costs(world: World, relaxed: Relaxed, start: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """Relaxed costs, float64 [n], from the start of ``relaxed`` to states int64 [n, 7]; inf beyond the limit."""
    layer, pose = _nodes(world, relaxed, goals)
    ahead = relaxed.follow * (goals[:, 3:].sum(axis=1) - start[3:].sum())
    return np.maximum(relaxed.distance[layer, pose].astype(float) + ahead, 0)


def costs_to_go(world: World, rules: Rules, relaxed: Relaxed, start: np.ndarray, goals, later, limit: float):
    """Relaxed costs to the nearest of several goals.

    Args:
        world: terrain and robot.
        rules: of the search.
        relaxed: from ``explore``.
        start: int64 [7], the same as there.
        goals: int64 [n, 7].
        later: float64 [n], >= 0, cost that each goal counts as farther away.
        limit: poses through which no plan up to this cost leads stay inf.

    Returns:
        float32 [2, 64, nx, ny], costs of the module's docstring, and whether the limit kept anything out.
    """
    layer, pose = _nodes(world, relaxed, goals)
    lowest = world.tables.lowest
    initial = later + relaxed.follow * (goals[:, 3:] - lowest).sum(axis=1)
    n = relaxed.distance.shape[1]
    to_go = np.full(2 * n, np.inf, dtype=np.float32)
    most = limit + relaxed.follow * float((start[3:] - lowest).sum())
    cut = _spread(world, rules, relaxed, to_go, layer * n + pose, initial, most, True)
    table = np.full((2, HEADINGS, world.nx, world.ny), np.inf, dtype=np.float32)
    slots = n // (world.nx * world.ny)
    table[:, (relaxed.first + np.arange(slots)) % HEADINGS] = to_go.reshape(2, slots, world.nx, world.ny)
    return table, bool(cut or relaxed.cut[0])


def _nodes(world: World, relaxed: Relaxed, states: np.ndarray):
    """Layer and pose of states [n, 7]."""
    slot = (states[:, 2] - relaxed.first) % HEADINGS
    return states[:, 3:].any(axis=1).astype(np.int64), (slot * world.nx + states[:, 0]) * world.ny + states[:, 1]


@njit()
def _spread(world, rules, relaxed, cost, sources, initial, most, backward):
    """One Dijkstra over the relaxed problem from several nodes at once; whether ``most`` kept anything out.

    Args:
        world, rules: terrain, robot and restrictions of the search.
        relaxed: edges; filled in on the way forward, read on the way back.
        cost: float32 [2 * poses], inf; the result.
        sources: int64 [n], nodes, ``layer * poses + pose``.
        initial: float64 [n], cost at which each source starts.
        most: highest cost of interest; on the way back, together with the cost from the start.
        backward: costs to the sources instead of from them.
    """
    t = world.tables
    nx, ny, first, follow, size = world.nx, world.ny, relaxed.first, relaxed.follow, len(relaxed.some)
    slots = size // (nx * ny)
    edge, some, stepping, distance = relaxed.edge, relaxed.some, relaxed.stepping, relaxed.distance.reshape(-1)
    move_dx, move_dy, shifts, zero = t.move_dx, t.move_dy, t.shifts, -t.lowest
    price, two_ways = world.constants.base_shift, world.constants.shift_backward
    drive = Rules(rules.heading_center, rules.heading_window, rules.turn_cost_factor, True)
    out_key, out_cost = np.empty(MAX_SUCCESSORS, np.int64), np.empty(MAX_SUCCESSORS)
    out_action = np.empty(MAX_SUCCESSORS, np.uint8)
    near, step = np.empty(32, np.int64), np.empty(32)
    # Nodes wait in buckets by cost. Buckets need not be narrower than the smallest edge: a node that gets cheaper while
    # its bucket is worked on is taken up again.
    width = max(0.5 * world.constants.turn * rules.turn_cost_factor, most / 4096)
    heads = np.full(int(most / width) + 2, -1, np.int64)
    entry, value, link = np.empty(1 << 14, np.int64), np.empty(1 << 14, np.float32), np.empty(1 << 14, np.int64)
    free, used, cut = np.int64(-1), 0, False
    before = cost if not backward else distance
    for s in range(len(sources)):
        if (backward and before[sources[s]] == np.inf) or initial[s] > most or initial[s] >= cost[sources[s]]:
            continue
        cost[sources[s]] = initial[s]
        b = int(cost[sources[s]] / width)
        entry[used], value[used], link[used], heads[b] = sources[s], cost[sources[s]], heads[b], used
        used += 1
    for b in range(len(heads)):
        while heads[b] >= 0:
            e = heads[b]
            heads[b], link[e], free = link[e], free, e
            here = entry[e]
            if value[e] != cost[here]:
                continue
            layer, pose = here // size, here % size
            slot, x, y = pose // (nx * ny), pose // ny % nx, pose % ny
            heading = (first + slot) % HEADINGS
            n = 0
            if layer == 0:
                if not backward:
                    edge[pose] = np.inf
                    key = pack(x, y, heading, zero, zero, zero, zero)
                    for k in range(successors(world, drive, key, out_key, out_cost, out_action)):
                        edge[pose, out_action[k]] = out_cost[k]
                    stepping[pose] = can_step_from_neutral(world, x, y, heading)
                sign = -1 if backward else 1
                for m in range(20):
                    u, v = x + sign * move_dx[m], y + sign * move_dy[m]
                    if not (0 <= u < nx and 0 <= v < ny):
                        continue
                    other = (slot * nx + u) * ny + v
                    if backward and before[other] == np.inf:
                        continue
                    near[n], step[n] = other, edge[other, m] if backward else edge[pose, m]
                    n += 1
                for action in (20, 21):
                    way = sign if action == 20 else -sign
                    to = ((heading + way) % HEADINGS - first) % HEADINGS
                    if to >= slots:
                        continue
                    other = (to * nx + x) * ny + y
                    if backward and before[other] == np.inf:
                        continue
                    near[n], step[n] = other, edge[other, action] if backward else edge[pose, action]
                    n += 1
                if backward or stepping[pose]:
                    near[n], step[n] = size + pose, 0.0
                    n += 1
            else:
                for sign in (1, -1):
                    if sign == -1 and not two_ways:
                        continue
                    way = -sign if backward else sign
                    u, v = x + way * shifts[heading, 0], y + way * shifts[heading, 1]
                    if not (0 <= u < nx and 0 <= v < ny):
                        continue
                    other = (slot * nx + u) * ny + v
                    for q, qx, qy in ((pose, x, y), (other, u, v)):
                        if some[q] == 0:
                            some[q] = least_pose_cost(world, qx, qy, heading)
                    length = np.sqrt(np.float64(shifts[heading, 0] ** 2 + shifts[heading, 1] ** 2))
                    near[n] = size + other
                    step[n] = price * length * 0.5 * (some[pose] + some[other]) + 4 * follow * shifts[heading, 2]
                    n += 1
                stands = stepping[pose] if backward else state_cost_is_finite(world, x, y, heading)
                if stands:
                    near[n], step[n] = pose, 0.0
                    n += 1
            for k in range(n):
                there = near[k]
                if step[k] == np.inf or (backward and before[there] == np.inf):
                    continue
                new = np.float32(cost[here] + step[k])
                if new >= cost[there]:
                    continue
                if new + (before[there] if backward else 0) > most:
                    cut = True
                    continue
                cost[there] = new
                if free < 0 and used == len(entry):
                    entry, value = np.concatenate((entry, entry)), np.concatenate((value, value))
                    link = np.concatenate((link, link))
                if free >= 0:
                    e, free = free, link[free]
                else:
                    e = used
                    used += 1
                to = int(new / width)
                entry[e], value[e], link[e], heads[to] = there, new, heads[to], e
    return cut


@njit()
def state_cost_is_finite(world, x, y, heading):
    """Whether the robot can stand on neutral feet."""
    zero = -world.tables.lowest
    return state_cost(world, pack(x, y, heading, zero, zero, zero, zero)) < np.inf


@njit()
def can_step_from_neutral(world, x, y, heading):
    """Whether some foot can step while all are neutral."""
    t = world.tables
    steps, feet, n_offsets, n_samples, zero = world.steps, t.feet, t.n_offsets, t.n_samples, -t.lowest
    p = cell_index(world, x, y)
    p0, p1, p2, p3 = feet_cells(p, feet, n_offsets, n_samples, heading, zero, zero, zero, zero)
    ways = steps[p0] | steps[p1] | steps[p2] | steps[p3]
    if world.constants.step_backward:
        ways |= (ways << np.uint64(HEADINGS // 2)) | (ways >> np.uint64(HEADINGS // 2))
    return (ways >> np.uint64(heading)) & np.uint64(1) != 0


@njit()
def least_pose_cost(world, x, y, heading):
    """Least state cost at a pose over all feet; inf where no state is valid."""
    t = world.tables
    foot, feet, n_offsets, n_samples = world.foot, t.feet, t.n_offsets, t.n_samples
    p = cell_index(world, x, y)
    largest = base_term(world, heading, p)
    if largest == np.inf:
        return np.inf
    total = np.float32(0)
    for i in range(4):
        row = foot_row(t, heading, i, 0)
        # The neutral offset first: on even ground nothing is better.
        best = foot[p + feet[row - t.lowest * n_samples]]
        if best > 0:
            for offset in range(n_offsets):
                best = min(best, foot[p + feet[row + offset * n_samples]])
        total += best
        largest = max(largest, best)
    return 1.0 + world.constants.unevenness * (np.float64(largest) + total)
