"""Multi-heuristic A*: guided by heuristics that may be wrong, with a proved bound on the cost.

Source: shared MHA* (SMHA*), Aine, Swaminathan, Narayanan, Hwang & Likhachev, IJRR 2016. One store of states and their
costs g, one open list per heuristic: the *anchor*, which is consistent (so it never exceeds the cost to go), and one or
more *guides*, which may say anything. Keys are ``g + W1 h``. The guides take turns; a guide may expand the first state
of its list only if its key is at most W2 times the anchor's least key; else the anchor expands its own first state. As
the anchor's least key never exceeds W1 times the least cost, a plan that costs at most W2 times that key is within
W1 W2 of optimal. Every state is expanded twice at most: once for all guides together, and once for the anchor. Only
with a limit on the cost does the anchor expand a state again when a cheaper way to it is found: else the limit could
keep out what was reached by a dear way first, and "no plan costs less" would be no proof.

Three departures from the paper, none of which touches its proofs. A guide's list also takes states whose key is too
large by now, because the anchor's least key rises. The search also ends where a guide is held back and the anchor's
key proves the bound already. And lists are never searched for outdated entries; these are dropped when they come first.

What the search proves may be better than W1 W2, see ``search.least_f``.
"""

import time
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.jit import njit
from hdsp.detailed.actions.state_costs import state_cost
from hdsp.detailed.actions.successors import MAX_SUCCESSORS, Rules, other_successors, pose_successors
from hdsp.detailed.search import kernel as search
from hdsp.detailed.search import open_list
from hdsp.detailed.search.anytime import rounding, suboptimality
from hdsp.detailed.search.estimate import Estimate, estimate
from hdsp.detailed.search.open_list import pop, push, refill
from hdsp.detailed.search.solve import Limits, Search, SearchResult, Status
from hdsp.detailed.search.store import (
    CLOSED,
    CUT,
    EXPANDED,
    FAR,
    NEAR,
    SEEN,
    Store,
    find,
    grown,
    growth_nbytes,
    has_room,
    key_of,
    node_of,
)
from hdsp.detailed.states import FEET_MASK, START, pack_states
from hdsp.detailed.world.world import World

#: Further bits of ``Store.flags``: expanded once for the anchor; once for the guides.
ANCHORED, GUIDED = 8, 16

_SLICE = 20_000  # expansions between two looks at the clock
_ROOM = 1 << 11  # entries of an open list at first
_ENDS = {
    search.SOLVED: Status.SOLVED,
    search.EXHAUSTED: Status.INFEASIBLE,
    search.OVER_COST_LIMIT: Status.COST_LIMIT,
}


class Queue(NamedTuple):
    """The open list of a guide, with the fields that ``open_list`` reads of a ``Store``."""

    open_f: np.ndarray  # float32 [room]
    open_node: np.ndarray  # int32 [room]
    open_least: np.ndarray  # float32 [4]
    count: np.ndarray  # int64 [8]; NEAR and FAR, and EXPANDED: how many states this guide expanded
    flags: np.ndarray  # those of the store

    def nbytes(self) -> int:
        """Bytes of the arrays that are the queue's own."""
        return self.open_f.nbytes + self.open_node.nbytes + self.open_least.nbytes + self.count.nbytes


@dataclass
class MultiResult(SearchResult):
    """Outcome of a multi-heuristic search for one goal.

    Attributes:
        bound: proved: the plan costs at most so many times the least possible; inf without a plan.
        lower_bound: proved: no plan costs less.
        expansions_by: of ``expansions``, those of the anchor, then those of each guide.
    """

    bound: float = np.inf
    lower_bound: float = 0.0
    expansions_by: list[int] = field(default_factory=list)


def solve_multi(
    world: World,
    start: np.ndarray,
    goal: np.ndarray,
    anchor: Estimate,
    guides: list[Estimate],
    *,
    weight: float = 1.0,
    anchor_weight: float = 1.0,
    rules: Rules | None = None,
    limits: Limits | None = None,
    progress=None,
) -> MultiResult:
    """Shared multi-heuristic A* from one detailed state to another.

    Args:
        world: terrain and robot.
        start, goal: int64 [7], lattice units (ix, iy, heading, 4 foot offsets).
        anchor: consistent heuristic, 0 at the goal; all that is proved follows from it.
        guides: heuristics that may overestimate; states for which one is inf are left to the others.
        weight: W1 >= 1, by which all heuristics are multiplied.
        anchor_weight: W2 >= 1, by how much guides may be ahead of the anchor.
        rules, limits, progress: as in ``solve``.

    Returns:
        A result with one status. If solved, its cost is at most ``bound <= W1 W2`` times optimal.

    Raises:
        InputError: without guides, or for a weight that is no finite number >= 1.
    """
    for name, value in (("weight", weight), ("anchor_weight", anchor_weight)):
        if not (np.isfinite(value) and value >= 1):
            raise InputError(f"{name} is {value}; it must be a finite number >= 1")
    if not guides:
        raise InputError("a multi-heuristic search needs one guide at least")
    began = time.perf_counter()
    start_key, goal_key = (int(pack_states(state, world.tables.lowest)[0]) for state in (start, goal))
    for status, key in ((Status.INVALID_START, start_key), (Status.INVALID_GOAL, goal_key)):
        if not np.isfinite(state_cost(world, key)):
            return MultiResult([status], np.full(1, np.inf), [None], [None], [None])
    rules, limits = rules or Rules(), limits or Limits()
    task = _MultiSearch(world, start_key, goal_key, rules, limits, progress, began)
    status = None if task.begin_multi(anchor, tuple(guides), weight, anchor_weight) else Status.MEMORY_LIMIT
    while status is None:
        status = task.advance()
    result = MultiResult([status], np.full(1, np.inf), [None], [None], [None])
    if status == Status.SOLVED:
        path = task.path(goal_key)
        result.states, result.actions, result.edge_costs = ([part] for part in path)
        result.cost[0] = path[2].sum()
    task.count(result)
    result.lower_bound = task.lower_bound(status)
    if status == Status.SOLVED:
        proved = suboptimality(float(result.cost[0]), result.lower_bound, rounding(world))
        result.bound = min(float(weight * anchor_weight), proved)
    result.seconds = time.perf_counter() - began
    return result


class _MultiSearch(Search):
    """A search under way: the store, whose own open list is the anchor's, and the queues of the guides."""

    def __init__(self, world: World, start: int, goal: int, rules: Rules, limits: Limits, progress, began):
        super().__init__(world, start, np.array([goal]), rules, limits, progress, began)
        self._goal_node = int(find(self.store, goal))
        self.queues: tuple[Any, ...] = ()  # of ``Queue``, which ``open_list`` takes for a store

    def begin_multi(self, anchor: Estimate, guides: tuple[Estimate, ...], weight: float, anchor_weight: float) -> bool:
        """Put the start in all open lists; False if even the empty ones exceed the limit on memory."""
        self._anchor, self._guides = anchor, guides
        self._weight, self._anchor_weight = float(weight), float(anchor_weight)
        self._once = ANCHORED if np.isinf(self.limits.cost) else 0
        self.queues = tuple(_new_queue(self.store) for _ in guides)
        insert_start(self.store, self.queues, anchor, guides, self._weight, self.start, self._once)
        return self.nbytes() <= self.limits.memory

    def advance(self) -> Status | None:
        """Search on for a while; returns how the search ended, None if it did not."""
        left = self.limits.expansions - int(self.store.count[EXPANDED])
        if left <= 0:
            return Status.EXPANSION_LIMIT
        code = run(
            self.world, self.rules, self._anchor, self._guides, self.store, self.queues, self._weight,
            self._anchor_weight, self._goal_node, self.limits.cost, min(left, _SLICE), self._once,
        )  # fmt: skip
        if code in _ENDS:
            return _ENDS[code]
        if code == search.FULL and not self._make_room():
            return Status.MEMORY_LIMIT
        elapsed = time.perf_counter() - self.began
        if self.progress is not None:
            self.progress(int(self.store.count[EXPANDED]), elapsed)
        return Status.TIME_LIMIT if elapsed > self.limits.time else None

    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return self.store.nbytes() + sum(queue.nbytes() for queue in self.queues)

    def _make_room(self) -> bool:
        """Make room for the successors of one more state; False if what grows and its larger copy, side by side, would
        exceed the limit."""
        if self.nbytes() + growth_nbytes(self.store) > self.limits.memory:
            return False
        self.store = grown(self.store)
        self.queues = tuple(queue._replace(flags=self.store.flags) for queue in self.queues)
        if self.nbytes() + open_list.growth_nbytes(self.store, MAX_SUCCESSORS) > self.limits.memory:
            return False
        self.store = open_list.with_room(self.store, MAX_SUCCESSORS)
        for i in range(len(self.queues)):
            if self.nbytes() + open_list.growth_nbytes(self.queues[i], MAX_SUCCESSORS) > self.limits.memory:
                return False
            grew = open_list.with_room(self.queues[i], MAX_SUCCESSORS)
            self.queues = (*self.queues[:i], grew, *self.queues[i + 1 :])
        return True

    def lower_bound(self, status: Status) -> float:
        """Cost below which there is no plan, after a search that ended like this."""
        if status == Status.INFEASIBLE:
            return np.inf
        if status == Status.COST_LIMIT:
            return float(self.limits.cost)
        least = search.least_f(self.store, self._anchor)
        key = float(first_key(self.store, self._once)) / self._weight
        # Keys are rounded to single precision, what is compared with the plan's cost is not.
        least = max(least, key * (1 - 2.0**-23))
        if self.store.count[CUT]:
            least = min(least, self.limits.cost)
        return least * max(0.0, 1 - rounding(self.world) * least) if np.isfinite(least) else least

    def count(self, result: MultiResult) -> None:
        """Enter what was spent so far."""
        super().count(result)
        guided = [int(queue.count[EXPANDED]) for queue in self.queues]
        result.expansions_by = [result.expansions - sum(guided), *guided]
        result.memory = self.nbytes()
        result.open_memory += sum(queue.nbytes() for queue in self.queues)


def _new_queue(store: Store) -> Queue:
    return Queue(
        open_f=np.empty(_ROOM, np.float32),
        open_node=np.empty(_ROOM, np.int32),
        open_least=np.full(4, -np.inf, np.float32),
        count=np.zeros(8, np.int64),
        flags=store.flags,
    )


@njit(allocates=False)
def insert_start(store, queues, anchor, guides, weight, start, once):
    """Begin a search at a packed state."""
    node = node_of(store, start)
    store.g[node] = 0
    store.action[node] = START
    store.count[SEEN] = 1
    _push_all(store, queues, anchor, guides, weight, start, node, once)


@njit(allocates=False)
def first_key(queue, outdated):
    """Least key in an open list, inf if it is empty; ``outdated``: bits of states that have no business there."""
    flags, f_of, nodes, count = queue.flags, queue.open_f, queue.open_node, queue.count
    while True:
        while count[NEAR] > 0 and flags[nodes[0]] & (CLOSED | outdated):
            pop(queue)
        if count[NEAR] > 0:
            return f_of[0]
        if count[FAR] == 0:
            return np.float32(np.inf)
        refill(queue)


@njit(inline="always")
def _push_all(store, queues, anchor, guides, weight, key, node, once):
    """Put a state whose cost fell into the lists of all that may still expand it."""
    flags = store.flags[node]
    if flags & once:
        return
    g = np.float64(store.g[node])
    h = estimate(anchor, key)
    if h == np.inf:
        return
    push(store, np.float32(g + weight * h), node)
    if flags & (ANCHORED | GUIDED):
        return
    for i in range(len(queues)):
        h = estimate(guides[i], key)
        if h < np.inf:
            push(queues[i], np.float32(g + weight * h), node)


@njit(inline="always")
def _has_room(store, queues):
    room = has_room(store) and store.count[NEAR] + store.count[FAR] + MAX_SUCCESSORS <= len(store.open_f)
    for i in range(len(queues)):
        queue = queues[i]
        room = room and queue.count[NEAR] + queue.count[FAR] + MAX_SUCCESSORS <= len(queue.open_f)
    return room


@njit(allocates=False)
def run(world, rules, anchor, guides, store, queues, weight, anchor_weight, goal, cost_limit, expansions, once):
    """Search on until something happens.

    Args:
        world: terrain and robot.
        rules: restrictions of this search.
        anchor: consistent heuristic.
        guides: tuple of heuristics.
        store: the search so far, with the anchor's open list; changed in place.
        queues: tuple, the open lists of the guides; changed in place.
        weight, anchor_weight: W1 and W2, each >= 1.
        goal: its node.
        cost_limit: leave out states that cost more to reach; stop when no plan up to it is left.
        expansions: return after so many, so that the caller can look at the clock.
        once: bits of states that the anchor does not expand again; ``ANCHORED``, or 0 if all may be.

    Returns:
        As ``search.run``.
    """
    costs, actions, flags, count = store.g, store.action, store.flags, store.count
    out_key, out_cost, out_action = store.out_key, store.out_cost, store.out_action
    until = count[EXPANDED] + expansions
    while count[EXPANDED] < until:
        if not _has_room(store, queues):
            return search.FULL
        least = np.float64(first_key(store, once))
        if costs[goal] <= least:
            if costs[goal] < np.inf:
                return search.SOLVED
            return search.OVER_COST_LIMIT if count[CUT] else search.EXHAUSTED
        if least > weight * cost_limit:
            return search.OVER_COST_LIMIT
        turn = count[EXPANDED] % len(queues)  # every turn is one expansion
        queue = queues[turn]
        key = first_key(queue, ANCHORED | GUIDED)
        if key < np.inf and key <= anchor_weight * least:
            if costs[goal] <= key:
                return search.SOLVED
            node = pop(queue)
            queue.count[EXPANDED] += 1
            flags[node] |= CLOSED | GUIDED
        else:
            if costs[goal] <= anchor_weight * least:
                return search.SOLVED
            node = pop(store)
            flags[node] |= CLOSED | ANCHORED
        count[EXPANDED] += 1
        state = key_of(store, node)
        g = np.float64(costs[node])
        if state & FEET_MASK == store.neutral:
            n = pose_successors(world, rules, state, out_key, out_cost, out_action)
        elif not rules.drive_only:
            n = other_successors(world, state, out_key, out_cost, out_action)
        else:
            n = 0
        for k in range(n):
            cost = np.float32(g + out_cost[k])
            if cost > cost_limit:
                count[CUT] = 1
                continue
            at = node_of(store, out_key[k])
            before = costs[at]
            if cost >= before:
                continue
            count[SEEN] += before == np.inf
            costs[at] = cost
            actions[at] = out_action[k]
            flags[at] &= ~np.uint8(CLOSED)
            _push_all(store, queues, anchor, guides, weight, out_key[k], at, once)
    return search.RUNNING
