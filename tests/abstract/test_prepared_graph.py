import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.dijkstra import reversed_csr
from hdsp.abstract import PreparedGraph, cost_to_go
from hdsp.abstract.prepared_graph import enter_least
from hdsp.base.errors import InputError
from hdsp.robot.lattice import ABSTRACT_ACTIONS
from tests import naive_abstract


def random_edges(seed, nx, ny, blocked=0.3, spread=1.0, free=0.0):
    """Random edges with shares of infeasible and free ones; a large `spread` makes costs differ more."""
    rng = np.random.default_rng(seed)
    edges = (rng.uniform(0.01, 1.0, (16, nx, ny, 22)) ** spread).astype(np.float32)
    edges[rng.random(edges.shape) < free] = 0.0
    edges[rng.random(edges.shape) < blocked] = np.inf
    return edges


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 6), st.integers(1, 6)),
    blocked=st.sampled_from([0.0, 0.3, 0.8, 0.95]),
    spread=st.sampled_from([1.0, 3.0, 8.0]),
    free=st.sampled_from([0.0, 0.1]),
    data=st.data(),
)
def test_equals_the_textbook(seed, shape, blocked, spread, free, data):
    edges = random_edges(seed, *shape, blocked=blocked, spread=spread, free=free)
    goal = tuple(data.draw(st.integers(0, size - 1)) for size in (*shape, 16))
    expected = naive_abstract.cost_to_go(edges, goal)
    np.testing.assert_array_equal(cost_to_go(edges, goal), expected.astype(np.float32))


@pytest.mark.parametrize("n", [2, 90])
def test_costs_to_several_goals_are_the_least_of_those_to_each(n):
    rng = np.random.default_rng(n)
    graph = PreparedGraph.from_edges(random_edges(1, 5, 4, blocked=0.8))
    goals = np.column_stack([rng.integers(0, size, n) for size in (5, 4, 16)])
    single = np.min([graph.distances(tuple(goal)) for goal in goals.tolist()], axis=0)
    np.testing.assert_array_equal(graph.distances(goals), single)


@pytest.mark.parametrize("spread", [1.0, 30.0])
def test_equals_scipy_on_a_larger_map(spread):
    from scipy.sparse.csgraph import dijkstra

    edges = random_edges(7, 31, 24, spread=spread)
    goal = (11, 5, 3)
    expected = dijkstra(reversed_csr(edges), indices=(3 * 31 + 11) * 24 + 5).reshape(16, 31, 24)
    np.testing.assert_array_equal(cost_to_go(edges, goal), expected.astype(np.float32))


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 6), st.integers(1, 6)),
    blocked=st.sampled_from([0.5, 0.9, 0.97]),
    data=st.data(),
)
def test_half_of_an_action_remains_where_it_passes_over_a_state_without_a_way(seed, shape, blocked, data):
    edges = random_edges(seed, *shape, blocked=blocked)
    edges[np.random.default_rng(seed).random(edges.shape[:3]) < 0.3] = np.inf
    goal = tuple(data.draw(st.integers(0, size - 1)) for size in (*shape, 16))
    graph = PreparedGraph.from_edges(edges)
    distances = graph.distances(goal)
    expected = naive_abstract.bridged(edges, distances)
    np.testing.assert_allclose(graph.bridged(distances), expected, rtol=1e-6)
    assert (expected[np.isfinite(distances)] == distances[np.isfinite(distances)]).all()


def test_an_action_over_two_cells_passes_over_the_one_between():
    edges = np.full((16, 5, 4, 22), np.inf, np.float32)
    far = 8
    edges[2, 1, 2, far] = 0.5
    assert tuple(ABSTRACT_ACTIONS[far]) == (2, 0, 0)
    graph = PreparedGraph.from_edges(edges)
    bridged = graph.bridged(graph.distances((3, 2, 2)))
    assert bridged[2, 1, 2] == 0.5 and bridged[2, 2, 2] == 0.25 and bridged[2, 3, 2] == 0.0
    assert np.isfinite(bridged).sum() == 3


def test_follows_actions_forwards_from_the_start():
    edges = np.full((16, 5, 4, 22), np.inf, np.float32)
    ahead = 0
    edges[2, 1, 2, ahead] = 0.25  # the only feasible action: from (1, 2) to (2, 2) with heading 2
    assert tuple(ABSTRACT_ACTIONS[ahead]) == (1, 0, 0)
    distance = cost_to_go(edges, (2, 2, 2))
    assert distance[2, 1, 2] == 0.25
    assert np.isinf(cost_to_go(edges, (1, 2, 2))[2, 2, 2])
    assert np.isfinite(distance).sum() == 2


def test_headings_are_a_circle():
    edges = np.full((16, 1, 1, 22), np.inf, np.float32)
    edges[:, 0, 0, 20] = 1.0  # only counter-clockwise turns
    np.testing.assert_array_equal(cost_to_go(edges, (0, 0, 0))[:, 0, 0], [0, *range(15, 0, -1)])
    edges[:, 0, 0, 21] = 1.0
    np.testing.assert_array_equal(cost_to_go(edges, (0, 0, 0))[:, 0, 0], [min(k, 16 - k) for k in range(16)])


def test_a_prepared_graph_serves_many_goals():
    edges = random_edges(3, 6, 5)
    graph = PreparedGraph.from_edges(edges)
    assert graph.shape == (6, 5)
    for goal in [(0, 0, 0), (5, 4, 15), (3, 2, 7)]:
        np.testing.assert_array_equal(graph.cost_to_go(goal), cost_to_go(edges, goal))


def test_a_map_without_feasible_edges_is_infinite_but_for_the_goal():
    distance = cost_to_go(np.full((16, 3, 4, 22), np.inf, np.float32), (1, 2, 3))
    assert distance[3, 1, 2] == 0
    assert np.isinf(distance).sum() == distance.size - 1


@pytest.mark.parametrize("bad", [-0.5, np.nan])
def test_refuses_costs_that_are_no_costs(bad):
    edges = random_edges(1, 3, 3)
    edges[4, 1, 1, 3] = bad
    with pytest.raises(InputError, match="cost"):
        cost_to_go(edges, (0, 0, 0))


def test_refuses_a_wrong_shape_and_a_goal_outside():
    with pytest.raises(InputError, match="shape"):
        cost_to_go(np.ones((8, 3, 3, 22), np.float32), (0, 0, 0))
    with pytest.raises(InputError, match="outside the map"):
        cost_to_go(np.ones((16, 3, 3, 22), np.float32), (0, 3, 0))


def test_a_search_that_outgrows_its_queue_goes_on(monkeypatch):
    from hdsp.abstract import dijkstra

    grown = []
    more_room = dijkstra.BucketRing.with_more_room
    monkeypatch.setattr(dijkstra.BucketRing, "with_more_room", lambda queue: grown.append(1) or more_room(queue))
    edges = np.full((16, 40, 9, 22), 0.5, np.float32)  # equal costs: whole wave fronts share a bucket
    edges[0, 0, 0, 0] = 120.0  # one expensive edge: many buckets, each with little space
    expected = naive_abstract.cost_to_go(edges, (20, 4, 2)).astype(np.float32)
    np.testing.assert_array_equal(cost_to_go(edges, (20, 4, 2)), expected)
    assert grown


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 6), st.integers(1, 6)),
    blocked=st.sampled_from([0.0, 0.3, 0.8, 0.95]),
    free=st.sampled_from([0.0, 0.1]),
    share=st.sampled_from([0.0, 0.02, 0.3, 1.0]),
    fewest=st.sampled_from([1, 4, 16]),  # total number of states per repairable state
    data=st.data(),
)
def test_repaired_distances_are_those_of_the_changed_graph(seed, shape, blocked, free, share, fewest, data):
    edges = random_edges(seed, *shape, blocked=blocked, free=free)
    # Few distinct costs give many ties: a state's cost then has several possible paths.
    edges = (np.ceil(edges * data.draw(st.sampled_from([4, 1000]))) / 8).astype(np.float32)
    rng = np.random.default_rng(seed + 1)
    changed = edges.copy()
    states = np.argwhere(rng.random(edges.shape[:3]) < share)
    some = rng.random((len(states), 22)) < 0.5
    new = rng.choice(edges[np.isfinite(edges)], some.shape) if np.isfinite(edges).any() else np.ones(some.shape)
    new[rng.random(some.shape) < blocked] = np.inf
    changed[tuple(states.T)] = np.where(some, new, changed[tuple(states.T)])
    goal = tuple(data.draw(st.integers(0, size - 1)) for size in (*shape, 16))

    before = PreparedGraph.from_edges(edges)
    after = before.with_edges(states, changed[tuple(states.T)])
    expected = PreparedGraph.from_edges(changed)
    np.testing.assert_array_equal(after.incoming, expected.incoming)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hdsp.abstract.prepared_graph.REPAIRED_SHARE", fewest)
        repaired = after.repaired(before.distances(goal), goal, states)
    np.testing.assert_array_equal(repaired, expected.distances(goal))


def test_a_wall_in_a_large_map_is_repaired():
    edges = random_edges(2, 60, 50, blocked=0.1)
    before = PreparedGraph.from_edges(edges)
    goal = (5, 5, 0)
    states = np.argwhere(np.ones((16, 60, 50), bool))
    wall = states[(states[:, 1] >= 30) & (states[:, 1] < 32) & (states[:, 2] > 3)]
    edges[tuple(wall.T)] = np.inf
    after = before.with_edges(wall, np.full((len(wall), 22), np.inf, np.float32))
    repaired = after.repaired(before.distances(goal), goal, wall)
    np.testing.assert_array_equal(repaired, PreparedGraph.from_edges(edges).distances(goal))
    assert np.isinf(repaired[tuple(wall.T)]).all()


def test_refuses_changed_costs_that_are_no_costs():
    graph = PreparedGraph.from_edges(random_edges(1, 3, 3))
    with pytest.raises(InputError, match=r"cost -1\.0"):
        graph.with_edges(np.array([[0, 1, 1]]), np.full((1, 22), -1.0))


@pytest.mark.parametrize("shape", [(5, 6), (2, 3), (1, 1)])
def test_least_costs_are_entered_beside_known_edges(shape):
    random = np.random.default_rng(4)
    bounded, kept = random.random((16, *shape)) < 0.7, random.random((16, *shape)) < 0.3
    least = random.uniform(0.1, 1.0, (16, 22)).astype(np.float32)
    edges = random_edges(5, *shape)
    expected = np.where(bounded[..., None], least[:, None, None], np.float32(np.inf))
    expected = PreparedGraph.from_edges(np.where(kept[..., None], edges, expected)).incoming
    incoming = PreparedGraph.from_edges(np.where(kept[..., None], edges, np.float32(7.0))).incoming
    for heading in range(16):
        enter_least(incoming, heading, bounded, kept, least, ABSTRACT_ACTIONS)
    np.testing.assert_array_equal(incoming, expected)
