"""A relaxed problem of three dimensions: what the detailed search could at best do at each base pose.

Every foot may stand anywhere in its reach at any time and moves for free, so a pose is possible if the body is free and
each foot finds some foothold, and an edge costs no more than it does with the best feet. What cannot be reached here
cannot be reached in seven dimensions, and costs here never exceed the true ones: this proves infeasibility and is an
admissible, consistent heuristic (together with the term for the feet of ``estimate``, which counts other actions).
"""

import numpy as np

from hdsp.detailed.state_costs import foot_row
from hdsp.detailed.world import cell_index, compute_base_term
from hdsp.jit import njit
from hdsp.lattice import HEADINGS


@njit()
def pose_costs(world, rules):
    """Least state cost at each pose over all feet, float32 [64, nx, ny]; inf where no state is valid or allowed."""
    t = world.tables
    # Arrays are named once: each access through a tuple counts references.
    foot, feet, base, size = world.foot, t.feet, world.base, len(world.foot)
    n_offsets, n_samples, neutral, k = t.n_offsets, t.n_samples, -t.lowest, world.constants.unevenness
    result = np.full((HEADINGS, world.nx, world.ny), np.inf, dtype=np.float32)
    for heading in range(HEADINGS):
        off = (heading - rules.heading_center + HEADINGS // 2) % HEADINGS - HEADINGS // 2
        if abs(off) > rules.heading_window:
            continue
        for ix in range(world.nx):
            for iy in range(world.ny):
                p = cell_index(world, ix, iy)
                under = base[heading * size + p]
                if under == 0:
                    under = compute_base_term(world, heading, p)
                largest, total = under - np.float32(1), np.float32(0)
                for i in range(4):
                    if largest == np.inf:
                        break
                    row = foot_row(t, heading, i, 0)
                    # The neutral offset first: on even ground nothing is better.
                    best = foot[p + feet[row + neutral * n_samples]]
                    if best > 0:
                        for offset in range(n_offsets):
                            best = min(best, foot[p + feet[row + offset * n_samples]])
                    total += best
                    largest = max(largest, best)
                result[heading, ix, iy] = 1.0 + k * (np.float64(largest) + total)
    return result


@njit()
def _least_edge(world, rules, heading, action, from_cost, to_cost):
    """Lower bound of the cost of a pose-changing action (0..19 drive, 20 turn, 21 base shift)."""
    t = world.tables
    if action < 20:
        between = t.move_count[action]
        return t.move_length[action] * t.deviation[heading, action] * (to_cost + between) / (between + 1)
    if action == 20:
        return world.constants.turn * rules.turn_cost_factor
    dx, dy = t.shifts[heading, 0], t.shifts[heading, 1]
    return world.constants.base_shift * np.sqrt(np.float64(dx * dx + dy * dy)) * 0.5 * (from_cost + to_cost)


@njit()
def _least_of_all_edges(world, rules):
    """A cost that no pose-changing action is below."""
    t = world.tables
    least = world.constants.turn * rules.turn_cost_factor
    for heading in range(HEADINGS):
        dx, dy = t.shifts[heading, 0], t.shifts[heading, 1]
        least = min(least, world.constants.base_shift * np.sqrt(np.float64(dx * dx + dy * dy)))
        for a in range(20):
            least = min(least, t.move_length[a] * t.deviation[heading, a])
    return least


@njit()
def pose_distances(world, rules, costs, sources, initial, backward, limit):
    """One Dijkstra over poses from several of them at once.

    Args:
        world: terrain and robot.
        rules: restrictions of the search.
        costs: from ``pose_costs``.
        sources: int64 [n, 3], (ix, iy, heading).
        initial: float64 [n], cost at which each source starts.
        backward: costs to the sources instead of from them.
        limit: poses farther than this stay inf.

    Returns:
        float32 [64, nx, ny]: least relaxed cost.
    """
    t = world.tables
    distance = np.full((HEADINGS, world.nx, world.ny), np.inf, dtype=np.float32)
    width = _least_of_all_edges(world, rules) * 0.999
    # Ring of buckets no wider than the smallest edge: everything in the current bucket is final. What lies beyond the
    # ring waits in its last bucket and is put back when that comes up.
    ring = int(np.ceil((0.5 + np.max(initial)) / width)) + 2
    heads = np.full(ring, -1, dtype=np.int64)
    capacity = max(1 << 14, 4 * len(sources))
    entry, link = np.empty(capacity, np.int64), np.empty(capacity, np.int64)
    free, n = np.int64(-1), 0
    waiting = len(sources)
    for s in range(len(sources)):
        h, x, y = sources[s, 2], sources[s, 0], sources[s, 1]
        if initial[s] >= distance[h, x, y]:
            waiting -= 1
            continue
        distance[h, x, y] = initial[s]
        slot = int(initial[s] / width) % ring
        entry[n], link[n] = (h * world.nx + x) * world.ny + y, heads[slot]
        heads[slot] = n
        n += 1
    done = np.zeros(distance.size, dtype=np.bool_)
    flat = distance.ravel()
    bucket = 0
    while waiting > 0:
        b = bucket % ring
        while heads[b] >= 0:
            e = heads[b]
            heads[b] = link[e]
            here = entry[e]
            due = int(flat[here] / width)
            if due > bucket and not done[here]:
                slot = min(due, bucket + ring - 1) % ring
                link[e], heads[slot] = heads[slot], e
                continue
            link[e] = free
            free = e
            waiting -= 1
            if done[here]:
                continue
            done[here] = True
            h, rest = here // (world.nx * world.ny), here % (world.nx * world.ny)
            x, y = rest // world.ny, rest % world.ny
            d = np.float64(flat[here])
            for action in range(24):
                a, nh, nx, ny = _neighbour(t, h, x, y, action, backward)
                if not (0 <= nx < world.nx and 0 <= ny < world.ny) or costs[nh, nx, ny] == np.inf:
                    continue
                there = (nh * world.nx + nx) * world.ny + ny
                if done[there]:
                    continue
                if backward:
                    new = d + _least_edge(world, rules, h, a, costs[nh, nx, ny], costs[h, x, y])
                else:
                    new = d + _least_edge(world, rules, h, a, costs[h, x, y], costs[nh, nx, ny])
                if new < flat[there] and new <= limit:
                    flat[there] = new
                    if free >= 0:
                        e = free
                        free = link[e]
                    else:
                        if n == len(entry):
                            entry = np.concatenate((entry, np.empty_like(entry)))
                            link = np.concatenate((link, np.empty_like(link)))
                        e = n
                        n += 1
                    slot = min(int(new / width), bucket + ring - 1) % ring
                    entry[e], link[e] = there, heads[slot]
                    heads[slot] = e
                    waiting += 1
        bucket += 1
    return distance


@njit(inline="always")
def _neighbour(t, h, x, y, action, backward):
    """(kind, heading, ix, iy) of a pose's neighbour; actions 0..19 drive, 20/21 turn, 22/23 base shift."""
    sign = -1 if backward else 1
    if action < 20:
        return action, h, x + sign * t.move_dx[action], y + sign * t.move_dy[action]
    if action < 22:
        return 20, (h + 1 if action == 20 else h + HEADINGS - 1) % HEADINGS, x, y
    way = 1 if action == 22 else -1
    return 21, h, x + way * t.shifts[h, 0], y + way * t.shifts[h, 1]
