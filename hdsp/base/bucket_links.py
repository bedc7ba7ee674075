"""Buckets as doubly linked lists in arrays, for kernels: a node moves between buckets in constant time.

Three int32 arrays hold all buckets: ``heads`` [buckets], the first node in a bucket, -1 = none; ``after`` [nodes], the
next node in the same bucket, -1 = none; ``ahead`` [nodes], the previous node, -1 - bucket for a first node, `OUT` for a
node outside all buckets.
"""

import numpy as np

from hdsp.base.jit import njit

OUT = np.int32(-(2**31))


@njit(inline="always")
def link(heads, after, ahead, node, bucket):
    """Puts a node, outside all buckets so far, first into a bucket."""
    second = heads[bucket]
    heads[bucket], after[node], ahead[node] = node, second, -1 - bucket
    if second >= 0:
        ahead[second] = node


@njit(inline="always")
def unlink(heads, after, ahead, node):
    """Removes a node from its bucket."""
    one, other = ahead[node], after[node]
    if one >= 0:
        after[one] = other
    else:
        heads[-1 - one] = other
    if other >= 0:
        ahead[other] = one
    ahead[node] = OUT
