"""Queries on large maps: few edges are evaluated, and ways, tables and plans are nearly those with all edges."""

import numpy as np
import pytest

from hdsp.abstract import PreparedGraph, guided
from hdsp.abstract.guided import DEARER
from hdsp.detailed.search.outcome import Status
from hdsp.planning import query as queries
from hdsp.planning.heuristics import abstract
from hdsp.planning.heuristics.corridor_steps import states_around
from hdsp.planning.heuristics.goal_sources import goal_sources
from hdsp.planning.planner import Planner
from hdsp.terrain.height_map import HeightMap
from tests.expensive_edges import MOMARO, Expensive, ground_with_a_step, poses, table

ROUNDS = 9  # more than any query here takes


class Dearer(Expensive):
    """Costs that exceed those of the guide after any round."""

    def __init__(self, seed=0, share=0.1):
        super().__init__(seed, share)
        random = np.random.default_rng(seed)
        factor = random.uniform((1 + DEARER) ** ROUNDS, 1.4, self._factor.shape).astype(np.float32)
        self._factor = np.where(np.isfinite(self._factor), factor, self._factor)


@pytest.fixture(scope="module")
def terrain():
    return ground_with_a_step()


@pytest.fixture(autouse=True)
def small_maps_are_large(monkeypatch):
    monkeypatch.setattr(abstract, "LARGE", 0)


def way_costs(planner, start, goal):
    """Cost of the cheapest way in the table of a query, and with all edges."""
    heuristic, found = planner.heuristic, table(planner, start, goal)
    begin, end = (np.array(planner.grid.to_lattice(pose)) for pose in (start, goal))
    standing = heuristic.known.standing
    sources = goal_sources(heuristic.world, standing, end[None])
    edges = np.maximum(heuristic.costs.edges(planner.terrain, mask=standing), heuristic.known.least[:, None, None])
    distances = PreparedGraph.from_edges(edges).distances(sources.states, sources.costs)
    x, y, k = states_around(begin, standing).T
    return found[k, x, y].min(), max(distances[k, x, y].min() - sources.excess, 0.0)


@pytest.mark.parametrize(("kind", "share"), [(Expensive, 0.1), (Dearer, 0.1), (Dearer, 0.4)])
def test_ways_cost_hardly_more_than_with_all_edges(terrain, kind, share):
    planner = Planner(terrain, MOMARO, kind(1, share))
    ends = poses(planner, np.random.default_rng(3), 6)
    for start, goal in zip(ends[::2], ends[1::2], strict=True):
        found, expected = way_costs(planner, start, goal)
        if kind is Dearer:
            assert found == pytest.approx(expected, rel=1e-5)
        else:  # the cheapest factor on costs of the guide is 0.8
            assert expected * (1 - 1e-5) <= found <= expected * (1 + DEARER) ** ROUNDS / 0.8


def test_costs_to_go_are_the_same_after_any_queries_and_updates(monkeypatch, terrain):
    monkeypatch.setattr(guided, "ENOUGH", 500)
    planner, heights = Planner(terrain, MOMARO, Expensive(2)), terrain.heights.copy()
    start, goal, other = poses(planner, np.random.default_rng(4), 3)
    expected = table(planner, start, goal)
    assert 0 < planner.heuristic.known.share < 0.5
    table(planner, other, goal)
    np.testing.assert_array_equal(table(planner, start, goal), expected)
    heights[100:106, 100:106] += 0.1
    changed = HeightMap(heights)
    planner.update(changed)
    np.testing.assert_array_equal(
        table(planner, start, goal), table(Planner(changed, MOMARO, Expensive(2)), start, goal)
    )


def test_prepared_edges_all_count(terrain):
    planner, fresh = (Planner(terrain, MOMARO, Dearer(1)) for _ in range(2))
    start, goal = poses(planner, np.random.default_rng(3), 2)
    table(planner, start, goal)
    assert 0 < planner.heuristic.known.share < 1
    for each in (planner, fresh):
        each.prepare()
    np.testing.assert_array_equal(planner.heuristic.graph.incoming, fresh.heuristic.graph.incoming)
    found, expected = way_costs(planner, start, goal)
    assert found == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("share", [0.9, 1.0])
def test_a_start_or_goal_that_is_cut_off(terrain, share):
    planner = Planner(terrain, MOMARO, Expensive(3, share))
    start, goal = poses(planner, np.random.default_rng(6), 2)
    found, expected = way_costs(planner, start, goal)
    assert found < np.inf and (expected < np.inf or share > 0.5)
    plan = planner.plan(start, goal, weight=2.0, polish=0.0, expansions=100_000)
    assert plan.status == Status.SOLVED
    assert planner.heuristic.known.share < 1


def test_a_long_search_evaluates_no_further_edges(monkeypatch, terrain):
    monkeypatch.setattr(queries, "TURN", 20)
    planner = Planner(terrain, MOMARO, Expensive(1))
    start, goal = poses(planner, np.random.default_rng(3), 2)
    table(planner, start, goal)
    before = planner.heuristic.known.share
    plan = planner.plan(start, goal, weight=1.25, polish=0.0)
    assert plan.stats.expansions > 20
    assert planner.heuristic.known.share == before < 1
