"""Hard searches also take the grid heuristic's value."""

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from hdsp import HeightMap, Planner, Status
from hdsp.detailed.search.estimate import grid_estimate
from hdsp.detailed.search.weighted_astar import solve
from hdsp.planning import polish, query
from hdsp.terrain.random_arenas import random_arena
from hdsp.terrain.scenes import CATEGORIES
from tests.detailed.instances import small_map, toy, valid_states
from tests.naive import Naive
from tests.planning.test_bounds import Exaggerating

#: The manual heuristic leads a search into clutter, and takes a goal for reachable.
THROUGH_CLUTTER = (1.52, 3.14, -1.94), (1.58, 1.84, -0.93)
OUT_OF_REACH = (2.84, 4.17, -3.08), (1.62, 1.88, 1.77)
ALONE = 10**9


@pytest.fixture(scope="module")
def planner():
    return Planner(random_arena(1000, 6.0), heuristic="manual", conditioning=None)


def test_a_hard_search_takes_a_fraction_of_the_expansions_and_proves_more(planner, monkeypatch):
    plans = []
    for hard in (ALONE, 1000):
        monkeypatch.setattr(query, "HARD", hard)
        monkeypatch.setattr(polish, "HARD", hard)
        plans.append(planner.plan(*THROUGH_CLUTTER, 1.25))
    alone, guided = plans
    assert 1000 <= guided.stats.expansions < 0.2 * alone.stats.expansions
    assert guided.cost < 1.05 * alone.cost and guided.bound < alone.bound - 0.1


def test_a_goal_out_of_reach_is_proved_as_soon_as_the_grid_heuristic_counts(planner, monkeypatch):
    for hard in (ALONE, 500):
        monkeypatch.setattr(query, "HARD", hard)
        plan = planner.plan(*OUT_OF_REACH, 1.25, expansions=300_000)
        assert plan.status == Status.INFEASIBLE
        assert (plan.stats.expansions == 500) == (hard == 500)


def test_easy_searches_do_not_ask(planner, monkeypatch):
    easy = (4.83, 3.0, 1.31), (4.5, 2.6, 1.3)
    plan = planner.plan(*easy, 1.25, polish=0)
    assert 0 < plan.stats.expansions < query.HARD
    monkeypatch.setattr(query, "HARD", ALONE)
    assert planner.plan(*easy, 1.25, polish=0).stats.expansions == plan.stats.expansions


@settings(max_examples=20, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.sampled_from(CATEGORIES), st.integers(0, 10_000), st.integers(0, 1000), st.sampled_from([1, 20, 200]))
def test_a_guide_is_the_greater_estimate_and_loses_no_plan(category, number, seed, after):
    heights, robot = small_map(category, number, 16), toy()
    states = valid_states(Naive(heights, robot), np.random.default_rng(seed), 25)
    assume(len(states) > 1)
    planner = Planner(HeightMap(heights), robot, conditioning=None)
    start, goal = states[0], states[-1:]
    guess = Exaggerating(planner.world).set_goal(goal[0])

    def found(heuristic, **guide):
        return solve(planner.world, start, goal, heuristic, weight=1.5, admissible=False, reopen=False, **guide)

    def lower():
        return grid_estimate(planner.world, goal, None, 1 << 20)

    alone, both = found(guess), found(guess._replace(back=lower().back))
    guided, later = found(guess, guide=lower(), guide_from=0), found(guess, guide=lower(), guide_from=after)
    assert guided.status == both.status and guided.expansions == both.expansions
    np.testing.assert_array_equal(guided.cost, both.cost)
    assert alone.status == both.status == later.status
    if alone.expansions <= after:
        np.testing.assert_array_equal(later.cost, alone.cost)
