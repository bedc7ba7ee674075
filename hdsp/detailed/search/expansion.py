"""Expansion and relaxation, shared by all searches.

The loops in ``kernel`` and ``multi_kernel`` inline these functions. They differ in the choice of the next state and in
their open lists.
"""

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.actions.action import START
from hdsp.detailed.actions.successors import successors
from hdsp.detailed.search.backward import SETTLED
from hdsp.detailed.search.estimate import estimate, resume
from hdsp.detailed.search.open_list import push
from hdsp.detailed.search.store import CLOSED, CUT, SEEN, look_ahead, node_of
from hdsp.detailed.states import FEET_MASK

#: Nodes that the backward search settles in the time of an expansion, roughly.
_SETTLED = 4


@njit(allocates=False)
def begin_at(store, start):
    """Puts the packed start state into an empty store; returns its node."""
    node = node_of(store, start)
    store.g[node] = 0
    store.action[node] = START
    store.counts[SEEN] = 1
    return node


@njit(inline="always")
def expand(world, rules, store, key):
    """Writes the successors of a packed state into the store's buffers; returns their number."""
    n = successors(world, rules, key, store.out_key, store.out_cost, store.out_action)
    if key & FEET_MASK != store.neutral:
        look_ahead(store, n)
    return n


@njit(inline="always")
def relax(store, k, g, cost_limit):
    """Records the path to successor ``k`` if it is cheaper than the known path.

    Args:
        store: states seen so far, with the successors in its buffers; changed in place.
        k: index in the buffers.
        g: float64, cost from the start to the expanded state.
        cost_limit: a successor with a higher cost is left out, and ``CUT`` is set.

    Returns:
        Node of the successor, now in wait for expansion; -1 without a cheaper path.
    """
    cost = np.float32(g + store.out_cost[k])
    if cost > cost_limit:
        store.counts[CUT] = 1
        return np.int64(-1)
    node = node_of(store, store.out_key[k])
    before = store.g[node]
    if cost >= before:
        return np.int64(-1)
    store.counts[SEEN] += before == np.inf
    store.g[node] = cost
    store.action[node] = store.out_action[k]
    store.flags[node] &= ~np.uint8(CLOSED)
    return node


@njit(inline="always")
def offer(world, open_list, store, heuristic, weight, key, node):
    """Adds a node to an open list with ``f = g + W h``; returns False if h is infinite, then the node stays out."""
    h = estimate(world, heuristic, key)
    if h == np.inf:
        return False
    push(open_list, np.float32(np.float64(store.g[node]) + weight * h), node)
    return True


@njit(inline="always")
def rises(world, open_list, store, heuristic, weight, key, node, f, wanted):
    """Whether a node came out of an open list too early: its heuristic rises, or may rise, with more backward search.

    The node then goes back into the list with its new f, unless h is infinite. A node that may be expanded has its
    final h, and no other node in the list has a smaller final f. The order is thus the same as with final values from
    the beginning, and only states that are next to be expanded need them.

    Args:
        world: terrain and robot.
        open_list: the list; changed in place.
        store: states seen so far.
        heuristic, weight: the order of the list.
        key, node: the packed state and its node.
        f: its value in the list.
        wanted: value with which the node need not come out again soon.

    Returns:
        Work for the answer, in expansions; 0 if the node may be expanded.
    """
    if len(heuristic.back.place) == 0:
        return 0
    before = heuristic.back.counts[SETTLED]
    so_far = np.float64(store.g[node])
    h = estimate(world, heuristic, key)
    # The value may have risen since the node entered the list. More backward search then waits until it is needed.
    if h < np.inf and np.float32(so_far + weight * h) > f:
        push(open_list, np.float32(so_far + weight * h), node)
        return 1
    final = resume(world, heuristic, key, (wanted - so_far) / weight)
    h = estimate(world, heuristic, key)
    new = np.float32(so_far + weight * h)
    if final and new <= f:
        return 0
    if h < np.inf:
        push(open_list, new, node)
    return 1 + (heuristic.back.counts[SETTLED] - before) // _SETTLED
