"""The band around the cheapest way, and graphs of mixed edges, equal their twins in plain Python."""

import numpy as np
import pytest

from hdsp.abstract import PreparedGraph, guided
from hdsp.abstract.prepared_graph import enter_edges
from hdsp.robot.lattice import ABSTRACT_ACTIONS, ABSTRACT_HEADINGS, N_ABSTRACT_ACTIONS
from tests.naive_abstract import band, shortest, ways

SHAPE = ABSTRACT_HEADINGS, 7, 8


def random_edges(random, feasible=0.6):
    costs = random.uniform(0.05, 0.4, (*SHAPE, N_ABSTRACT_ACTIONS)).astype(np.float32)
    return np.where(random.random(costs.shape) < feasible, costs, np.float32(np.inf))


def graph_of(mixed):
    return mixed.graph.distances(np.array([[5, 6, 3]]))


@pytest.mark.parametrize("enough", [1, 60, 10_000])
@pytest.mark.parametrize("seed", range(3))
def test_band_equals_its_twin(monkeypatch, enough, seed):
    monkeypatch.setattr(guided, "ENOUGH", enough)
    random = np.random.default_rng(seed)
    edges, starts = random_edges(random, 0.2), [(0, 0, 0), (1, 0, 0)]
    goals = {(5, 6, 3): 0.02, (6, 6, 3): 0.0}
    graph = PreparedGraph.from_edges(edges)
    distances = graph.distances(np.array(list(goals)), np.array(list(goals.values())))
    found = guided.find_band(graph, distances, np.array(starts))
    keys, limit = band(*ways(edges), starts, goals, guided.NEAREST, guided.FARTHEST, enough)
    inside = np.zeros(SHAPE, bool)
    for (x, y, k), key in keys.items():
        assert abs(key - limit) > 1e-9 or key == pytest.approx(limit)
        inside[k, x, y] = key <= limit + 1e-9
    np.testing.assert_array_equal(found.inside, inside)
    assert (found.around | ~found.inside).all() and 0 < inside.sum() < inside.size


def test_no_band_without_a_way():
    graph = PreparedGraph.from_edges(np.full((*SHAPE, N_ABSTRACT_ACTIONS), np.inf, np.float32))
    distances = graph.distances((5, 6, 3))
    assert guided.find_band(graph, distances, np.array([[0, 0, 0]])) is None


def test_mixed_edges_equal_their_twin():
    random = np.random.default_rng(5)
    guide, other = random_edges(random, 0.3), random_edges(random, 0.3)
    entered, open_states = random.random(SHAPE) < 0.5, random.random(SHAPE) < 0.7
    prices = random.uniform(1.0, 2.0, (ABSTRACT_HEADINGS, N_ABSTRACT_ACTIONS))
    mixed, of_other = guided.MixedEdges(PreparedGraph.from_edges(guide)), PreparedGraph.from_edges(other)
    mixed.raise_by(0.25)
    mixed.enter(of_other.incoming, entered, of_other.cheapest, of_other.most_expensive)

    def agrees(**options):
        expected = shortest(ways(guide, entered, other, 1.25, **options)[1], {(5, 6, 3): 0.0})
        found = graph_of(mixed)
        assert {(x, y, k) for k, x, y in np.argwhere(np.isfinite(found)).tolist()} == set(expected)
        for (x, y, k), cost in expected.items():
            assert found[k, x, y] == pytest.approx(cost, abs=1e-6)

    agrees()
    mixed.open(prices, open_states)
    agrees(open_states=open_states, prices=prices)


def test_edges_entered_by_parts_are_those_of_the_whole_map():
    random = np.random.default_rng(6)
    edges, states = random_edges(random), random.random(SHAPE) < 0.6
    least = np.full((ABSTRACT_HEADINGS, N_ABSTRACT_ACTIONS), 0.2, np.float32)
    expected = np.where(states[..., None], np.maximum(edges, np.float32(0.2)), np.float32(np.inf))
    incoming, extremes = np.full(edges.shape, np.inf, np.float32), []
    for first, end in ((0, 3), (3, 7)):
        part = np.ascontiguousarray(edges[:, first:end])
        found = enter_edges(incoming, part, states[:, first:end], np.array([first, 0]), least, ABSTRACT_ACTIONS)
        assert found[0] == 0
        extremes.append(found[1:])
    np.testing.assert_array_equal(incoming, PreparedGraph.from_edges(expected).incoming)
    finite = expected[np.isfinite(expected)]
    assert (min(low for low, _ in extremes), max(high for _, high in extremes)) == (finite.min(), finite.max())
    edges[:, 0], before = np.float32(-1.0), incoming.copy()
    assert enter_edges(incoming, edges, states, np.array([0, 0]), least, ABSTRACT_ACTIONS)[0] == -1
    np.testing.assert_array_equal(incoming, before)
