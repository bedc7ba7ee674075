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

from hdsp.base.jit import njit
from hdsp.detailed.actions.state_costs import feet_cells, foot_row, state_cost
from hdsp.detailed.actions.successors import MAX_SUCCESSORS, Rules, pose_successors
from hdsp.detailed.search.estimate import least_foot_cost
from hdsp.detailed.states import TURN_LEFT, TURN_RIGHT, pack
from hdsp.detailed.world.world import World, body_is_free, cell_index
from hdsp.robot.lattice import HEADINGS


class Poses(NamedTuple):
    """What the robot can do at each pose of some neighbouring headings, computed when first asked for.

    A pose is ``(slot * nx + ix) * ny + iy``; slots are the headings from ``first`` on.

    Attributes:
        first: heading of slot 0.
        slots: how many headings.
        edge: float32 [poses, 22]; costs of driving and turning on neutral feet, turns at their normal cost.
        known: bool [poses]; whether ``edge`` and ``stepping`` are filled in.
        stepping: bool [poses]; whether a foot can step while all are neutral.
        some: float32 [poses]; least state cost over all feet, inf where impossible, 0 where nobody asked.
        successors: buffers for those of one state.
    """

    first: int
    slots: int
    edge: np.ndarray
    known: np.ndarray
    stepping: np.ndarray
    some: np.ndarray
    successors: tuple[np.ndarray, np.ndarray, np.ndarray]


class Relaxed(NamedTuple):
    """What can be reached from one state.

    Attributes:
        poses: the poses and the edges between.
        follow: cost per cell that a foot follows a base shift.
        distance: float32 [2, poses]; cost from the start to a state there, but for ``follow`` times by how much its
            offsets are ahead of those of the start; layer 0 on neutral feet, 1 on any.
        driven: float64 [goals]; what driving and turning alone cost, inf where they do not lead.
        cut: whether the limit kept anything out.
    """

    poses: Poses
    follow: float
    distance: np.ndarray
    driven: np.ndarray
    cut: bool


class _Queue(NamedTuple):
    """Nodes that wait, in buckets by cost; each bucket is a list that is linked both ways."""

    width: float  # of a bucket
    heads: np.ndarray  # int32 [buckets], first node, -1 = none
    after: np.ndarray  # int32 [2 * poses], next node of the bucket, -1 = none
    ahead: np.ndarray  # int32 [2 * poses], previous node; -1 - b in front of bucket b; _OUT where a node does not wait


_OUT = np.int32(-(2**31))


def new_poses(world: World, center: int, window: int) -> Poses:
    """Poses at all headings at most ``window`` steps from ``center``."""
    slots = min(2 * window + 1, HEADINGS)
    n = slots * world.nx * world.ny
    return Poses(
        first=(center - window) % HEADINGS if slots < HEADINGS else 0,
        slots=slots,
        edge=np.empty((n, 22), dtype=np.float32),
        known=np.zeros(n, dtype=np.bool_),
        stepping=np.zeros(n, dtype=np.bool_),
        some=np.zeros(n, dtype=np.float32),
        successors=(np.empty(MAX_SUCCESSORS, np.int64), np.empty(MAX_SUCCESSORS), np.empty(MAX_SUCCESSORS, np.uint8)),
    )


def explore(
    world: World, rules: Rules, start: np.ndarray, limit: float, goals: np.ndarray | None = None, poses=None
) -> Relaxed:
    """All that the relaxed problem reaches from a state, within a finite cost.

    First the layer of neutral feet alone, which tells what driving costs. If it leads to all goals, nothing that costs
    more than the farthest of them is explored.

    Args:
        world: terrain and robot.
        rules: of the search.
        start: int64 [7], at an allowed heading.
        limit: highest cost of interest.
        goals: int64 [n, 7]; None = all that can be reached is of interest.
        poses: to share with searches under other rules; must have all headings that ``rules`` allow.
    """
    poses = poses or new_poses(world, rules.heading_center, rules.heading_window)
    follow = 0.0 if world.constants.shift_backward else least_foot_cost(world)
    n = len(poses.known)
    cost = np.full(2 * n, np.inf, dtype=np.float32)
    slack = follow * float((start[3:] - world.tables.lowest).sum())
    most = limit + slack
    goals = np.empty((0, 7), dtype=np.int64) if goals is None else goals
    goal_layer, goal_pose = _nodes(world, poses, goals)
    driven = np.full(len(goals), np.inf)
    layer, pose = (int(a[0]) for a in _nodes(world, poses, start[None]))
    sources, initial, cut = np.array([layer * n + pose]), np.zeros(1), False
    if layer == 0:
        on_neutral = goal_layer == 0
        wanted = np.zeros(n, dtype=np.bool_)
        if on_neutral.all():  # one farther goal, and there is nothing to be gained from an early end
            wanted[goal_pose] = True
        queue = _new_queue(world, rules, most, 2 * n)
        drive = rules._replace(drive_only=True)
        left = int(wanted.sum())
        cut = _spread(world, poses, drive, cost, cost, queue, sources, initial, most, wanted, left, follow, False)
        driven[on_neutral] = cost[goal_pose[on_neutral]]
        driven[driven > limit] = np.inf
        if len(goals) and np.isfinite(driven).all():
            most = min(limit, driven.max()) + slack
        sources = np.flatnonzero(poses.stepping & (cost[:n] <= most))
        initial = cost[sources].astype(float)
        sources += n
    if len(sources) and not rules.drive_only:
        queue = _new_queue(world, rules, most, 2 * n)
        none = np.zeros(n, dtype=np.bool_)
        cut |= _spread(world, poses, rules, cost, cost, queue, sources, initial, most, none, 0, follow, False)
    return Relaxed(poses, follow, cost.reshape(2, n), driven, bool(cut))


def least_costs(world: World, relaxed: Relaxed, start: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """Relaxed costs, float64 [n], from the start of ``relaxed`` to states int64 [n, 7]; inf beyond the limit."""
    layer, pose = _nodes(world, relaxed.poses, goals)
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
    poses, follow, lowest = relaxed.poses, relaxed.follow, world.tables.lowest
    layer, pose = _nodes(world, poses, goals)
    n = len(poses.known)
    initial = later + follow * (goals[:, 3:] - lowest).sum(axis=1)
    to_go = np.full(2 * n, np.inf, dtype=np.float32)
    most = limit + follow * float((start[3:] - lowest).sum())
    queue, none = _new_queue(world, rules, most, 2 * n), np.zeros(n, dtype=np.bool_)
    before, sources = relaxed.distance.reshape(-1), layer * n + pose
    cut = _spread(world, poses, rules, to_go, before, queue, sources, initial, most, none, 0, follow, True)
    table = np.full((2, HEADINGS, world.nx, world.ny), np.inf, dtype=np.float32)
    headings = (poses.first + np.arange(poses.slots)) % HEADINGS
    table[:, headings] = to_go.reshape(2, poses.slots, world.nx, world.ny)
    return table, bool(cut or relaxed.cut)


def _nodes(world: World, poses: Poses, states: np.ndarray):
    """Layer and pose of states [n, 7]."""
    slot = (states[:, 2] - poses.first) % HEADINGS
    return states[:, 3:].any(axis=1).astype(np.int64), (slot * world.nx + states[:, 0]) * world.ny + states[:, 1]


def _new_queue(world: World, rules: Rules, most: float, nodes: int) -> _Queue:
    # Buckets need not be narrower than the smallest edge: a node that gets cheaper while its bucket is worked on is
    # taken up again.
    width = max(0.5 * world.constants.turn * rules.turn_cost_factor, most / 4096)
    heads = np.full(int(most / width) + 2, -1, dtype=np.int32)
    return _Queue(width, heads, np.empty(nodes, dtype=np.int32), np.full(nodes, _OUT, dtype=np.int32))


@njit(allocates=False)
def _spread(world, poses, rules, cost, before, queue, sources, initial, most, wanted, left, follow, backward):
    """One Dijkstra over the relaxed problem from several nodes at once; whether ``most`` kept anything out.

    Args:
        world: terrain and robot.
        poses: edges; filled in on the way forward, read on the way back.
        rules: restrictions of the search; with ``drive_only``, the layer of neutral feet alone.
        cost: float32 [2 * poses], inf where unknown; the result.
        before: float32 [2 * poses]; on the way back, the costs of the way forward.
        queue: empty.
        sources: int64 [n], nodes, ``layer * poses + pose``.
        initial: float64 [n], cost at which each source starts.
        most: highest cost of interest; on the way back, together with the cost from the start.
        wanted: bool [poses], on neutral feet; cleared as they are settled.
        left: how many of these there are, after which to stop; 0 = go on to the end.
        follow: as in ``Relaxed``.
        backward: costs to the sources instead of from them.
    """
    t = world.tables
    nx, ny, first, slots, size = world.nx, world.ny, poses.first, poses.slots, len(poses.known)
    edge, known, stepping, some = poses.edge, poses.known, poses.stepping, poses.some
    move_dx, move_dy, shifts, zero = t.move_dx, t.move_dy, t.shifts, -t.lowest
    price, two_ways = world.constants.base_shift, world.constants.shift_backward
    factor, window, all_layers = np.float32(rules.turn_cost_factor), rules.heading_window, not rules.drive_only
    center = rules.heading_center
    drive = Rules(0, HEADINGS, 1.0, True)
    out_key, out_cost, out_action = poses.successors
    width, heads, after, ahead = queue.width, queue.heads, queue.after, queue.ahead
    cut, last = False, False
    nothing = np.float32(0)
    for s in range(len(sources)):
        node = sources[s]
        if not (backward and before[node] == np.inf):
            _offer(cost, heads, after, ahead, width, most, node, np.float32(initial[s]), nothing)
    for b in range(len(heads)):
        if last:
            break
        while heads[b] >= 0:
            here = np.int64(heads[b])
            _take(heads, after, ahead, here)
            so_far = cost[here]
            pose = here if here < size else here - size
            slot, x, y = pose // (nx * ny), pose // ny % nx, pose % ny
            heading = (first + slot) % HEADINGS
            if here < size:
                if not backward and not known[pose]:
                    edge[pose] = np.inf
                    key = pack(x, y, heading, zero, zero, zero, zero)
                    for k in range(pose_successors(world, drive, key, out_key, out_cost, out_action)):
                        edge[pose, out_action[k]] = out_cost[k]
                    stepping[pose] = can_step_from_neutral(world, x, y, heading)
                    known[pose] = True
                if left > 0 and wanted[pose]:
                    wanted[pose] = False
                    left -= 1
                    last = left == 0
                for m in range(20):
                    if backward:
                        u, v = x - move_dx[m], y - move_dy[m]
                        if not (0 <= u < nx and 0 <= v < ny):
                            continue
                        other = (slot * nx + u) * ny + v
                        # What the way forward did not come to expand is too far away.
                        if before[other] == np.inf or not known[other]:
                            continue
                        step, rest = edge[other, m], before[other]
                    else:  # an edge never leads off the map
                        other, step, rest = pose + move_dx[m] * ny + move_dy[m], edge[pose, m], nothing
                    if step < np.inf:
                        cut |= _offer(cost, heads, after, ahead, width, most, other, so_far + step, rest)
                for action, way in ((TURN_LEFT, 1), (TURN_RIGHT, -1)):
                    to = slot - way if backward else slot + way
                    if slots == HEADINGS:
                        to %= HEADINGS
                    off = (first + to - center + HEADINGS // 2) % HEADINGS - HEADINGS // 2
                    if not 0 <= to < slots or abs(off) > window:
                        continue
                    other = (to * nx + x) * ny + y
                    step, rest = edge[pose, action], nothing
                    if backward:
                        if before[other] == np.inf or not known[other]:
                            continue
                        step, rest = edge[other, action], before[other]
                    if step < np.inf:
                        cut |= _offer(cost, heads, after, ahead, width, most, other, so_far + factor * step, rest)
                if all_layers and (before[size + pose] < np.inf if backward else stepping[pose]):
                    rest = before[size + pose] if backward else nothing
                    cut |= _offer(cost, heads, after, ahead, width, most, size + pose, so_far, rest)
            else:
                for sign in (1, -1):
                    if sign == -1 and not two_ways:
                        continue
                    way = -sign if backward else sign
                    u, v = x + way * shifts[heading, 0], y + way * shifts[heading, 1]
                    if not (0 <= u < nx and 0 <= v < ny):
                        continue
                    other = (slot * nx + u) * ny + v
                    if backward and before[size + other] == np.inf:
                        continue
                    for q, qx, qy in ((pose, x, y), (other, u, v)):
                        if some[q] == 0:
                            some[q] = least_pose_cost(world, qx, qy, heading)
                    length = np.sqrt(np.float64(shifts[heading, 0] ** 2 + shifts[heading, 1] ** 2))
                    shift = price * length * 0.5 * (some[pose] + some[other]) + 4 * follow * shifts[heading, 2]
                    if shift < np.inf:
                        rest = before[size + other] if backward else nothing
                        new = np.float32(so_far + shift)
                        cut |= _offer(cost, heads, after, ahead, width, most, size + other, new, rest)
                if backward:
                    home = before[pose] < np.inf and known[pose] and stepping[pose]
                else:
                    home = cost[pose] > so_far and state_cost_is_finite(world, x, y, heading)
                if home:
                    rest = before[pose] if backward else nothing
                    cut |= _offer(cost, heads, after, ahead, width, most, pose, so_far, rest)
    return cut


@njit(inline="always")
def _offer(cost, heads, after, ahead, width, most, node, new, rest):
    """Have a node wait at cost ``new`` if that is less than before; whether ``most`` keeps it out."""
    if new >= cost[node]:
        return False
    if new + rest > most:
        return True
    if ahead[node] != _OUT:
        _take(heads, after, ahead, node)
    cost[node] = new
    b = int(new / width)
    second = heads[b]
    heads[b], after[node], ahead[node] = node, second, -1 - b
    if second >= 0:
        ahead[second] = node
    return False


@njit(inline="always")
def _take(heads, after, ahead, node):
    """Take a waiting node out of its bucket."""
    one, other = ahead[node], after[node]
    if one >= 0:
        after[one] = other
    else:
        heads[-1 - one] = other
    if other >= 0:
        ahead[other] = one
    ahead[node] = _OUT


@njit(allocates=False)
def state_cost_is_finite(world, x, y, heading):
    """Whether the robot can stand on neutral feet."""
    zero = -world.tables.lowest
    return state_cost(world, pack(x, y, heading, zero, zero, zero, zero)) < np.inf


@njit(allocates=False)
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


@njit(allocates=False)
def least_pose_cost(world, x, y, heading):
    """Least state cost at a pose over all feet; inf where no state is valid."""
    t = world.tables
    uneven, contacts, n_offsets, n_samples = world.uneven, t.contacts, t.n_offsets, t.n_samples
    p = cell_index(world, x, y)
    if not body_is_free(world, heading, p):
        return np.inf
    total = largest = np.float32(0)
    for i in range(4):
        row = foot_row(t, heading, i, 0)
        # The neutral offset first: on even ground nothing is better.
        best = uneven[p + contacts[row - t.lowest * n_samples]]
        if best > 0:
            for offset in range(n_offsets):
                best = min(best, uneven[p + contacts[row + offset * n_samples]])
        total += best
        largest = max(largest, best)
    return 1.0 + world.constants.unevenness * (np.float64(largest) + total)
