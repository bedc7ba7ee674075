"""Costs-to-go in the abstract graph, searched back from the goals as far as a search asks for them.

The search is reverse resumable A* (Silver, Cooperative pathfinding, AIIDE 2005). Its keys are ``f = cost + behind``,
with ``behind`` a lower bound on the cost from the states asked for, its targets. It settles states in buckets of equal
f. All states with f below the first bucket that is not yet empty have their final cost; all others have at least this
f. New targets give the waiting states other keys. Known costs stay.

Edges are evaluated only where the search needs them (lazy weighted A*, Cohen, Phillips & Likhachev, RSS 2014). A state
without edges is queued at the cost of the cheapest edge that its kind of action may have. Only a state that comes out
of the queue needs its edges; the search then stops and asks for them. Its costs do not depend on the order in which
edges become known: they are those with all edges.

An action that the abstraction judges infeasible keeps a price, as the abstraction may be wrong. States that a robot may
pass therefore have a way to the goal, wherever neighbouring states lead to it. The price is high where ways are chosen,
and lower in the cost of the chosen way.

Convention: states are flat indices ``(heading * nx + ix) * ny + iy``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hdsp.abstract.bridging import PASSED
from hdsp.base.jit import njit
from hdsp.robot.lattice import ABSTRACT_ACTIONS, ABSTRACT_HEADINGS

#: Slots in ``AskedDistances.counts``.
BUCKET, WAITING, ASKED, EMPTIED, AIMED = range(5)
#: Ends of a call of the search.
GOES_ON, NEEDS_EDGES, NO_MORE = range(3)

_BUCKETS = 1 << 13
_FAR = _BUCKETS - 1  # a state in a later bucket waits in this one, and comes again
_WIDTHS = 4  # buckets within the cheapest edge; fewer repeat visits, more take longer
_OUT = np.int32(-(2**31))
_ASKED = np.int32(1 - 2**31)
_ROUNDING = 1e-9
_STEPS = 3  # of the way ahead beside which states are targets


class Edges(NamedTuple):
    """Edges of a map, as far as they are known.

    Attributes:
        costs: float32 [states, 22], costs of actions by their start, inf = judged infeasible; undefined where unknown.
        evaluated: bool [states], states whose edges are known.
        standing: bool [states], states that a robot may pass.
        least: float64 [16, 22], no edge is cheaper, by the heading of its start.
        doubtful: float64 [16, 22], prices of actions judged infeasible, at least ``least``. They choose the ways.
        spared: float64 [16, 22], part of ``doubtful`` that does not count in the cost-to-go of the chosen way.
        nx, ny: size in abstract cells.
    """

    costs: np.ndarray
    evaluated: np.ndarray
    standing: np.ndarray
    least: np.ndarray
    doubtful: np.ndarray
    spared: np.ndarray
    nx: int
    ny: int


class AskedDistances(NamedTuple):
    """A backward search from goals, in arrays with fixed length.

    Attributes:
        edges: the edges; shared between searches.
        behind: float64 [states], lower bound on the cost from the targets, up to a constant, consistent with
            ``edges.least``.
        to_goal: float64 [states], lower bound on the cost to a goal, known without any edge.
        straight: float64 [states], cost from a state straight to a goal, inf for most states.
        cost: float64 [states], least known cost to a goal.
        spared: float64 [states], part of ``cost`` that does not count; where ways cost the same, the most.
        exact: bool [states], whether ``cost`` is the cost of a known way, and not a lower bound.
        values: float32 [states], final costs less ``spared`` and ``excess``, at least 0; inf where unknown or without a
            way.
        known: bool [states], whether ``values`` is final.
        after, ahead: int32 [states], a waiting state's neighbours in its bucket; ``ahead`` of a bucket's first state is
            -1 - slot, others stand for states in no bucket and states in ``asked``.
        heads: int32 [buckets], first state in a bucket, -1 = none; slot n holds buckets of n modulo their number.
        asked: int32 [states], states that wait for their edges.
        emptied: int32 [states], states that came out of the present bucket, some twice.
        counts: int64 [5], first bucket that may hold states, waiting states, entries in ``asked`` and ``emptied``, and
            whether the search has targets.
        front: float64 [1], every state with a smaller f is known; inf when no state waits.
        width: range of f per bucket.
        excess: costs exceed the costs-to-go by this much.
    """

    edges: Edges
    behind: np.ndarray
    to_goal: np.ndarray
    straight: np.ndarray
    cost: np.ndarray
    spared: np.ndarray
    exact: np.ndarray
    values: np.ndarray
    known: np.ndarray
    after: np.ndarray
    ahead: np.ndarray
    heads: np.ndarray
    asked: np.ndarray
    emptied: np.ndarray
    counts: np.ndarray
    front: np.ndarray
    width: float
    excess: float


def distances_from(
    edges: Edges, goals: np.ndarray, costs: np.ndarray, excess: float, to_goal: np.ndarray
) -> AskedDistances:
    """Returns a search that has not begun.

    Args:
        edges: the edges.
        goals: int64 [n], states.
        costs: float64 [n], cost from each straight to a goal.
        excess: as in ``AskedDistances``.
        to_goal: float64 [states], lower bounds on the cost to a goal, from ``least_costs_to``.
    """
    count = len(edges.standing)
    goals = np.asarray(goals, np.int64)
    straight = np.full(count, np.inf)
    np.minimum.at(straight, goals, costs)
    cost, exact = straight.copy(), np.zeros(count, np.bool_)
    exact[goals] = True
    found = AskedDistances(
        edges=edges,
        behind=np.zeros(count),
        to_goal=to_goal,
        straight=straight,
        cost=cost,
        spared=np.zeros(count),
        exact=exact,
        values=np.full(count, np.inf, np.float32),
        known=np.zeros(count, np.bool_),
        after=np.empty(count, np.int32),
        ahead=np.full(count, _OUT, np.int32),
        heads=np.full(_BUCKETS, -1, np.int32),
        asked=np.empty(count, np.int32),
        emptied=np.empty(count, np.int32),
        counts=np.zeros(5, np.int64),
        front=np.zeros(1),
        width=_width(edges),
        excess=excess,
    )
    _queue_again(found)
    return found


def least_costs_to(edges: Edges, goals: np.ndarray, costs: np.ndarray) -> np.ndarray:
    """Returns lower bounds on costs to goals, float64 [states], from ``Edges.least``; inf without a way.

    Args:
        edges: the edges; none has to be evaluated.
        goals: int64 [n], states.
        costs: float64 [n], cost at each of them.
    """
    return _least_costs(edges, goals, costs, True, np.empty(0), np.inf)


def _least_costs(
    edges: Edges, sources: np.ndarray, costs: np.ndarray, backward: bool, to_goal: np.ndarray, most: float
) -> np.ndarray:
    """Lower bounds on costs to (``backward``) or from sources, as far as with ``to_goal`` they are at most ``most``."""
    count = len(edges.standing)
    cost = np.full(count, np.inf)
    np.minimum.at(cost, sources, costs)
    after, ahead = np.empty(count, np.int32), np.full(count, _OUT, np.int32)
    counts, heads = np.zeros(4, np.int64), np.full(_BUCKETS, -1, np.int32)
    sources = np.asarray(sources, np.int64)
    _spread(edges, cost, sources, after, ahead, heads, counts, _width(edges), backward, to_goal, most)
    return cost


def _width(edges: Edges) -> float:
    cheapest, dearest = edges.least.min(), edges.doubtful[np.isfinite(edges.doubtful)].max(initial=0.0)
    # Zero would be no width; narrow buckets beside dear edges would be many.
    return float(max(cheapest / _WIDTHS, dearest / 64, 1e-6)) if np.isfinite(cheapest) else 1.0


@njit(inline="always")
def _queue(after, ahead, heads, counts, node, bucket):
    slot = min(max(bucket, counts[BUCKET]), counts[BUCKET] + _FAR) % _BUCKETS
    if ahead[node] != _OUT:
        _take(after, ahead, heads, counts, node)
    second = heads[slot]
    heads[slot], after[node], ahead[node] = node, second, -1 - slot
    if second >= 0:
        ahead[second] = node
    counts[WAITING] += 1


@njit(inline="always")
def _take(after, ahead, heads, counts, node):
    one, other = ahead[node], after[node]
    if one >= 0:
        after[one] = other
    else:
        heads[-1 - one] = other
    if other >= 0:
        ahead[other] = one
    ahead[node] = _OUT
    counts[WAITING] -= 1


@njit(allocates=False)
def _spread(edges, cost, sources, after, ahead, heads, counts, width, backward, to_goal, most):
    """Dijkstra search with the least edges; fills ``cost`` in place."""
    nx, ny, standing, least = edges.nx, edges.ny, edges.standing, edges.least
    for i in range(len(sources)):
        _queue(after, ahead, heads, counts, sources[i], np.int64(cost[sources[i]] / width))
    sign = -1 if backward else 1
    while counts[WAITING] > 0:
        slot = counts[BUCKET] % _BUCKETS
        while heads[slot] >= 0:
            node = np.int64(heads[slot])
            _take(after, ahead, heads, counts, node)
            k, a, b = node // (nx * ny), node // ny % nx, node % ny
            so_far = cost[node]
            if not backward and not standing[node]:
                continue
            for m in range(len(ABSTRACT_ACTIONS)):
                x, y = a + sign * ABSTRACT_ACTIONS[m, 0], b + sign * ABSTRACT_ACTIONS[m, 1]
                if not (0 <= x < nx and 0 <= y < ny):
                    continue
                z = (k + sign * ABSTRACT_ACTIONS[m, 2]) % ABSTRACT_HEADINGS
                other = (z * nx + x) * ny + y
                further = so_far + least[z if backward else k, m]
                if further < cost[other] and (standing[other] or not backward):
                    if most < np.inf and further + to_goal[other] > most:
                        continue
                    cost[other] = further
                    _queue(after, ahead, heads, counts, other, np.int64(further / width))
        counts[BUCKET] += 1


@njit(inline="always")
def _offer(s, node):
    _queue(s.after, s.ahead, s.heads, s.counts, node, np.int64((s.cost[node] + s.behind[node]) / s.width))


@njit(inline="always")
def _ask(s, node):
    if s.ahead[node] == _ASKED:
        return
    if s.ahead[node] != _OUT:
        _take(s.after, s.ahead, s.heads, s.counts, node)
    s.ahead[node] = _ASKED
    s.asked[s.counts[ASKED]] = node
    s.counts[ASKED] += 1


@njit(allocates=False)
def enter_edges(s):
    """Takes over the edges for which the search asked."""
    edges = s.edges
    nx, ny = edges.nx, edges.ny
    left = 0
    for i in range(s.counts[ASKED]):
        node = np.int64(s.asked[i])
        if not edges.evaluated[node]:  # another query asked for it in the meantime
            s.asked[left] = node
            left += 1
            continue
        k, a, b = node // (nx * ny), node // ny % nx, node % ny
        least, spared = s.straight[node], 0.0
        for m in range(len(ABSTRACT_ACTIONS)):
            x, y = a + ABSTRACT_ACTIONS[m, 0], b + ABSTRACT_ACTIONS[m, 1]
            if not (0 <= x < nx and 0 <= y < ny):
                continue
            end = ((k + ABSTRACT_ACTIONS[m, 2]) % ABSTRACT_HEADINGS * nx + x) * ny + y
            if s.exact[end]:
                further, more = s.cost[end] + _edge(edges, node, k, m), s.spared[end] + _spared(edges, node, k, m)
                if further < least or (further == least and more > spared):
                    least, spared = further, more
        s.cost[node], s.spared[node], s.exact[node], s.ahead[node] = least, spared, True, _OUT
        if least < np.inf:
            _offer(s, node)
    s.counts[ASKED] = left


@njit(inline="always")
def _edge(edges, start, heading, action):
    """Cost of an action from an evaluated state, with its price where it is judged infeasible."""
    cost = np.float64(edges.costs[start, action])
    return cost if cost < np.inf else edges.doubtful[heading, action]


@njit(inline="always")
def _spared(edges, start, heading, action):
    """Part of ``_edge`` that does not count in the cost-to-go."""
    return 0.0 if edges.costs[start, action] < np.inf else edges.spared[heading, action]


@njit(allocates=False)
def advance(s):
    """Empties one bucket.

    Returns:
        ``GOES_ON``; ``NEEDS_EDGES`` for the states in ``asked``, then ``enter_edges`` is due; ``NO_MORE`` when all
        costs are known.
    """
    edges, cost, exact = s.edges, s.cost, s.exact
    nx, ny, standing, evaluated = edges.nx, edges.ny, edges.standing, edges.evaluated
    if s.counts[WAITING] == 0 and s.counts[EMPTIED] == 0:
        s.front[0] = np.inf
        for node in range(len(s.known)):
            s.known[node] = s.known[node] or s.to_goal[node] < np.inf
        return NO_MORE
    slot = s.counts[BUCKET] % _BUCKETS
    heads = s.heads
    while heads[slot] >= 0:
        node = np.int64(heads[slot])
        _take(s.after, s.ahead, heads, s.counts, node)
        if not exact[node]:
            _ask(s, node)
            continue
        if s.counts[EMPTIED] == len(s.emptied):
            _keep(s)
        s.emptied[s.counts[EMPTIED]] = node
        s.counts[EMPTIED] += 1
        k, a, b = node // (nx * ny), node // ny % nx, node % ny
        so_far = cost[node]
        for m in range(len(ABSTRACT_ACTIONS)):
            x, y = a - ABSTRACT_ACTIONS[m, 0], b - ABSTRACT_ACTIONS[m, 1]
            if not (0 <= x < nx and 0 <= y < ny):
                continue
            z = (k - ABSTRACT_ACTIONS[m, 2]) % ABSTRACT_HEADINGS
            start = (z * nx + x) * ny + y
            if not standing[start] or s.known[start] or so_far + edges.least[z, m] > cost[start]:
                continue
            further, spared = so_far + edges.least[z, m], 0.0
            if evaluated[start]:
                further, spared = so_far + _edge(edges, start, z, m), s.spared[node] + _spared(edges, start, z, m)
            equal = further == cost[start] and further < np.inf and exact[start] and spared > s.spared[start]
            if further < cost[start] or equal:
                cost[start], s.spared[start], exact[start] = further, spared, evaluated[start]
                if s.ahead[start] != _ASKED:
                    _offer(s, start)
    if s.counts[ASKED] > 0:
        return NEEDS_EDGES
    _settle(s)
    return GOES_ON


@njit(allocates=False)
def _keep(s):
    """Drops states that are twice in ``emptied``."""
    kept = 0
    for i in range(s.counts[EMPTIED]):
        node = s.emptied[i]
        if not s.known[node]:
            s.known[node] = True
            s.emptied[kept] = node
            kept += 1
    for i in range(kept):
        s.known[s.emptied[i]] = False
    s.counts[EMPTIED] = kept


@njit(allocates=False)
def _settle(s):
    """Moves on to the next bucket: states that came out of this one are known."""
    emptied = s.counts[EMPTIED]
    s.counts[EMPTIED] = 0
    s.counts[BUCKET] += 1
    end = s.counts[BUCKET] * s.width * (1 - _ROUNDING)
    for i in range(emptied):
        node = np.int64(s.emptied[i])
        if s.known[node] or s.ahead[node] != _OUT:
            continue
        if s.cost[node] + s.behind[node] >= end:
            _offer(s, node)  # rounding of a sum may still improve it
            continue
        s.known[node] = True
        s.values[node] = np.float32(max(s.cost[node] - s.spared[node] - s.excess, 0.0))
    s.front[0] = end


def aim_at(s: AskedDistances, places: np.ndarray, near: np.ndarray, slack: float) -> float:
    """Gives a search new targets, for which no edges may be asked at the moment.

    A target near the goal waits for the others: the search then reaches all of them at about the same f, and needs few
    states beside the ways to each of them.

    Args:
        s: the search.
        places: int64 [n], states that are asked for.
        near: int64 [n], states near to them. From the best known one, a search follows its way to the goal, and will
            ask for states beside it: they are targets, too.
        slack: expected largest excess of costs over expected ones, relative.

    Returns:
        f beyond which other targets, with more slack, lead the search better.
    """
    expected = np.full(len(s.cost), np.inf)
    _expect_along(s, places, near, expected)
    targets = np.flatnonzero(np.isfinite(expected))
    if len(targets) == 0:
        return np.inf
    dearest = float(expected[targets].max())
    most = dearest * (1 + slack)
    behind = _least_costs(s.edges, targets, dearest - expected[targets], False, s.to_goal, most)
    # Both are consistent, and so is the lower one. States without a way to the goal have no bound.
    s.behind[:] = np.where(np.isinf(s.to_goal), np.inf, np.minimum(behind, np.maximum(most - s.to_goal, 0.0)))
    s.counts[AIMED] = 1
    _queue_again(s)
    return most


@njit(allocates=False)
def _expect_along(s, places, near, expected):
    """Enters the expected costs-to-go of targets."""
    edges = s.edges
    nx, ny = edges.nx, edges.ny
    node, least = np.int64(-1), np.inf
    for i in range(len(near)):
        if s.known[near[i]] and s.cost[near[i]] < least:
            node, least = near[i], s.cost[near[i]]
    more = s.cost[node] - s.to_goal[node] if node >= 0 else 0.0
    for i in range(len(places)):
        if s.to_goal[places[i]] < np.inf and not s.known[places[i]]:
            expected[places[i]] = max(s.to_goal[places[i]] + more, 0.0)
    for _ in range(_STEPS):
        if node < 0 or not edges.evaluated[node]:
            return
        k, a, b = node // (nx * ny), node // ny % nx, node % ny
        more = s.cost[node] - s.to_goal[node]
        for z in range(k - 1, k + 2):
            for x in range(max(a - 1, 0), min(a + 2, nx)):
                for y in range(max(b - 1, 0), min(b + 2, ny)):
                    beside = (z % ABSTRACT_HEADINGS * nx + x) * ny + y
                    if s.to_goal[beside] < np.inf and not s.known[beside]:
                        expected[beside] = min(expected[beside], max(s.to_goal[beside] + more, 0.0))
        best, after = s.straight[node], np.int64(-1)
        for m in range(len(ABSTRACT_ACTIONS)):
            x, y = a + ABSTRACT_ACTIONS[m, 0], b + ABSTRACT_ACTIONS[m, 1]
            if 0 <= x < nx and 0 <= y < ny:
                end = ((k + ABSTRACT_ACTIONS[m, 2]) % ABSTRACT_HEADINGS * nx + x) * ny + y
                if s.known[end] and s.cost[end] < s.cost[node] and s.cost[end] + _edge(edges, node, k, m) < best:
                    best, after = s.cost[end] + _edge(edges, node, k, m), end
        node = after


@njit(allocates=False)
def _queue_again(s):
    """Orders the queue by other lower bounds."""
    s.heads[:], s.ahead[:] = -1, _OUT
    s.counts[WAITING] = s.counts[EMPTIED] = 0
    first = np.inf
    for node in range(len(s.cost)):
        if not s.known[node]:
            first = min(first, s.cost[node] + s.behind[node])
    if first == np.inf:
        return  # no state waits
    s.counts[BUCKET] = np.int64(first / s.width)
    s.front[0] = s.counts[BUCKET] * s.width
    for node in range(len(s.cost)):
        if not s.known[node] and s.cost[node] < np.inf:
            _offer(s, node)


@njit(allocates=False)
def decide_all(s, places):
    """Tries to decide the costs-to-go of states without a way of their own (see `_decide`), until some need edges."""
    for i in range(len(places)):
        if s.to_goal[places[i]] == np.inf and not s.known[places[i]]:
            _decide(s, places[i])
            if s.counts[ASKED] > 0:
                return


@njit(allocates=False)
def _decide(s, node):
    """Tries to decide the cost-to-go of a state between the ends of an action (see `PreparedGraph.bridged`).

    During a step, the robot can be at a position without an abstract state. Its cost-to-go is half the cost of the best
    feasible action over it plus the cost-to-go at the action's end. States whose edges matter are asked for.
    """
    best, open_ = np.inf, np.inf  # least cost of a known way, and least lower bound of others
    spared = 0.0
    for n in range(len(PASSED)):
        way, is_known, _, more = _way_over(s, node, n)
        if is_known and (way < best or (way == best and more > spared)):
            best, spared = way, more
        elif is_known:
            continue
        else:
            open_ = min(open_, way)
    if open_ == np.inf or best < open_:
        s.known[node] = True
        s.values[node] = np.float32(max(best - spared - s.excess, 0.0))
        return
    for n in range(len(PASSED)):
        way, is_known, start, _ = _way_over(s, node, n)
        if not is_known and way < best and start >= 0:
            _ask(s, start)


@njit(inline="always")
def _way_over(s, node, n):
    """Lower bound on the cost over a state by action ``n`` of those that pass it, whether it is the cost, the state
    whose edges it lacks, -1 for none, and the part of the cost that does not count."""
    edges = s.edges
    nx, ny = edges.nx, edges.ny
    k, a, b = node // (nx * ny), node // ny % nx, node % ny
    m = PASSED[n, 0]
    x, y = a + PASSED[n, 1], b + PASSED[n, 2]
    u, v = x - ABSTRACT_ACTIONS[m, 0], y - ABSTRACT_ACTIONS[m, 1]
    if not (0 <= x < nx and 0 <= y < ny and 0 <= u < nx and 0 <= v < ny):
        return np.inf, True, np.int64(-1), 0.0
    end, start = (k * nx + x) * ny + y, (k * nx + u) * ny + v
    if not edges.standing[start] or s.to_goal[end] == np.inf:
        return np.inf, True, np.int64(-1), 0.0
    at_end = s.cost[end] if s.known[end] else max(s.front[0] - s.behind[end], 0.0)
    if not edges.evaluated[start]:
        return at_end + 0.5 * edges.least[k, m], False, (start if s.known[end] else np.int64(-1)), 0.0
    edge = np.float64(edges.costs[start, m])
    return at_end + 0.5 * edge, s.known[end] or edge == np.inf, np.int64(-1), s.spared[end]
