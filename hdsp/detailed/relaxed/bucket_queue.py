"""Priority queue for Dijkstra's algorithm: nodes in buckets by cost, each bucket a doubly linked list."""

from typing import NamedTuple

import numpy as np

from hdsp.base.jit import njit

_OUT = np.int32(-(2**31))


class BucketQueue(NamedTuple):
    """Waiting nodes.

    Attributes:
        width: cost range per bucket.
        heads: int32 [buckets], first node, -1 = none.
        after: int32 [nodes], next node in the bucket, -1 = none.
        ahead: int32 [nodes], previous node; -1 - b for the first node in bucket b; _OUT for a node outside the queue.
    """

    width: float
    heads: np.ndarray
    after: np.ndarray
    ahead: np.ndarray


def new_bucket_queue(width: float, most: float, nodes: int) -> BucketQueue:
    """Creates an empty queue for ``nodes`` nodes at costs from 0 to ``most``."""
    heads = np.full(int(most / width) + 2, -1, dtype=np.int32)
    return BucketQueue(width, heads, np.empty(nodes, dtype=np.int32), np.full(nodes, _OUT, dtype=np.int32))


@njit(inline="always")
def put(queue, node, cost):
    """Adds a node at a cost; a waiting node leaves its former bucket."""
    heads, after, ahead = queue.heads, queue.after, queue.ahead
    if waits(queue, node):
        take(queue, node)
    b = int(cost / queue.width)
    second = heads[b]
    heads[b], after[node], ahead[node] = node, second, -1 - b
    if second >= 0:
        ahead[second] = node


@njit(inline="always")
def waits(queue, node):
    """Whether a node waits."""
    return queue.ahead[node] != _OUT


@njit(inline="always")
def take(queue, node):
    """Removes a waiting node from its bucket."""
    heads, after, ahead = queue.heads, queue.after, queue.ahead
    one, other = ahead[node], after[node]
    if one >= 0:
        after[one] = other
    else:
        heads[-1 - one] = other
    if other >= 0:
        ahead[other] = one
    ahead[node] = _OUT
