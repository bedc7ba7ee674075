"""Priority queue for Dijkstra's algorithm: nodes in buckets by cost, each bucket a doubly linked list."""

from typing import NamedTuple

import numpy as np

from hdsp.base.bucket_links import OUT, link, unlink
from hdsp.base.jit import njit


class BucketQueue(NamedTuple):
    """Waiting nodes.

    Attributes:
        width: cost range per bucket.
        heads: int32 [buckets], first node, -1 = none.
        after: int32 [nodes], next node in the bucket, -1 = none.
        ahead: int32 [nodes], previous node; -1 - b for the first node in bucket b; OUT for a node outside the queue.
    """

    width: float
    heads: np.ndarray
    after: np.ndarray
    ahead: np.ndarray


def new_bucket_queue(width: float, most: float, nodes: int) -> BucketQueue:
    """Creates an empty queue for ``nodes`` nodes at costs from 0 to ``most``."""
    heads = np.full(int(most / width) + 2, -1, dtype=np.int32)
    return BucketQueue(width, heads, np.empty(nodes, dtype=np.int32), np.full(nodes, OUT, dtype=np.int32))


@njit(inline="always")
def put(queue, node, cost):
    """Adds a node at a cost; a waiting node leaves its former bucket."""
    if waits(queue, node):
        take(queue, node)
    link(queue.heads, queue.after, queue.ahead, node, int(cost / queue.width))


@njit(inline="always")
def waits(queue, node):
    """Whether a node waits."""
    return queue.ahead[node] != OUT


@njit(inline="always")
def take(queue, node):
    """Removes a waiting node from its bucket."""
    unlink(queue.heads, queue.after, queue.ahead, node)
