"""A query that evaluates edges where it needs them gives the result with all edges."""

import functools

import numpy as np
import pytest

from hdsp.abstract import BlockwiseCosts, FlatCosts, ManualCosts
from hdsp.abstract.abstract_costs import close_states
from hdsp.base.gradual import finished
from hdsp.detailed.search.outcome import Status
from hdsp.planning.heuristics import AbstractHeuristic
from hdsp.planning.heuristics.goal_sources import goal_sources
from hdsp.planning.heuristics.known_edges import DOUBT, ORDER, _prices
from hdsp.planning.planner import Planner
from hdsp.robot.lattice import ABSTRACT_HEADINGS, N_ABSTRACT_ACTIONS, abstract_shape
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import random_map
from tests import naive_abstract

MOMARO = Robot.load("momaro")
CELLS = 120


class Expensive(ManualCosts):
    """Manual costs with random factors and errors, which depend on the state alone; evaluated block by block."""

    block = 3

    def __init__(self, seed=0, share=0.1):
        super().__init__(MOMARO)
        random, shape = np.random.default_rng(seed), (ABSTRACT_HEADINGS, CELLS // 4, CELLS // 4, N_ABSTRACT_ACTIONS)
        self._factor = random.uniform(0.8, 1.3, shape).astype(np.float32)
        self._factor[random.random(shape) < share] = np.inf
        self.least, self.asked = 0.9 * FlatCosts(MOMARO).edge_table, 0

    def edges(self, height_map, region=None, mask=None):
        first_x, first_y, end_x, end_y = region or (0, 0, *abstract_shape(height_map.shape))
        found = manual_edges(height_map)[:, first_x:end_x, first_y:end_y].copy()
        close_states(found, mask)
        self.asked += int(np.sum(mask))
        return found * self._factor[:, first_x:end_x, first_y:end_y]


@functools.cache
def manual_edges(height_map):
    """Manual costs of all edges; to compute them block by block would take minutes."""
    return ManualCosts(MOMARO).edges(height_map)


@pytest.fixture(scope="module")
def terrain():
    heights = random_map(1007, "cuboid_2", 5, cells=CELLS).heights.copy()
    heights[70:90, 20:60] += 0.15
    return HeightMap(heights)


def poses(planner, random, count):
    """World poses at which the robot can stand."""
    found = []
    while len(found) < count:
        pose = (*random.uniform(0.5, 2.5, 2), random.uniform(-3, 3))
        if planner.can_leave(pose):
            found.append(pose)
    return found


def same(plan, other):
    np.testing.assert_array_equal(plan.states, other.states)
    assert (plan.status, plan.cost, plan.stats.expansions) == (other.status, other.cost, other.stats.expansions)


def test_plans_are_those_with_all_edges(terrain):
    prepared = Planner(terrain, MOMARO, Expensive()).prepare()
    states, shares = prepared.heuristic.costs.asked, []
    random = np.random.default_rng(3)
    ends = poses(prepared, random, 24)
    for start, goal in zip(ends[::2], ends[1::2], strict=True):
        lazy = Planner(terrain, MOMARO, Expensive())
        same(lazy.plan(start, goal, weight=1.25, polish=0.0, expansions=2000), prepared.plan(
            start, goal, weight=1.25, polish=0.0, expansions=2000))  # fmt: skip
        shares.append(lazy.heuristic.costs.asked / states)
    assert np.median(shares) < 0.5
    assert isinstance(Expensive(), BlockwiseCosts)


def test_edges_stay_for_the_next_goal_and_start(terrain):
    lazy, prepared = (Planner(terrain, MOMARO, Expensive(1)) for _ in range(2))
    prepared.prepare()
    random = np.random.default_rng(7)
    start, goal, other = poses(lazy, random, 3)
    lazy.plan(start, goal, weight=1.5, polish=0.0, expansions=3000)
    asked = lazy.heuristic.costs.asked
    lazy.plan(start, goal, weight=1.5, polish=0.0, expansions=3000)
    assert lazy.heuristic.costs.asked == asked
    options = {"weight": 1.5, "polish": 0.0, "expansions": 3000}
    for ends in ((other, goal), (start, [other, goal]), (goal, start)):
        same(lazy.plan(*ends, **options), prepared.plan(*ends, **options))
    assert lazy.heuristic.costs.asked <= prepared.heuristic.costs.asked


def test_anchored_and_anytime_plans_are_those_with_all_edges(terrain):
    lazy, prepared = (Planner(terrain, MOMARO, Expensive(2)) for _ in range(2))
    prepared.prepare()
    start, goal = poses(lazy, np.random.default_rng(6), 2)
    anchored = {"weight": 1.5, "anchor_weight": 2.0, "expansions": 3000}
    same(lazy.plan(start, goal, **anchored), prepared.plan(start, goal, **anchored))
    options = {"weights": (2.0, 1.25), "expansions": 3000, "polish": 0.0}
    for plan, other in zip(lazy.improve(start, goal, **options), prepared.improve(start, goal, **options), strict=True):
        same(plan, other)


def test_estimates_are_those_of_a_complete_search(terrain):
    planner = Planner(terrain, MOMARO, Expensive(3, share=0.4))
    start, goal = poses(planner, np.random.default_rng(7), 2)
    planner.plan(start, goal, weight=1.25, polish=0.0)
    states = np.array([planner.grid.to_lattice(pose) for pose in poses(planner, np.random.default_rng(8), 60)])
    lazy = planner.heuristic(states)
    complete = AbstractHeuristic(planner.world, terrain, Expensive(3, share=0.4))
    complete.set_goal(np.array(planner.grid.to_lattice(goal)))
    np.testing.assert_array_equal(lazy, complete(states))


def test_costs_to_go_are_those_of_ways_in_order_of_high_prices(terrain):
    heuristic = AbstractHeuristic(Planner(terrain, MOMARO).world, terrain, Expensive(4, share=0.5))
    goal = np.array([60, 60, 9, 0, 0, 0, 0])
    found = heuristic.set_goal(goal).to_go.values
    known, world = heuristic.known, heuristic.world
    feasible = heuristic.costs.edges(terrain, mask=known.standing)
    feasible = np.maximum(feasible, heuristic.costs.least[:, None, None].astype(np.float32))
    sources = goal_sources(world, known.standing, goal[None])
    ordered, counted = naive_abstract.ordered_costs(
        feasible, known.standing, _prices(world), ORDER / DOUBT, sources.states, sources.costs
    )
    expected = np.maximum(counted - sources.excess, 0.0).ravel()
    standing = known.standing.ravel()
    np.testing.assert_allclose(found[standing], expected[standing], rtol=1e-5)
    assert np.isfinite(found[standing]).mean() > 0.99 and np.isfinite(found[~standing]).any()
    assert (ordered[known.standing] > counted[known.standing] + 0.1).any()


def test_an_update_evaluates_only_what_a_query_needs_of_the_change(terrain):
    lazy = Planner(terrain, MOMARO, Expensive(5)).prepare()
    start, goal = poses(lazy, np.random.default_rng(9), 2)
    asked = lazy.heuristic.costs.asked
    heights = terrain.heights.copy()
    heights[56:62, 56:60] += 0.1
    after = HeightMap(heights, terrain.origin)
    lazy.update(after)
    assert lazy.heuristic.costs.asked == asked
    fresh = Planner(after, MOMARO, Expensive(5))
    same(lazy.plan(start, goal, weight=1.25, polish=0.0), fresh.plan(start, goal, weight=1.25, polish=0.0))
    np.testing.assert_array_equal(lazy.heuristic.known.standing, fresh.heuristic.known.standing)
    lazy.prepare()
    assert 0 < lazy.heuristic.costs.asked - asked < asked


def test_a_query_without_time_leaves_its_edges_to_the_next(terrain):
    planner = Planner(terrain, MOMARO, Expensive(6))
    start, goal = poses(planner, np.random.default_rng(10), 2)
    while planner.heuristic.evaluated == 0:
        assert planner.plan(start, goal, weight=1.25, polish=0.0, time=0.0).status == Status.TIME_LIMIT
    finished(planner.heuristic.known.evaluate_all())
    assert planner.heuristic.evaluated == 1.0
