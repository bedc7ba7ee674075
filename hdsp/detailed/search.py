"""Weighted A* over packed states: the search kernel and the store it fills.

One family serves labels (one start, many goals), planning (one goal, weighted) and, later, anytime planning. It reopens
states, because learned heuristics are inconsistent: a state is expanded again whenever a cheaper way to it was found.

A state costs 13 bytes (packed state 8, cost 4, action 1) plus 4 bytes a slot of the hash table; the way back is found
by undoing actions. A heap entry whose f no longer equals ``g + W h`` of its state is outdated and skipped.
"""

from typing import NamedTuple

import numpy as np

from hdsp.detailed.actions import MAX_SUCCESSORS, successors
from hdsp.detailed.estimate import estimate
from hdsp.detailed.states import START, undo
from hdsp.jit import njit

RUNNING, SOLVED, EXHAUSTED, OVER_COST_LIMIT, FULL = range(5)

#: Slots of ``Store.count``.
NODES, HEAP, EXPANDED, GOALS_LEFT, CUT = range(5)


class Store(NamedTuple):
    """Everything a search has seen; fixed arrays, exchanged for larger ones by ``grown``."""

    key: np.ndarray  # int64 [capacity]
    g: np.ndarray  # float32 [capacity], cost from the start
    action: np.ndarray  # uint8 [capacity], the action that led here
    slot: np.ndarray  # int32 [power of two], hash table: index of a state, -1 = free
    heap_f: np.ndarray  # float32 [capacity of heap], a 4-ary heap
    heap_node: np.ndarray  # int32 [capacity of heap]
    count: np.ndarray  # int64 [5]; CUT tells whether the cost limit kept a state out
    out_key: np.ndarray  # buffers for the successors of one state
    out_cost: np.ndarray
    out_action: np.ndarray

    def nbytes(self) -> int:
        return sum(array.nbytes for array in self)


def new_store(capacity: int = 1 << 12) -> Store:
    """An empty store for ``capacity`` (a power of two) states."""
    return Store(
        key=np.empty(capacity, np.int64),
        g=np.empty(capacity, np.float32),
        action=np.empty(capacity, np.uint8),
        slot=np.full(2 * capacity, -1, np.int32),
        heap_f=np.empty(2 * capacity, np.float32),
        heap_node=np.empty(2 * capacity, np.int32),
        count=np.zeros(5, np.int64),
        out_key=np.empty(MAX_SUCCESSORS, np.int64),
        out_cost=np.empty(MAX_SUCCESSORS, np.float64),
        out_action=np.empty(MAX_SUCCESSORS, np.uint8),
    )


def grown(store: Store) -> Store:
    """The same store with room for more states or heap entries, whichever ran short."""
    if store.count[NODES] + MAX_SUCCESSORS > len(store.key):
        slot = np.full(2 * len(store.slot), -1, np.int32)
        _fill_slots(slot, store.key, store.count[NODES])
        double = [np.concatenate([a, np.empty_like(a)]) for a in (store.key, store.g, store.action)]
        store = store._replace(key=double[0], g=double[1], action=double[2], slot=slot)
    if store.count[HEAP] + MAX_SUCCESSORS > len(store.heap_f):
        double = [np.concatenate([a, np.empty_like(a)]) for a in (store.heap_f, store.heap_node)]
        store = store._replace(heap_f=double[0], heap_node=double[1])
    return store


@njit(inline="always")
def _hash(key, mask):
    mixed = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    return np.int64((mixed ^ (mixed >> np.uint64(32))) & np.uint64(mask))


@njit()
def _fill_slots(slot, keys, n):
    mask = len(slot) - 1
    for i in range(n):
        s = _hash(keys[i], mask)
        while slot[s] >= 0:
            s = (s + 1) & mask
        slot[s] = i


@njit()
def find(store, key):
    """Index of a state in the store, -1 if it was never seen."""
    mask = len(store.slot) - 1
    s = _hash(key, mask)
    while store.slot[s] >= 0:
        if store.key[store.slot[s]] == key:
            return np.int64(store.slot[s])
        s = (s + 1) & mask
    return np.int64(-1)


@njit(inline="always")
def _push(heap_f, heap_node, n, f, node):
    """Put an entry into a 4-ary heap of ``n`` entries."""
    i = n
    while i > 0:
        parent = (i - 1) >> 2
        if heap_f[parent] <= f:
            break
        heap_f[i] = heap_f[parent]
        heap_node[i] = heap_node[parent]
        i = parent
    heap_f[i] = f
    heap_node[i] = node


@njit(inline="always")
def _remove_top(heap_f, heap_node, n):
    """Take the top entry off a heap of ``n`` entries, which leaves ``n - 1``."""
    n -= 1
    f, node = heap_f[n], heap_node[n]
    i = 0
    while True:
        child = 4 * i + 1
        if child >= n:
            break
        best = child
        for k in range(child + 1, min(child + 4, n)):
            if heap_f[k] < heap_f[best]:
                best = k
        if heap_f[best] >= f:
            break
        heap_f[i] = heap_f[best]
        heap_node[i] = heap_node[best]
        i = best
    heap_f[i] = f
    heap_node[i] = node


@njit()
def insert_start(store, heuristic, weight, key):
    """Begin a search at a packed state."""
    store.key[0] = key
    store.g[0] = 0
    store.action[0] = START
    store.slot[_hash(key, len(store.slot) - 1)] = 0
    store.count[NODES] = 1
    store.count[HEAP] = 1
    _push(store.heap_f, store.heap_node, 0, np.float32(weight * estimate(heuristic, key)), 0)


@njit()
def run(world, rules, heuristic, store, weight, goals, goal_cost, cost_limit, f_limit, expansions):
    """Search on until something happens.

    Args:
        world: terrain and robot.
        rules: restrictions of this search.
        heuristic: estimate of the cost to the goals.
        store: the search so far; changed in place.
        weight: W >= 1.
        goals: int64 [n], packed goal states.
        goal_cost: float32 [n], inf where a goal is not settled; changed in place.
        cost_limit: leave out states that cost more to reach.
        f_limit: stop when all that is left has a larger ``g + W h``.
        expansions: return after so many, so that the caller can look at the clock.

    Returns:
        RUNNING, SOLVED (all goals settled), EXHAUSTED (nothing left to expand), OVER_COST_LIMIT or FULL.
    """
    # Arrays are named once: each access through a tuple counts references, which costs more than the work in this loop.
    keys, costs, actions, slots = store.key, store.g, store.action, store.slot
    heap_f, heap_node, count = store.heap_f, store.heap_node, store.count
    out_key, out_cost, out_action = store.out_key, store.out_cost, store.out_action
    mask = len(slots) - 1
    n_nodes, n_heap, expanded = count[NODES], count[HEAP], count[EXPANDED]
    until = expanded + expansions
    while n_heap > 0:
        if n_nodes + MAX_SUCCESSORS > len(keys) or n_heap + MAX_SUCCESSORS > len(heap_f):
            outcome = FULL
            break
        if expanded >= until:
            outcome = RUNNING
            break
        f, node = heap_f[0], heap_node[0]
        if f > f_limit:
            outcome = OVER_COST_LIMIT
            break
        _remove_top(heap_f, heap_node, n_heap)
        n_heap -= 1
        key = keys[node]
        g = np.float64(costs[node])
        if f != np.float32(g + weight * estimate(heuristic, key)):
            continue
        for k in range(len(goals)):
            if goals[k] == key and goal_cost[k] == np.inf:
                goal_cost[k] = g
                count[GOALS_LEFT] -= 1
        if count[GOALS_LEFT] == 0:
            outcome = SOLVED
            break
        expanded += 1
        n = successors(world, rules, key, out_key, out_cost, out_action)
        for k in range(n):
            new = out_key[k]
            cost = np.float32(g + out_cost[k])
            if cost > cost_limit:
                count[CUT] = 1
                continue
            s = _hash(new, mask)
            at = np.int64(slots[s])
            while at >= 0 and keys[at] != new:
                s = (s + 1) & mask
                at = np.int64(slots[s])
            if at < 0:
                at = n_nodes
                n_nodes += 1
                slots[s] = at
                keys[at] = new
            elif cost >= costs[at]:
                continue
            costs[at] = cost
            actions[at] = out_action[k]
            h = estimate(heuristic, new)
            if h < np.inf:
                _push(heap_f, heap_node, n_heap, np.float32(np.float64(cost) + weight * h), at)
                n_heap += 1
    else:
        outcome = OVER_COST_LIMIT if count[CUT] else EXHAUSTED
    count[NODES], count[HEAP], count[EXPANDED] = n_nodes, n_heap, expanded
    return outcome


@njit()
def trace(world, store, key):
    """The way back from a state: node indices from the start to ``key``, int64 [n]."""
    tables = world.tables
    n = 1
    node = find(store, key)
    at = key
    while store.action[node] != START:
        at = undo(at, store.action[node], tables.move_dx, tables.move_dy, tables.shifts)
        node = find(store, at)
        n += 1
    path = np.empty(n, np.int64)
    at = key
    for i in range(n - 1, -1, -1):
        node = find(store, at)
        path[i] = node
        if i > 0:
            at = undo(at, store.action[node], tables.move_dx, tables.move_dy, tables.shifts)
    return path
