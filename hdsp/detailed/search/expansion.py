"""What all searches do with a state: expand it, and take over cheaper ways to its successors.

The functions are inlined into the loops of ``kernel`` and ``multi_kernel``, which differ in the states that they choose
and in the open lists that they fill.
"""

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.actions.action import START
from hdsp.detailed.actions.successors import other_successors, pose_successors
from hdsp.detailed.search.estimate import estimate
from hdsp.detailed.search.open_list import push
from hdsp.detailed.search.store import CLOSED, CUT, SEEN, node_of
from hdsp.detailed.states import FEET_MASK


@njit(inline="always")
def begin_at(store, start):
    """Put the packed start state into an empty store; returns its node."""
    node = node_of(store, start)
    store.g[node] = 0
    store.action[node] = START
    store.counts[SEEN] = 1
    return node


@njit(inline="always")
def expand(world, rules, store, key):
    """Write the successors of a packed state into the buffers of the store; returns their number."""
    if key & FEET_MASK == store.neutral:
        n = pose_successors(world, rules, key, store.out_key, store.out_cost, store.out_action)
    elif not rules.drive_only:
        n = other_successors(world, key, store.out_key, store.out_cost, store.out_action)
    else:
        n = 0
    return n


@njit(inline="always")
def relax(store, k, g, cost_limit):
    """Take over the way to successor ``k`` in the buffers of the store if it is cheaper than the known one.

    Args:
        store: states seen so far; changed in place.
        k: place of the successor in the buffers.
        g: float64, cost of the state that was expanded.
        cost_limit: states that cost more to reach are left out, and ``CUT`` is set.

    Returns:
        Node of the successor, which waits for its expansion now; -1 if the way was not taken over.
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
def offer(open_list, store, heuristic, weight, key, node):
    """Put a node into an open list at ``f = g + W h``; returns whether h is finite, else the node stays out."""
    h = estimate(heuristic, key)
    if h == np.inf:
        return False
    push(open_list, np.float32(np.float64(store.g[node]) + weight * h), node)
    return True
