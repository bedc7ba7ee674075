"""A query that evaluates edges where it needs them gives the result with all edges."""

import threading

import numpy as np
import pytest

from hdsp.abstract import BoundedCosts, PreparedGraph
from hdsp.abstract import corridor as corridors
from hdsp.base.gradual import finished
from hdsp.detailed.search.outcome import Status
from hdsp.planning import query as queries
from hdsp.planning.heuristics import AbstractHeuristic, corridor_steps, known_edges
from hdsp.planning.heuristics.corridor_steps import DOUBT
from hdsp.planning.heuristics.goal_sources import goal_sources
from hdsp.planning.planner import Planner
from hdsp.robot.lattice import (
    ABSTRACT_ACTIONS,
    surrounding_abstract,
)
from hdsp.terrain.height_map import HeightMap
from tests.expensive_edges import MOMARO, Expensive, ground_with_a_step, poses, table
from tests.naive_abstract import corridor, costs_around, least_costs_from


@pytest.fixture(scope="module")
def terrain():
    return ground_with_a_step()


def same(plan, other):
    np.testing.assert_array_equal(plan.states, other.states)
    assert (plan.status, plan.cost, plan.stats.expansions) == (other.status, other.cost, other.stats.expansions)


@pytest.mark.parametrize(("share", "most"), [(0.1, 1000), (0.4, 1000), (0.4, 10_000), (0.7, 10_000)])
def test_costs_to_go_are_those_with_all_edges_after_any_queries(monkeypatch, terrain, share, most):
    monkeypatch.setattr(corridors, "MOST", most)
    lazy, prepared = (Planner(terrain, MOMARO, Expensive(1, share)) for _ in range(2))
    prepared.prepare()
    random, shares = np.random.default_rng(3), []
    ends = poses(prepared, random, 8)
    for start, goal in zip(ends[::2], ends[1::2], strict=True):
        new = Planner(terrain, MOMARO, Expensive(1, share))
        expected = table(prepared, start, goal)
        np.testing.assert_array_equal(table(new, start, goal), expected)
        np.testing.assert_array_equal(table(lazy, start, goal), expected)
        np.testing.assert_array_equal(table(lazy, goal, start), table(prepared, goal, start))
        shares.append(new.heuristic.known.share)
    assert lazy.heuristic.known.evaluated.sum() == lazy.heuristic.costs.asked <= prepared.heuristic.costs.asked
    if most == 1000:
        assert np.median(shares) < 0.5
    assert isinstance(Expensive(), BoundedCosts)


@pytest.mark.parametrize(("share", "most"), [(0.1, 1000), (0.4, 10_000)])
def test_costs_to_go_equal_their_twin(monkeypatch, terrain, share, most):
    monkeypatch.setattr(corridors, "MOST", most)
    planner = Planner(terrain, MOMARO, Expensive(2, share))
    start, goal = poses(planner, np.random.default_rng(4), 2)
    found = table(planner, start, goal)
    heuristic, known = planner.heuristic, planner.heuristic.known
    standing, least = known.standing, known.least
    edges = heuristic.costs.edges(terrain, mask=standing)
    edges = np.maximum(edges, least[:, None, None])
    edges[~standing] = np.inf
    begin, end = (np.array(planner.grid.to_lattice(pose)) for pose in (start, goal))
    sources = goal_sources(heuristic.world, standing, end[None])
    around, shares = surrounding_abstract(begin[None])
    starts = [(x, y, k) for x, y, k in around[0][shares[0] > 0].tolist() if standing[k, x, y]]
    behind = least_costs_from(standing, least, starts)
    distances = PreparedGraph.from_edges(edges).distances(sources.states, sources.costs)
    widths = corridors.NARROW, corridors.WIDE, most
    inside, limit = corridor(distances, behind, *widths, corridors.NEAR, DOUBT)
    expected = costs_around(inside, behind, limit, edges, standing, least, heuristic._prices(), sources.excess)
    assert 20 < len(inside) < len(expected) <= np.isfinite(found).sum()
    whole = np.full(found.shape, np.inf)
    for (x, y, k), cost in expected.items():
        whole[k, x, y] = cost
    np.testing.assert_array_equal(found, whole.astype(np.float32))


def test_plans_are_those_with_all_edges(terrain):
    lazy, prepared = (Planner(terrain, MOMARO, Expensive(4)) for _ in range(2))
    prepared.prepare()
    start, other, goal = poses(lazy, np.random.default_rng(6), 3)
    for options in ({"weight": 1.25}, {"weight": 1.5, "anchor_weight": 2.0}, {"weight": 1.5, "tolerance": 0.2}):
        options |= {"expansions": 3000}
        same(lazy.plan(start, goal, **options), prepared.plan(start, goal, **options))
    same(lazy.plan(start, [other, goal], weight=1.5), prepared.plan(start, [other, goal], weight=1.5))
    options = {"weights": (2.0, 1.25), "expansions": 3000, "polish": 0.0}
    for plan, twin in zip(lazy.improve(start, goal, **options), prepared.improve(start, goal, **options), strict=True):
        same(plan, twin)
    asked = lazy.heuristic.costs.asked
    lazy.plan(start, goal, weight=2.0)
    assert lazy.heuristic.costs.asked == asked < prepared.heuristic.costs.asked


def test_an_update_evaluates_only_what_a_query_needs_of_the_change(terrain):
    lazy = Planner(terrain, MOMARO, Expensive(5)).prepare()
    start, goal = poses(lazy, np.random.default_rng(9), 2)
    asked = lazy.heuristic.costs.asked
    for height in (0.1, 0.3):
        heights = lazy.terrain.heights.copy()
        heights[56:62, 56:60] += height
        after = HeightMap(heights, terrain.origin)
        lazy.update(after)
        assert lazy.heuristic.costs.asked == asked
        fresh = Planner(after, MOMARO, Expensive(5))
        np.testing.assert_array_equal(table(lazy, start, goal), table(fresh, start, goal))
        np.testing.assert_array_equal(table(lazy, goal, start), table(fresh, goal, start))
        assert lazy.heuristic.costs.asked - asked < asked / 2
        asked = lazy.heuristic.costs.asked
    np.testing.assert_array_equal(lazy.heuristic.graph.incoming, fresh.heuristic.graph.incoming)
    assert asked < lazy.heuristic.costs.asked


def test_a_start_without_an_abstract_way_asks_for_all_edges(monkeypatch, terrain):
    monkeypatch.setattr(corridor_steps, "NEAR", 0.0)  # the goal is near the start
    planner = Planner(terrain, MOMARO, Expensive(6, share=1.0))
    start, goal = poses(planner, np.random.default_rng(10), 2)
    lattice = [np.array(planner.grid.to_lattice(pose)) for pose in (start, goal)]
    values = finished(planner.heuristic.steps_from(lattice[0], lattice[1][None])).to_go.values
    whole = AbstractHeuristic(planner.world, planner.terrain, Expensive(6, share=1.0)).set_goal(lattice[1])
    np.testing.assert_array_equal(values, whole.to_go.values)
    assert planner.heuristic.known.share == 1


def test_edges_of_parts_are_those_of_the_map(monkeypatch, terrain):
    whole, parts = (Planner(terrain, MOMARO, Expensive(7)) for _ in range(2))
    whole.prepare()
    monkeypatch.setattr(known_edges, "PART", 16 * 30 * 7)
    parts.prepare()
    np.testing.assert_array_equal(parts.heuristic.graph.incoming, whole.heuristic.graph.incoming)
    assert parts.heuristic.known.share == 1


class CutOff(Expensive):
    """No action leads into the abstract cells around one cell."""

    cell = (0, 0)

    def edges(self, height_map, region=None, mask=None):
        found = super().edges(height_map, region, mask)
        first_x, first_y, _, _ = region or (0, 0, 0, 0)
        x, y = (np.arange(n) + first for n, first in zip(found.shape[1:3], (first_x, first_y), strict=True))
        for action, (dx, dy, _) in enumerate(ABSTRACT_ACTIONS.tolist()):
            near_x, near_y = (abs(at + by - c) <= 1 for at, by, c in zip((x, y), (dx, dy), self.cell, strict=True))
            found[:, near_x[:, None] & near_y, action] = np.inf
        return found


def test_a_goal_that_the_abstraction_cuts_off_is_approached(terrain):
    lazy, prepared = (Planner(terrain, MOMARO, CutOff(6)) for _ in range(2))
    start, goal = poses(lazy, np.random.default_rng(12), 2)
    lattice = np.array(lazy.grid.to_lattice(goal))
    lazy.heuristic.costs.cell = prepared.heuristic.costs.cell = tuple((lattice[:2] // 4).tolist())
    prepared.prepare()
    found = table(lazy, start, goal)
    np.testing.assert_array_equal(found, table(prepared, start, goal))
    assert lazy.heuristic.known.share < 1
    x, y, heading = np.array(lazy.grid.to_lattice(start))[:3] // 4
    assert np.isfinite(found[heading, x, y])


def test_a_query_without_time_leaves_its_edges_to_the_next(terrain):
    planner = Planner(terrain, MOMARO, Expensive(7))
    start, goal = poses(planner, np.random.default_rng(11), 2)
    for _ in range(10_000):
        plan = planner.plan(start, goal, weight=1.25, time=1e-9)
        if planner.heuristic._known is not None and planner.heuristic.known.share > 0:
            break
    assert plan.status == Status.TIME_LIMIT
    asked = planner.heuristic.costs.asked
    assert planner.plan(start, goal, weight=1.25).solved
    assert planner.heuristic.known.evaluated.sum() == planner.heuristic.costs.asked >= asked > 0


def test_queries_at_the_same_time_give_the_same_costs_to_go(terrain):
    planner = Planner(terrain, MOMARO, Expensive(8))
    ends = poses(planner, np.random.default_rng(12), 8)
    pairs = list(zip(ends[::2], ends[1::2], strict=True))
    found = {}
    threads = [threading.Thread(target=lambda pair=pair: found.update({pair: table(planner, *pair)})) for pair in pairs]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    prepared = Planner(terrain, MOMARO, Expensive(8)).prepare()
    for pair in pairs:
        np.testing.assert_array_equal(found[pair], table(prepared, *pair))


def test_long_turns_have_costs_to_go_of_the_whole_map(monkeypatch, terrain):
    lazy = Planner(terrain, MOMARO, Expensive(4))
    start, _, goal = poses(lazy, np.random.default_rng(6), 3)
    first = lazy.plan(start, goal, weight=1.25, polish=0.0)
    assert first.solved and lazy.heuristic.known.share < 1
    monkeypatch.setattr(queries, "TURN", first.stats.expansions // 4)
    monkeypatch.setattr(queries, "LONG", first.stats.expansions)
    short = lazy.plan(start, goal, weight=1.25, polish=0.0, expansions=first.stats.expansions // 2)
    assert short.status == Status.EXPANSION_LIMIT and lazy.heuristic.known.share < 1
    monkeypatch.setattr(queries, "LONG", first.stats.expansions // 4)
    monkeypatch.setattr(lazy.heuristic, "others", lambda: ())
    again = lazy.plan(start, goal, weight=1.25, polish=0.0)
    assert again.solved and lazy.heuristic.known.share == 1
    assert again.stats.heuristic_seconds > 0
