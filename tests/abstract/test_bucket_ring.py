"""The ring of buckets behind costs-to-go: against the textbook, wherever the search stops in between."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hdsp.abstract.dijkstra import DONE, FULL, PAUSED, BucketRing, bucket_sizes, search
from hdsp.abstract.prepared_graph import PreparedGraph
from tests import naive_abstract

ALL = 10**9  # entries


def random_edges(seed, shape, blocked, costs):
    """Edges with a share of infeasible ones, and few distinct costs."""
    rng = np.random.default_rng(seed)
    edges = rng.choice(np.array(costs, np.float32), (16, *shape, 22))
    edges[rng.random(edges.shape) < blocked] = np.inf
    return edges


def searched(edges, goals, costs, most=ALL, room=None):
    """Costs to goals (ix, iy, heading) with initial costs, the codes of all calls of the search, and its queue at last.

    A ring begins with ``room`` entries per bucket, if given.
    """
    graph = PreparedGraph.from_edges(edges)
    (nx, ny), margin, costs = graph.shape, graph._margin, np.array(costs, float)
    width, buckets = bucket_sizes(graph.cheapest, max(graph.most_expensive, costs.max()))
    flat = np.array([(heading * nx + ix) * ny + iy for ix, iy, heading in goals])
    queue = BucketRing.starting_at(flat, costs, 1 / width, 16 * nx * ny, margin, buckets)
    assert queue.entries.shape[1] > 22 and queue.entries.size <= 2 * 16 * nx * ny + buckets * (2 * 22 + len(goals))
    if room is not None:
        queue = queue._replace(entries=queue.entries[:, :room].copy())
    ends = []
    while not ends or ends[-1] != DONE:
        ends.append(search(graph.incoming.reshape(-1), graph._offsets, queue, margin, 1 / width, most))
        assert queue.filled.max() <= queue.entries.shape[1]
        if ends[-1] == FULL:
            assert queue.filled.max() + 22 > queue.entries.shape[1], "it had room"
            queue = queue.with_more_room()
    outside = np.ones(len(queue.distance), bool)
    outside[margin : len(outside) - margin] = False
    assert np.isinf(queue.distance[outside]).all() and not queue.filled.any()
    np.testing.assert_array_equal(queue.visited, np.isfinite(queue.distance))
    return queue.distance[~outside].reshape(16, nx, ny), ends, queue


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 4), st.integers(1, 4)),
    blocked=st.sampled_from([0.0, 0.3, 0.8]),
    costs=st.sampled_from([(0.5, 0.75, 3.0), (0.0, 0.125, 1.0), (2.0,), (0.001, 0.9, 40.0)]),
    initial=st.lists(st.sampled_from([0.0, 0.25, 1.5, 30.0]), min_size=1, max_size=3),
    most=st.sampled_from([1, 5, ALL]),
    room=st.sampled_from([None, 22, 30]),
    data=st.data(),
)
def test_stops_and_growth_change_no_distance(seed, shape, blocked, costs, initial, most, room, data):
    edges = random_edges(seed, shape, blocked, costs)
    pose = st.tuples(*(st.integers(0, size - 1) for size in (*shape, 16)))
    goals = data.draw(st.lists(pose, min_size=len(initial), max_size=len(initial), unique=True))
    found, ends, _ = searched(edges, goals, initial, most, room)
    each = [naive_abstract.cost_to_go(edges, goal) + cost for goal, cost in zip(goals, initial, strict=True)]
    np.testing.assert_allclose(found, np.min(each, axis=0), rtol=1e-12)
    assert (PAUSED in ends) <= (most < ALL)
    # Actions far cheaper than a bucket is wide may put all states of a map into one bucket, several times.
    width, _ = bucket_sizes(min(costs), max(*costs, *initial))
    assert room is not None or PAUSED in ends or min(costs) < width / 2 or len(ends) <= 2


@pytest.mark.parametrize("most", [1, 3, 15, 16, 17])
def test_a_search_stops_after_so_many_entries(most):
    edges = np.full((16, 1, 1, 22), np.inf, np.float32)
    edges[:, 0, 0, 20] = 1.0  # one turn after the other: each bucket holds one state
    found, ends, _ = searched(edges, [(0, 0, 0)], [0.0], most)
    np.testing.assert_array_equal(found[:, 0, 0], [0, *range(15, 0, -1)])
    assert ends == [PAUSED] * (16 // most) + [DONE]


def test_a_full_bucket_stops_the_search_and_twice_the_room_lets_it_go_on():
    edges = np.full((16, 5, 4, 22), 0.5, np.float32)
    for room in (22, 23, 60):
        found, ends, queue = searched(edges, [(2, 2, 5)], [0.0], room=room)
        np.testing.assert_array_equal(found, naive_abstract.cost_to_go(edges, (2, 2, 5)))
        assert ends[-1] == DONE and {*ends[:-1]} == {FULL}
        assert queue.entries.shape[1] == room * 2 ** (len(ends) - 1)


@pytest.mark.parametrize("seed", range(4))
def test_states_that_improve_after_their_visit_are_visited_again(seed):
    """Buckets are far wider than the cheap edges, so that most states of a bucket improve each other."""
    edges = random_edges(seed, (4, 4), 0.5, (0.001, 0.003, 0.004, 0.02))
    edges[3, 2, 2, 1] = 40.0
    found, _, _ = searched(edges, [(1, 1, 5)], [0.0])
    np.testing.assert_allclose(found, naive_abstract.cost_to_go(edges, (1, 1, 5)), rtol=1e-12)


@given(st.floats(1e-9, 1e3), st.floats(1, 1e9))
def test_a_ring_spans_the_dearest_edge_with_few_buckets(cheapest, spread):
    most = cheapest * spread
    width, buckets = bucket_sizes(cheapest, most)
    assert buckets & (buckets - 1) == 0 and buckets <= 256
    # A state of the present bucket reaches no bucket beyond the last one, also not by rounding.
    assert math.floor(most / width) + 2 <= buckets
    assert width < cheapest or buckets == 256, "states of one bucket can improve each other"
    assert buckets <= 4 * (most / width + 2)


@pytest.mark.parametrize("most", [0.0, -np.inf])
def test_free_edges_need_two_buckets(most):
    assert bucket_sizes(np.inf, most) == (1.0, 2)
