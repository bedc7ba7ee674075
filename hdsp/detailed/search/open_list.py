"""The open list: states still to be expanded, in the exact order of their f, without one large heap.

Two parts share one pair of arrays. From the left grows a small 4-ary heap, *near*: all entries whose f is at most a
bound. From the right grows an unsorted list, *far*: the rest. When the heap is empty, the bound rises such that a small
share of the far entries moves into it. So nearly every entry waits where it costs 8 bytes and one write, and the heap
stays in the cache.

No entry is ever changed or removed from the middle. A state whose cost falls gets another entry, which comes out before
the older one; an entry of a state that was expanded at its present cost (``store.CLOSED``) is outdated.
"""

from typing import NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.actions.successors import MAX_SUCCESSORS
from hdsp.detailed.search.store import CLOSED

#: Slots of ``OpenList.count``.
NEAR, FAR = range(2)

_SAMPLE = 128  # far entries looked at to set the bound
_ROOM = 1 << 11  # entries at first


class OpenList(NamedTuple):
    """Entries (f, node); fixed arrays, exchanged for larger ones by ``with_room``."""

    f: np.ndarray  # float32 [room]
    node: np.ndarray  # int32 [room]
    least: np.ndarray  # float32 [4], the last is the bound between near and far
    count: np.ndarray  # int64 [2], entries near and far

    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return sum(array.nbytes for array in self)


def new_open_list() -> OpenList:
    """An empty open list."""
    return OpenList(
        f=np.empty(_ROOM, np.float32),
        node=np.empty(_ROOM, np.int32),
        least=np.full(4, -np.inf, np.float32),
        count=np.zeros(2, np.int64),
    )


def clear(entries: OpenList) -> None:
    """Take out all entries."""
    entries.count[:] = 0
    entries.least[:] = -np.inf


def with_room(entries: OpenList, flags: np.ndarray, more: int) -> OpenList:
    """The same open list with room for ``more`` entries; outdated ones go before it grows.

    Args:
        entries: the open list.
        flags: uint8, of the nodes, see ``Store``.
        more: number of entries.
    """
    room = _new_room(entries, flags, more)
    if room > len(entries.f):
        near, far = int(entries.count[NEAR]), int(entries.count[FAR])
        arrays = []
        for array in (entries.f, entries.node):
            longer = np.empty(room, array.dtype)
            longer[:near] = array[:near]
            longer[room - far :] = array[len(array) - far :]
            arrays.append(longer)
        entries = entries._replace(f=arrays[0], node=arrays[1])
    return entries


def growth_nbytes(entries: OpenList, flags: np.ndarray, more: int) -> int:
    """Bytes that ``with_room`` needs besides those of the open list."""
    room = _new_room(entries, flags, more)
    return room * (entries.f.itemsize + entries.node.itemsize) if room > len(entries.f) else 0


def _new_room(entries: OpenList, flags: np.ndarray, more: int) -> int:
    """Room for ``more`` entries, after outdated ones were dropped."""
    _drop_outdated(entries, flags)
    room, used = len(entries.f), int(entries.count[NEAR] + entries.count[FAR])
    if 5 * (used + more) <= 4 * room:
        return room
    return max(int(1.25 * room), int(1.25 * (used + more)))


@njit(allocates=False)
def _drop_outdated(entries, flags):
    f, nodes, count = entries.f, entries.node, entries.count
    first = len(f) - count[FAR]
    for i in range(first, len(f)):
        if flags[nodes[i]] & CLOSED:
            f[i], nodes[i] = f[first], nodes[first]
            first += 1
    count[FAR] = len(f) - first


@njit(inline="always")
def list_has_room(entries):
    """Whether the successors of any one state still find room."""
    return entries.count[NEAR] + entries.count[FAR] + MAX_SUCCESSORS <= len(entries.f)


@njit(inline="always")
def push(entries, f, node):
    """Add an entry to the part where it belongs."""
    if f > entries.least[-1]:
        entries.count[FAR] += 1
        at = len(entries.f) - entries.count[FAR]
        entries.f[at], entries.node[at] = f, node
    else:
        _push_near(entries.f, entries.node, entries.count, f, node)


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
def pop(entries):
    """Take the first entry off the heap, which must not be empty; returns its node."""
    f_of, node_of = entries.f, entries.node
    top = np.int64(node_of[0])
    n = entries.count[NEAR] - 1
    entries.count[NEAR] = n
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
def refill(entries, flags):
    """Move the first of the far entries into the heap, which must be empty."""
    f_of, node_of, count = entries.f, entries.node, entries.count
    n, first = count[FAR], len(f_of) - count[FAR]
    _sample_least(f_of[first:], entries.least)
    bound = entries.least[-1]
    for i in range(first, first + n):
        if f_of[i] <= bound:
            f, node = f_of[i], node_of[i]
            f_of[i], node_of[i] = f_of[first], node_of[first]
            first += 1
            count[FAR] -= 1
            if not flags[node] & CLOSED:
                _push_near(f_of, node_of, count, f, node)


@njit(allocates=False)
def first_f(entries, flags, outdated):
    """Least f in an open list, inf if it is empty; ``outdated``: bits of the flags whose entries are dropped."""
    while True:
        while entries.count[NEAR] > 0 and flags[entries.node[0]] & (CLOSED | outdated):
            pop(entries)
        if entries.count[NEAR] > 0:
            return entries.f[0]
        if entries.count[FAR] == 0:
            return np.float32(np.inf)
        refill(entries, flags)


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
