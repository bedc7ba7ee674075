"""The open list: states still to be expanded, in the exact order of their f, without one large heap.

Two parts share one pair of arrays. From the left grows a small 4-ary heap, *near*: all entries whose f is at most a
bound. From the right grows an unsorted list, *far*: the rest. When the heap is empty, the bound rises such that a small
share of the far entries moves into it. So nearly every entry waits where it costs 8 bytes and one write, and the heap
stays in the cache.

No entry is ever changed or removed from the middle. A state whose cost falls gets another entry, which comes out before
the older one; what comes out of a state that was expanded at its present cost (``store.CLOSED``) is outdated.
"""

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.search.store import CLOSED, FAR, NEAR, Store

_SAMPLE = 128  # far entries looked at to set the bound


def with_room(store: Store, entries: int) -> Store:
    """The same store with room for so many entries more in its open list; outdated ones go before it grows."""
    room = _new_room(store, entries)
    if room > len(store.open_f):
        near, far = int(store.count[NEAR]), int(store.count[FAR])
        arrays = []
        for array in (store.open_f, store.open_node):
            longer = np.empty(room, array.dtype)
            longer[:near] = array[:near]
            longer[room - far :] = array[len(array) - far :]
            arrays.append(longer)
        store = store._replace(open_f=arrays[0], open_node=arrays[1])
    return store


def clear(store: Store) -> None:
    """Take out all entries."""
    store.count[NEAR] = store.count[FAR] = 0
    store.open_least[:] = -np.inf


def growth_nbytes(store: Store, entries: int) -> int:
    """Bytes that ``with_room`` needs besides those of the store."""
    room = _new_room(store, entries)
    return room * (store.open_f.itemsize + store.open_node.itemsize) if room > len(store.open_f) else 0


def _new_room(store: Store, entries: int) -> int:
    """Room for so many entries more, after outdated ones were dropped."""
    _drop_outdated(store)
    room, used = len(store.open_f), int(store.count[NEAR] + store.count[FAR])
    if 5 * (used + entries) <= 4 * room:
        return room
    return max(int(1.25 * room), int(1.25 * (used + entries)))


@njit(allocates=False)
def _drop_outdated(store):
    f, nodes, count = store.open_f, store.open_node, store.count
    first = len(f) - count[FAR]
    for i in range(first, len(f)):
        if store.flags[nodes[i]] & CLOSED:
            f[i], nodes[i] = f[first], nodes[first]
            first += 1
    count[FAR] = len(f) - first


@njit(inline="always")
def push(store, f, node):
    """Add an entry to the part where it belongs."""
    if f > store.open_least[-1]:
        store.count[FAR] += 1
        at = len(store.open_f) - store.count[FAR]
        store.open_f[at], store.open_node[at] = f, node
    else:
        _push_near(store.open_f, store.open_node, store.count, f, node)


@njit(inline="always")
def _push_near(f_of, node_of, count, f, node):
    i = count[NEAR]
    count[NEAR] += 1
    while i > 0:
        parent = (i - 1) >> 2
        if f_of[parent] <= f:
            break
        f_of[i], node_of[i] = f_of[parent], node_of[parent]
        i = parent
    f_of[i], node_of[i] = f, node


@njit(inline="always")
def pop(store):
    """Take the first entry off the heap, which must not be empty; returns its node."""
    f_of, node_of = store.open_f, store.open_node
    top = np.int64(node_of[0])
    n = store.count[NEAR] - 1
    store.count[NEAR] = n
    f, node = f_of[n], node_of[n]
    i = 0
    while True:
        child = 4 * i + 1
        if child >= n:
            break
        best = child
        for k in range(child + 1, min(child + 4, n)):
            if f_of[k] < f_of[best]:
                best = k
        if f_of[best] >= f:
            break
        f_of[i], node_of[i] = f_of[best], node_of[best]
        i = best
    f_of[i], node_of[i] = f, node
    return top


@njit(allocates=False)
def refill(store):
    """Move the first of the far entries into the heap, which must be empty."""
    f_of, node_of, count = store.open_f, store.open_node, store.count
    n, first = count[FAR], len(f_of) - count[FAR]
    _sample_least(f_of[first:], store.open_least)
    bound = store.open_least[-1]
    for i in range(first, first + n):
        if f_of[i] <= bound:
            f, node = f_of[i], node_of[i]
            f_of[i], node_of[i] = f_of[first], node_of[first]
            first += 1
            count[FAR] -= 1
            if not store.flags[node] & CLOSED:
                _push_near(f_of, node_of, count, f, node)


@njit(allocates=False)
def _sample_least(values, least):
    """Set ``least`` to the least, in order, of a sample of the values; to inf if they are few."""
    least[:] = np.inf
    if len(values) < 8 * _SAMPLE:
        return
    for i in range(_SAMPLE):
        value = values[i * len(values) // _SAMPLE]
        k = len(least) - 1
        if value >= least[k]:
            continue
        while k > 0 and least[k - 1] > value:
            least[k] = least[k - 1]
            k -= 1
        least[k] = value
