"""Nodes that move between buckets, against lists of lists."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hdsp.base.bucket_links import OUT, link, unlink

BUCKETS, NODES = 3, 6


def contents(heads: np.ndarray, after: np.ndarray, ahead: np.ndarray) -> list[list[int]]:
    """Nodes of each bucket in order; the links back are checked on the way."""
    found: list[list[int]] = []
    for bucket in range(BUCKETS):
        nodes, before = [], -1 - bucket
        node = heads[bucket]
        while node != -1:
            assert ahead[node] == before
            nodes.append(int(node))
            before, node = node, after[node]
        found.append(nodes)
    return found


@given(st.lists(st.tuples(st.integers(0, NODES - 1), st.integers(0, BUCKETS - 1))))
def test_nodes_move_as_between_lists(moves):
    heads = np.full(BUCKETS, -1, np.int32)
    after, ahead = np.zeros(NODES, np.int32), np.full(NODES, OUT)
    expected: list[list[int]] = [[] for _ in range(BUCKETS)]
    for node, bucket in moves:
        waiting = [nodes for nodes in expected if node in nodes]
        assert (ahead[node] != OUT) == bool(waiting)
        if waiting:
            unlink(heads, after, ahead, node)
            waiting[0].remove(node)
        else:
            link(heads, after, ahead, node, bucket)
            expected[bucket].insert(0, node)
        assert contents(heads, after, ahead) == expected
