"""Queue of states in buckets, for kernels: a state is removed, or put into another bucket, in constant time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hdsp.base.bucket_links import OUT, link, unlink
from hdsp.base.jit import njit

#: Buckets of a queue.
BUCKETS = 1 << 13
_FAR = BUCKETS - 1  # a state in a later bucket waits in this one, and comes again


class Waiting(NamedTuple):
    """Waiting states in buckets.

    Attributes:
        after, ahead: int32 [states], neighbours of a waiting state in its bucket; ``ahead`` of its first state is
            -1 - slot, of other states -2**31.
        heads: int32 [buckets], first state of a bucket, -1 = none; slot n holds buckets of n modulo their number.
        counts: int64 [2], present bucket and number of waiting states.
    """

    after: np.ndarray
    ahead: np.ndarray
    heads: np.ndarray
    counts: np.ndarray

    @classmethod
    def none(cls, states: int) -> Waiting:
        """Returns an empty queue for a number of states."""
        links = np.empty(states, np.int32), np.full(states, OUT, np.int32)
        return cls(*links, np.full(BUCKETS, -1, np.int32), np.zeros(2, np.int64))


def bucket_width(costs: np.ndarray) -> float:
    """Width of a bucket for actions with some costs: the cheapest, and no less than a share of the most expensive."""
    finite = costs[np.isfinite(costs)]
    return float(max(finite.min(), finite.max() / 64, 1e-6)) if len(finite) else 1.0


@njit(inline="always")
def put(after, ahead, heads, counts, state, bucket):
    """Puts a state into a bucket, out of its present one."""
    slot = min(max(bucket, counts[0]), counts[0] + _FAR) % BUCKETS
    if ahead[state] != OUT:
        remove(after, ahead, heads, counts, state)
    link(heads, after, ahead, state, slot)
    counts[1] += 1


@njit(inline="always")
def remove(after, ahead, heads, counts, state):
    """Removes a waiting state."""
    unlink(heads, after, ahead, state)
    counts[1] -= 1
