"""Lower bounds on costs-to-go over base poses, searched back from the goals as far as a search asks for them.

The relaxed problem has two layers (``hdsp.detailed.relaxed.relaxed_costs`` uses the same one for labels). On neutral
feet, the robot drives and turns exactly as in the detailed search. At a neutral pose where a foot can step, it enters
the layer of any feet. There, the base shifts along its heading between poses at which each foot finds some foothold, at
the least state cost over all feet, and it returns to neutral feet wherever they stand. If the base shifts only forward,
each cell of a shift also counts the least cost for four feet to follow (``follow`` per foot). A state costs at least
``cost(layer, pose) - follow * sum(offsets)``, with offsets counted from the lowest.

The search is reverse resumable A* (Silver, Cooperative pathfinding, AIIDE 2005). It runs from the goals toward the
start of the forward search, whose cost ``c`` to a pose on even ground (``free_space``) makes up the keys
``f = cost + c``. It settles poses in buckets of equal f, and stops as soon as the answer is known. The forward search
then resumes it.

A pose without an answer has f >= F, the first bucket that is not yet empty. Its cost is therefore at least F - c. This
bound rises with F, and it is final at the budget of memory. Final values are consistent: c is consistent in the forward
direction, so F - c falls by no more than the cost of an action, and no settled pose exceeds it.

Values are rounded down, so that single precision never makes a lower bound too large.
"""

from typing import NamedTuple

import numpy as np

from hdsp.base.bucket_links import OUT, link, unlink
from hdsp.base.jit import njit
from hdsp.base.records import by_reference
from hdsp.detailed.actions.action import ARCS, DRIVES, TURN_LEFT, TURN_RIGHT, arc_turn
from hdsp.detailed.actions.any_feet import can_step_from_neutral, least_pose_cost
from hdsp.detailed.actions.successors import arc_cost, neutral_rows
from hdsp.detailed.search.free_space import FreeSpace, free_cost, new_free_space, no_free_space
from hdsp.detailed.states import distinct_rows
from hdsp.detailed.world.body import FREE, look_at_body, on_slope
from hdsp.detailed.world.world import World, cell_index
from hdsp.robot.lattice import HEADINGS

#: Slots in ``Backward.counts``.
USED, BUCKET, WAITING, SETTLED, FULL, BEGUN = range(6)

_SIDE = 8  # cells along the side of a block
_NODES = HEADINGS * _SIDE * _SIDE  # poses in a block
_BUCKETS = 1 << 13
_ROUNDED_DOWN = 1 - 2.0**-23


@by_reference
class Backward(NamedTuple):
    """A backward search from goals, in arrays with fixed length; empty if ``place`` is.

    A node is one pose in one layer: ``block * 4096 + (heading * 8 + ix % 8) * 8 + iy % 8``.

    Attributes:
        place: int32 [2 * blocks along x * blocks along y], block of a layer and its cells, 0 without one.
        where: int32 [blocks], index in ``place``.
        cost: float32 [nodes], least known cost to a goal; inf if unknown.
        after, ahead: int32 [nodes], a waiting node's neighbours in its bucket, as in ``relaxed.bucket_queue``.
        heads: int32 [buckets], first node in a bucket, -1 = none; bucket b holds nodes of b modulo their number.
        counts: int64 [6], used blocks, first bucket that may hold nodes, waiting nodes, settled nodes, whether memory
            is exhausted, whether the search has begun.
        sources: int64 [n, 4], layer and pose of the goals.
        initial: float64 [n], cost at each source.
        guide: int64 [3], pose of the forward search's start.
        width: range of f per bucket.
        distance, turn: least cost per cell and per heading step, as in the geometric heuristic.
        follow: cost per cell for a foot to follow a base shift.
        free: costs from ``guide`` on even ground; empty for a robot without, for which ``distance`` and ``turn`` count.
    """

    place: np.ndarray
    where: np.ndarray
    cost: np.ndarray
    after: np.ndarray
    ahead: np.ndarray
    heads: np.ndarray
    counts: np.ndarray
    sources: np.ndarray
    initial: np.ndarray
    guide: np.ndarray
    width: float
    distance: float
    turn: float
    follow: float
    free: FreeSpace

    def within(self, memory: int) -> "Backward":
        """Returns the same search with a budget in bytes, unless its budget is smaller; work so far stays."""
        blocks = max(2, int(self.counts[USED]) if len(self.counts) else 2, int(memory // (12 * _NODES)))
        return self._replace(where=self.where[:blocks])

    def nbytes(self) -> int:
        """Bytes of all parts in use."""
        if len(self.place) == 0:
            return 0
        used = int(self.counts[USED]) * _NODES
        free = self.free.nbytes()
        return 12 * used + self.place.nbytes + self.where.nbytes + self.heads.nbytes + free


def no_backward() -> Backward:
    """The empty search, for heuristics without one."""
    return Backward(
        _NONE, _NONE, _NO_COST, _NONE, _NONE, _NONE, _NO_COUNT, _NO_SOURCE, _NO_INITIAL, _NO_COUNT,
        0.0, 0.0, 0.0, 0.0, no_free_space(),
    )  # fmt: skip


_NONE, _NO_COST, _NO_COUNT = np.empty(0, np.int32), np.empty(0, np.float32), np.empty(0, np.int64)
_NO_SOURCE, _NO_INITIAL = np.empty((0, 4), np.int64), np.empty(0)


def new_backward(world: World, goals: np.ndarray, distance: float, turn: float, follow: float, memory: int) -> Backward:
    """Returns a search that has not begun; its memory is taken as it grows.

    Args:
        world: terrain and robot.
        goals: int64 [n, 7], valid states.
        distance, turn, follow: as in ``Backward``.
        memory: budget in bytes.
    """
    places = 2 * -(-world.nx // _SIDE) * -(-world.ny // _SIDE)
    blocks = int(min(places + 1, max(2, memory // (12 * _NODES))))
    layer = (goals[:, 3:] != 0).any(axis=1).astype(np.int64)
    initial = follow * (goals[:, 3:] - world.tables.lowest).sum(axis=1)
    # Goals of one pose and layer differ in their feet alone: the cheapest counts.
    order = np.argsort(initial, kind="stable")
    sources = np.column_stack([layer, goals[:, :3]])[order]
    first = distinct_rows(sources)
    return Backward(
        place=np.zeros(places, np.int32),
        where=np.zeros(blocks, np.int32),
        cost=np.empty(blocks * _NODES, np.float32),
        after=np.empty(blocks * _NODES, np.int32),
        ahead=np.empty(blocks * _NODES, np.int32),
        heads=np.full(_BUCKETS, -1, np.int32),
        counts=np.array([1, 0, 0, 0, 0, 0], np.int64),
        sources=sources[first],
        initial=initial[order][first].astype(float),
        guide=np.zeros(3, np.int64),
        width=turn,
        distance=distance,
        turn=turn,
        follow=follow,
        free=new_free_space(world, follow),
    )


@njit(allocates=False)
def begin_toward(world, b, ix, iy, heading):
    """Begins the search at its goals, toward the pose of the forward search's start; a begun one stays as it is."""
    if b.counts[BEGUN]:
        return
    b.counts[BEGUN] = 1
    b.guide[0], b.guide[1], b.guide[2] = ix, iy, heading
    least = np.inf
    for k in range(len(b.initial)):
        least = min(least, b.initial[k] + _from_start(b, b.sources[k, 1], b.sources[k, 2], b.sources[k, 3]))
    b.counts[BUCKET] = np.int64(least / b.width)
    for k in range(len(b.initial)):
        _offer(world, b, b.sources[k, 0], b.sources[k, 1], b.sources[k, 2], b.sources[k, 3], _sum(b.initial[k], 0.0))


@njit(allocates=False)
def lower_bound(world, b, layer, ix, iy, heading):
    """Lower bound on the cost from a pose in a layer; inf if no goal is in reach."""
    cost = _known(world, b, layer, ix, iy, heading)
    if b.counts[WAITING] == 0 and not b.counts[FULL]:
        return cost
    bucket = b.counts[BUCKET]
    from_start = _from_start(b, ix, iy, heading)
    if cost < np.inf and np.int64((cost + from_start) / b.width) < bucket:
        return cost
    return max(bucket * b.width * _ROUNDED_DOWN - from_start, 0.0)


@njit(allocates=False)
def is_final(world, b, layer, ix, iy, heading):
    """Whether more search leaves the lower bound of a pose in a layer as it is."""
    if b.counts[FULL] or b.counts[WAITING] == 0:
        return True
    cost = _known(world, b, layer, ix, iy, heading)
    return cost < np.inf and np.int64((cost + _from_start(b, ix, iy, heading)) / b.width) < b.counts[BUCKET]


@njit(allocates=False)
def advance(world, b, layer, ix, iy, heading, wanted):
    """Continues until the lower bound of a pose in a layer is final or clearly larger, or for ``_NODES`` nodes.

    A bound below ``wanted`` rises to this value at least.
    """
    from_start = _from_start(b, ix, iy, heading)
    least = b.counts[BUCKET] * b.width - from_start
    f = from_start + max(least + 8 * b.width + abs(least) / 64, wanted + b.width)
    until = b.counts[SETTLED] + _NODES
    while (
        not is_final(world, b, layer, ix, iy, heading) and b.counts[BUCKET] * b.width < f and b.counts[SETTLED] < until
    ):
        _empty_bucket(world, b, until)


@njit(allocates=False, nogil=True)
def settle(world, b, layer, ix, iy, heading, nodes):
    """Continues until the lower bound of a pose in a layer is final, or until ``nodes`` nodes are settled."""
    begin_toward(world, b, ix, iy, heading)
    until = b.counts[SETTLED] + nodes
    while b.counts[SETTLED] < until and not is_final(world, b, layer, ix, iy, heading):
        _empty_bucket(world, b, until)


@njit(allocates=False, nogil=True)
def settle_any(world, b, nodes):
    """Continues a begun search until ``nodes`` nodes are settled, or until no more can be."""
    until = b.counts[SETTLED] + nodes
    while b.counts[SETTLED] < until and b.counts[WAITING] > 0 and not b.counts[FULL]:
        _empty_bucket(world, b, until)


@njit(allocates=False)
def _from_start(b, ix, iy, heading):
    """Least cost from the forward search's start to a pose on even ground."""
    if len(b.free.norm) > 0:
        return free_cost(b.free, b.turn, ix - b.guide[0], iy - b.guide[1], b.guide[2], heading)
    dx, dy = np.float64(ix - b.guide[0]), np.float64(iy - b.guide[1])
    turned = abs((heading - b.guide[2] + HEADINGS // 2) % HEADINGS - HEADINGS // 2)
    return b.distance * np.sqrt(dx * dx + dy * dy) + b.turn * turned


@njit(inline="always")
def _place(world, b, layer, ix, iy):
    across = (world.ny + _SIDE - 1) // _SIDE
    return layer * (len(b.place) // 2) + (ix // _SIDE) * across + iy // _SIDE


@njit(inline="always")
def _node(block, ix, iy, heading):
    return np.int64(block) * _NODES + (heading * _SIDE + ix % _SIDE) * _SIDE + iy % _SIDE


@njit(inline="always")
def _known(world, b, layer, ix, iy, heading):
    block = b.place[_place(world, b, layer, ix, iy)]
    return np.float64(b.cost[_node(block, ix, iy, heading)]) if block > 0 else np.inf


@njit(allocates=False)
def _new_block(b, place):
    """Takes a block for a place; returns its number, 0 without memory."""
    block = b.counts[USED]
    if block == len(b.where):
        b.counts[FULL] = 1
        return np.int64(0)
    b.counts[USED] += 1
    b.place[place], b.where[block] = block, place
    for node in range(block * _NODES, (block + 1) * _NODES):
        b.cost[node], b.ahead[node] = np.inf, OUT
    return block


@njit(inline="always")
def _sum(so_far, edge):
    """Cost with one more edge, float32, never more than the exact sum."""
    return np.float32((np.float64(so_far) + edge) * _ROUNDED_DOWN)


@njit(allocates=False)
def _offer(world, b, layer, ix, iy, heading, cost):
    """Queues a pose at a cost, float32, if this is cheaper."""
    place = _place(world, b, layer, ix, iy)
    block = np.int64(b.place[place])
    if block == 0:
        block = _new_block(b, place)
        if block == 0:
            return
    node = _node(block, ix, iy, heading)
    if cost >= b.cost[node]:
        return
    b.cost[node] = cost
    f = np.int64((np.float64(cost) + _from_start(b, ix, iy, heading)) / b.width)
    # A node beyond the last bucket waits in it: a node that comes too early comes again when it becomes cheaper.
    slot = min(max(f, b.counts[BUCKET]), b.counts[BUCKET] + _BUCKETS - 1) % _BUCKETS
    if b.ahead[node] != OUT:
        _take(b, node)
    link(b.heads, b.after, b.ahead, node, slot)
    b.counts[WAITING] += 1


@njit(inline="always")
def _take(b, node):
    unlink(b.heads, b.after, b.ahead, node)
    b.counts[WAITING] -= 1


@njit(allocates=False)
def _empty_bucket(world, b, until):
    """Settles the nodes in the first bucket, and moves on to the next one.

    Stops without memory, and when ``until`` nodes are settled in total: on even ground, all nodes on the cheapest ways
    lie in one bucket.
    """
    slot = b.counts[BUCKET] % _BUCKETS
    across = (world.ny + _SIDE - 1) // _SIDE
    heads = b.heads
    while heads[slot] >= 0:
        if b.counts[SETTLED] >= until:
            return
        node = np.int64(heads[slot])
        _take(b, node)
        b.counts[SETTLED] += 1
        place = np.int64(b.where[node // _NODES])
        layer = place // (len(b.place) // 2)
        corner = place % (len(b.place) // 2)
        ix = corner // across * _SIDE + node // _SIDE % _SIDE
        iy = corner % across * _SIDE + node % _SIDE
        heading = node % _NODES // (_SIDE * _SIDE)
        so_far = b.cost[node]
        if layer == 0:
            _drive_back(world, b, ix, iy, heading, so_far)
            if world.constants.on_the_spot:
                _turn_back(world, b, ix, iy, heading, so_far)
            else:
                _arcs_back(world, b, ix, iy, heading, so_far)
            _offer(world, b, 1, ix, iy, heading, so_far)
        else:
            _shift_back(world, b, ix, iy, heading, so_far)
            if _stands(world, heading, cell_index(world, ix, iy)) and can_step_from_neutral(world, ix, iy, heading):
                _offer(world, b, 0, ix, iy, heading, so_far)
        if b.counts[FULL]:
            return
    b.counts[BUCKET] += 1


@njit(allocates=False)
def _stands(world, heading, p):
    """Whether the robot can stand on neutral feet."""
    t, uneven = world.tables, world.uneven
    r0, r1, r2, r3 = neutral_rows(t, heading)
    s0, s1 = uneven[p + t.contacts[r0]], uneven[p + t.contacts[r1]]
    s2, s3 = uneven[p + t.contacts[r2]], uneven[p + t.contacts[r3]]
    if max(max(s0, s1), max(s2, s3)) == np.inf:
        return False
    body = world.base[heading * len(world.standable) + p]
    if body == 0:
        body = look_at_body(world, heading, p)
    return body == FREE


@njit(allocates=False)
def _is_level(world, heading, p):
    """Whether neutral feet are level, or on a slope."""
    feet, height = world.tables.feet, world.height
    r0, r1, r2, r3 = neutral_rows(world.tables, heading)
    h0, h1, h2, h3 = height[p + feet[r0]], height[p + feet[r1]], height[p + feet[r2]], height[p + feet[r3]]
    level = max(max(h0, h1), max(h2, h3)) - min(min(h0, h1), min(h2, h3)) <= world.constants.level
    return level or on_slope(world, heading, p)


@njit(inline="always")
def _drive_back(world, b, ix, iy, heading, so_far):
    t = world.tables
    uneven, contacts, k = world.uneven, t.contacts, world.constants.unevenness
    q = cell_index(world, ix, iy)
    r0, r1, r2, r3 = neutral_rows(t, heading)
    s0, s1 = uneven[q + contacts[r0]], uneven[q + contacts[r1]]
    s2, s3 = uneven[q + contacts[r2]], uneven[q + contacts[r3]]
    at_end = np.float64(max(max(s0, s1), max(s2, s3))) + s0 + s1 + s2 + s3
    first_body = heading * len(world.standable)
    for m in range(DRIVES):
        price = t.drive_price[0, heading, m]  # the lower one
        u, v = ix - t.move_dx[m], iy - t.move_dy[m]
        if price == np.inf or not (0 <= u < world.nx and 0 <= v < world.ny):
            continue
        share = k / (t.move_count[m] + 1)
        if _sum(so_far, price * (1.0 + share * at_end)) >= _known(world, b, 0, u, v, heading):
            continue
        p = q - t.move_flat[m]
        if not _stands(world, heading, p):
            continue
        total = at_end
        first = t.move_first[m]
        for s in range(first, first + t.move_count[m]):
            s0, s1 = uneven[p + contacts[r0 + s]], uneven[p + contacts[r1 + s]]
            s2, s3 = uneven[p + contacts[r2 + s]], uneven[p + contacts[r3 + s]]
            body = world.base[first_body + p + t.base_sample[s]]
            if body == 0:
                body = look_at_body(world, heading, p + t.base_sample[s])
            if body != FREE:
                total = np.inf
                break
            total += np.float64(max(max(s0, s1), max(s2, s3))) + s0 + s1 + s2 + s3
        if total == np.inf:
            continue
        if not _is_level(world, heading, p):
            price = t.drive_price[1, heading, m]
            if price == np.inf:
                continue
        _offer(world, b, 0, u, v, heading, _sum(so_far, price * (1.0 + share * total)))


@njit(inline="always")
def _turn_back(world, b, ix, iy, heading, so_far):
    c, p = world.constants, cell_index(world, ix, iy)
    there = _summed(world, p, heading)
    for action in (TURN_LEFT, TURN_RIGHT):
        old = (heading - (1 if action == TURN_LEFT else HEADINGS - 1)) % HEADINGS
        if _sum(so_far, c.turn) >= _known(world, b, 0, ix, iy, old):
            continue
        if not _stands(world, old, p) or not _is_level(world, old, p):
            continue
        here = _summed(world, p, old)
        _offer(world, b, 0, ix, iy, old, _sum(so_far, c.turn * (1.0 + c.turn_unevenness * 0.5 * (here + there))))


@njit(inline="always")
def _summed(world, p, heading):
    contacts, uneven = world.tables.contacts, world.uneven
    r0, r1, r2, r3 = neutral_rows(world.tables, heading)
    left = np.float64(uneven[p + contacts[r0]]) + uneven[p + contacts[r1]]
    return left + (np.float64(uneven[p + contacts[r2]]) + uneven[p + contacts[r3]])


@njit(allocates=False)
def _arcs_back(world, b, ix, iy, heading, so_far):
    for arc in range(ARCS):
        old = (heading - arc_turn(arc)) % HEADINGS
        u, v = ix - world.tables.arcs[old, arc, 0], iy - world.tables.arcs[old, arc, 1]
        if not (0 <= u < world.nx and 0 <= v < world.ny):
            continue
        p = cell_index(world, u, v)
        if not _stands(world, old, p) or not _is_level(world, old, p):
            continue
        edge = arc_cost(world, p, old, arc, _summed(world, p, old))
        if edge < np.inf:
            _offer(world, b, 0, u, v, old, _sum(so_far, edge))


@njit(allocates=False)
def _shift_back(world, b, ix, iy, heading, so_far):
    c, shifts = world.constants, world.tables.shifts
    there = -1.0
    for sign in (1, -1):
        if sign == -1 and not c.shift_backward:
            continue
        u, v = ix - sign * shifts[heading, 0], iy - sign * shifts[heading, 1]
        if not (0 <= u < world.nx and 0 <= v < world.ny):
            continue
        price = c.base_shift * np.sqrt(np.float64(shifts[heading, 0] ** 2 + shifts[heading, 1] ** 2))
        follow = 4 * b.follow * shifts[heading, 2]
        if _sum(so_far, price + follow) >= _known(world, b, 1, u, v, heading):
            continue
        here = least_pose_cost(world, u, v, heading)
        if here == np.inf:
            continue
        if there < 0:
            there = least_pose_cost(world, ix, iy, heading)
        _offer(world, b, 1, u, v, heading, _sum(so_far, price * 0.5 * (here + there) + follow))
