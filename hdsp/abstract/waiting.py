"""Queue of states in buckets, for kernels: a state is removed, or put into another bucket, in constant time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hdsp.base.bucket_links import OUT, link, unlink
from hdsp.base.jit import njit

BUCKETS = 1 << 13  # of a queue
_FAR = BUCKETS - 1  # a state in a later bucket waits in this one, and comes again


class Waiting(NamedTuple):
    """Waiting states in buckets by their keys, costs that only grow during a search.

    Attributes:
        after, ahead: int32 [states], neighbours of a waiting state in its bucket; ``ahead`` of its first state is
            -1 - slot, of other states -2**31.
        heads: int32 [buckets], first state of a bucket, -1 = none; slot n holds buckets of n modulo their number.
        counts: int64 [2], present bucket and number of waiting states.
        per_width: 1 / bucket width.
    """

    after: np.ndarray
    ahead: np.ndarray
    heads: np.ndarray
    counts: np.ndarray
    per_width: float

    @classmethod
    def none(cls, states: int, costs: np.ndarray | Sequence[float]) -> Waiting:
        """Returns an empty queue.

        A bucket is as wide as the cheapest action, and no less than a share of the most expensive one's cost.

        Args:
            states: number of states.
            costs: costs of the actions, of any shape; infinite ones do not count.
        """
        links = np.empty(states, np.int32), np.full(states, OUT, np.int32)
        each = np.asarray(costs, float)
        finite = each[np.isfinite(each)]
        width = max(finite.min(), finite.max() / 64, 1e-6) if len(finite) else 1.0
        return cls(*links, np.full(BUCKETS, -1, np.int32), np.zeros(2, np.int64), 1.0 / float(width))


@njit(inline="always")
def bucket_of(queue, key):
    """Returns the bucket with a key."""
    return np.int64(key * queue.per_width)


@njit(inline="always")
def put(queue, state, key):
    """Puts a state into the bucket with its key, and out of its former one."""
    slot = min(max(bucket_of(queue, key), queue.counts[0]), queue.counts[0] + _FAR) % BUCKETS
    if queue.ahead[state] != OUT:
        unlink(queue.heads, queue.after, queue.ahead, state)
        queue.counts[1] -= 1
    link(queue.heads, queue.after, queue.ahead, state, slot)
    queue.counts[1] += 1


@njit(inline="always")
def present(queue):
    """Tells whether a state waits in the present bucket."""
    return queue.heads[queue.counts[0] % BUCKETS] >= 0


@njit(inline="always")
def take(queue):
    """Removes a state from the present bucket and returns it."""
    state = np.int64(queue.heads[queue.counts[0] % BUCKETS])
    unlink(queue.heads, queue.after, queue.ahead, state)
    queue.counts[1] -= 1
    return state
