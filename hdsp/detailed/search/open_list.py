"""The open list: states to expand, in the exact order of their f, without one large heap.

Two parts share one pair of arrays. A small 4-ary heap, *near*, grows from the left and holds all entries with f up to a
bound. An unsorted list, *far*, grows from the right and holds the rest. When the heap is empty, the bound rises, and a
small share of the far entries moves into the heap. Nearly every entry therefore waits in the far list, where it costs 8
bytes and one write, and the heap stays in the cache.

A falling cost neither changes nor removes an entry: the state gets another one, which comes out before the older one.
An entry is outdated if its state was expanded at its present cost (``store.CLOSED``).
"""

from typing import NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.base.records import by_reference
from hdsp.detailed.actions.successors import MAX_SUCCESSORS
from hdsp.detailed.search.store import CLOSED

#: Slots in ``OpenList.counts``.
NEAR, FAR = range(2)

_SAMPLE = 128  # far entries in the sample that sets the bound
_ROOM = 1 << 11  # entries in a new list
_MOST_NEAR = 1 << 14  # entries in a heap that leaves the cache


@by_reference
class OpenList(NamedTuple):
    """Entries (f, node) in arrays with fixed length; ``with_room`` replaces them by longer arrays."""

    f: np.ndarray  # float32 [room]
    node: np.ndarray  # int32 [room]
    least: np.ndarray  # float32 [4], the last is the bound between near and far
    counts: np.ndarray  # int64 [2], entries near and far

    def nbytes(self) -> int:
        """Total array size in bytes."""
        return sum(array.nbytes for array in self)


def new_open_list() -> OpenList:
    """Creates an empty open list."""
    return OpenList(
        f=np.empty(_ROOM, np.float32),
        node=np.empty(_ROOM, np.int32),
        least=np.full(4, -np.inf, np.float32),
        counts=np.zeros(2, np.int64),
    )


def clear(entries: OpenList) -> None:
    """Removes all entries."""
    entries.counts[:] = 0
    entries.least[:] = -np.inf


def with_room(entries: OpenList, flags: np.ndarray, more: int) -> OpenList:
    """Returns the same open list with room for ``more`` entries; outdated entries are dropped before it grows.

    Args:
        entries: the open list.
        flags: uint8, flags of the nodes, see ``Store``.
        more: number of entries.
    """
    room = _new_room(entries, flags, more)
    if room > len(entries.f):
        near, far = int(entries.counts[NEAR]), int(entries.counts[FAR])
        arrays = []
        for array in (entries.f, entries.node):
            longer = np.empty(room, array.dtype)
            longer[:near] = array[:near]
            longer[room - far :] = array[len(array) - far :]
            arrays.append(longer)
        entries = entries._replace(f=arrays[0], node=arrays[1])
    return entries


def growth_nbytes(entries: OpenList, flags: np.ndarray, more: int) -> int:
    """Bytes that ``with_room`` needs in addition to the open list; outdated entries are dropped."""
    room = _new_room(entries, flags, more)
    return room * (entries.f.itemsize + entries.node.itemsize) if room > len(entries.f) else 0


def _new_room(entries: OpenList, flags: np.ndarray, more: int) -> int:
    """Drops outdated entries, and shortens a long heap; returns the array length with room for ``more`` entries."""
    _drop_outdated(entries, flags)
    if entries.counts[NEAR] > _MOST_NEAR:
        _shorten(entries)
    room, used = len(entries.f), int(entries.counts[NEAR] + entries.counts[FAR])
    if 5 * (used + more) <= 4 * room:
        return room
    return max(int(1.25 * room), int(1.25 * (used + more)))


@njit(allocates=False, nogil=True)
def _drop_outdated(entries, flags):
    f, nodes, count = entries.f, entries.node, entries.counts
    first = len(f) - count[FAR]
    for i in range(first, len(f)):
        if flags[nodes[i]] & CLOSED:
            f[i], nodes[i] = f[first], nodes[first]
            first += 1
    count[FAR] = len(f) - first


@njit(allocates=False)
def _shorten(entries):
    """Moves all but the first entries of the heap to the far list."""
    f_of, node_of, count, n = entries.f, entries.node, entries.counts, entries.counts[NEAR]
    _sample_least(f_of[:n], entries.least)
    i = 0
    while i < n:
        f, node = f_of[i], node_of[i]
        if f <= entries.least[-1]:
            i += 1
            continue
        n -= 1
        f_of[i], node_of[i] = f_of[n], node_of[n]
        count[FAR] += 1
        at = len(f_of) - count[FAR]
        f_of[at], node_of[at] = f, node
    count[NEAR] = 0
    for i in range(n):
        _push_near(f_of, node_of, count, f_of[i], node_of[i])


@njit(inline="always")
def list_has_room(entries):
    """Whether the successors of any one state still find room."""
    return entries.counts[NEAR] + entries.counts[FAR] + MAX_SUCCESSORS <= len(entries.f)


@njit(inline="always")
def push(entries, f, node):
    """Adds an entry to near or far, depending on its f."""
    if f > entries.least[-1]:
        entries.counts[FAR] += 1
        at = len(entries.f) - entries.counts[FAR]
        entries.f[at], entries.node[at] = f, node
    else:
        _push_near(entries.f, entries.node, entries.counts, f, node)


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
    """Removes the first entry from the heap, which must not be empty; returns its node."""
    f_of, node_of = entries.f, entries.node
    top = np.int64(node_of[0])
    n = entries.counts[NEAR] - 1
    entries.counts[NEAR] = n
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
    """Moves the first far entries into the heap, which must be empty."""
    f_of, node_of, count = entries.f, entries.node, entries.counts
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
    """Least f in an open list, inf if it is empty; drops closed entries and entries with a flag in ``outdated``."""
    while True:
        while entries.counts[NEAR] > 0 and flags[entries.node[0]] & (CLOSED | outdated):
            pop(entries)
        if entries.counts[NEAR] > 0:
            return entries.f[0]
        if entries.counts[FAR] == 0:
            return np.float32(np.inf)
        refill(entries, flags)


@njit(allocates=False)
def _sample_least(values, least):
    """Sets ``least`` to the least values in a sample, in order; to inf for few values."""
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
