"""Dijkstra search backward from goals over the abstract graph (paper, Sec. V-D).

One search from the goals over predecessors gives every abstract state the cost of its cheapest path to any of them. The
kernel uses a ring of buckets instead of a heap. If buckets are no wider than the cheapest edge, no state in a bucket
can improve another state in it, so a bucket needs no order. If this takes too many buckets, they are made wider, and a
state that improves after its visit is visited again; the distances are the same.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hdsp.abstract.prefetch import prefetch
from hdsp.base.jit import njit
from hdsp.robot.lattice import DRIVE_MOVES, N_ABSTRACT_ACTIONS

N_DRIVE = len(DRIVE_MOVES)  # abstract actions are these moves, followed by the turns
DONE, FULL, PAUSED = range(3)  # ends of a call of the search
_AHEAD = 3  # visits between the prefetch of a cost row and its use
_MAX_BUCKETS = 256  # a power of two; more buckets take memory, fewer repeat a few visits


def bucket_sizes(cheapest: float, most_expensive: float) -> tuple[float, int]:
    """Returns bucket width and count (a power of two); the ring spans the most expensive edge."""
    if not most_expensive > 0:  # no finite edge, or only free ones
        return 1.0, 2
    # Slightly below the cheapest edge, so that rounding cannot put a successor into its origin's bucket.
    width = max(cheapest * (1 - 1e-6), most_expensive / (_MAX_BUCKETS - 3))
    return width, 1 << (int(most_expensive / width) + 2).bit_length()


class BucketRing(NamedTuple):
    """Search state; all flat arrays over states have a margin of unreachable states at both ends."""

    distance: np.ndarray  # float64 [margin + states + margin]
    visited: np.ndarray  # bool, like distance: whether a state was visited at its current distance
    entries: np.ndarray  # uint32 [buckets, room], flat indices of waiting states
    filled: np.ndarray  # int64 [buckets]
    current: np.ndarray  # int64 [1], the bucket being emptied

    @classmethod
    def starting_at(
        cls, goals: np.ndarray, costs: np.ndarray, per_width: float, states: int, margin: int, buckets: int
    ) -> BucketRing:
        """Returns a search from goals, flat indices int64 [n], each at a cost within the ring, float64 [n]."""
        n = len(goals)
        distance = np.full(states + 2 * margin, np.inf)
        distance[goals + margin] = costs
        entries = np.empty((buckets, max(2 * N_ABSTRACT_ACTIONS + n, 2 * states // buckets)), np.uint32)
        filled = np.zeros(buckets, np.int64)
        for goal, bucket in zip(goals.tolist(), (costs * per_width).astype(int).tolist(), strict=True):
            entries[bucket, filled[bucket]] = goal + margin
            filled[bucket] += 1
        return cls(distance, np.zeros(len(distance), np.bool_), entries, filled, np.zeros(1, np.int64))

    def with_more_room(self) -> BucketRing:
        return self._replace(entries=np.concatenate([self.entries, np.empty_like(self.entries)], axis=1))


@njit(nogil=True)
def search(incoming, offsets, queue, margin, per_width, most):
    """Empties the queue, or stops before; the next call continues.

    Args:
        incoming: float32 [states * 22], costs by end state.
        offsets: int64 [22], index differences from a state to its predecessor by each action.
        queue: the `BucketRing`; changed.
        margin: number of unused states at both ends of the queue's arrays.
        per_width: 1 / bucket width.
        most: number of entries, after which the search stops at the end of a bucket.

    Returns:
        ``DONE``; ``FULL`` if a bucket may be too small for the next visit; ``PAUSED`` after ``most`` entries.

    Indices are unsigned because numba then omits its test for negative ones. An edge from outside the map costs inf, so
    the comparison of distances is the only test in the inner loop.
    """
    distance, visited, entries, filled, current_bucket = queue
    states = np.int64(len(distance) - 2 * margin)
    count = np.uint64(len(offsets))
    buckets, room = entries.shape
    mask = np.int64(buckets - 1)
    current = current_bucket[0]
    fullest = filled.max()
    last = fullest  # entries of the current bucket
    taken = 0
    while True:
        if taken >= most:
            current_bucket[0] = current
            return PAUSED
        empty = 0
        while empty < buckets and filled[current] == 0:
            current = (current + 1) & mask
            empty += 1
        if empty == buckets:
            return DONE
        place = 0
        last = filled[current]
        while place < last:
            if fullest + N_ABSTRACT_ACTIONS > room:
                fullest = filled.max()
                if fullest + N_ABSTRACT_ACTIONS > room:
                    current_bucket[0] = current  # its entries stay; the next call skips visited ones
                    return FULL
            state = np.uint64(entries[np.uint64(current), np.uint64(place)])
            place += 1
            if place + _AHEAD < last:
                ahead = (np.uint64(entries[np.uint64(current), np.uint64(place + _AHEAD)]) - np.uint64(margin)) * count
                prefetch(incoming, ahead)
                prefetch(incoming, ahead + count - np.uint64(1))
            if visited[state]:
                continue
            visited[state] = True
            base = distance[state]
            row = (state - np.uint64(margin)) * count
            for action in range(N_ABSTRACT_ACTIONS):
                index = np.int64(state) + offsets[np.uint64(action)]
                if action >= N_DRIVE:  # turns: headings are cyclic
                    if index < margin:
                        index += states
                    elif index >= states + margin:
                        index -= states
                reached = base + np.float64(incoming[row + np.uint64(action)])
                target = np.uint64(index)
                if reached < distance[target]:
                    distance[target] = reached
                    visited[target] = False
                    bucket = np.uint64(np.int64(reached * per_width) & mask)
                    end = filled[bucket]
                    entries[bucket, np.uint64(end)] = target
                    filled[bucket] = end + 1
                    fullest = max(fullest, end + 1)
            last = filled[current]
        taken += last
        filled[current] = 0
