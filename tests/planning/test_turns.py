"""Long searches in which several guides take turns."""

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from hdsp import HeightMap, Planner, Status
from hdsp.abstract import FlatCosts
from hdsp.detailed.search.life_cycle import GuideTurn
from hdsp.detailed.search.weighted_astar import solve
from hdsp.planning import query
from hdsp.planning.heuristics import AbstractHeuristic
from hdsp.robot.robot import Robot
from hdsp.terrain.scenes import CATEGORIES
from tests.detailed.instances import small_map, toy, valid_states
from tests.naive import Naive
from tests.planning.test_bounds import Exaggerating

MOMARO = Robot.load("momaro")
INTO_THE_BAG, BEHIND_IT = (1.5, 3.0, 0.0), (5.0, 3.0, 0.0)


class Blind(FlatCosts):
    """An abstraction without knowledge of obstacles."""


@pytest.fixture(scope="module")
def bag():
    """A bag of walls, open toward the start, with its end before the goal."""
    heights = np.zeros((240, 240), np.float32)
    heights[150:156, 60:180] = 1.0
    heights[90:150, [*range(60, 66), *range(174, 180)]] = 1.0
    return HeightMap(heights)


def test_the_manual_abstraction_leads_out_of_a_bag(bag, monkeypatch):
    alone = Planner(bag, conditioning=None)
    alone.heuristic = AbstractHeuristic(alone.world, bag, Blind(MOMARO))
    manual, turned = (Planner(bag, heuristic=costs, conditioning=None) for costs in ("manual", Blind(MOMARO)))
    monkeypatch.setattr(query, "TURN", 1000)
    monkeypatch.setattr(query, "HARD", 10**9)
    best, without, found = (each.plan(INTO_THE_BAG, BEHIND_IT, 1.25, polish=0.0) for each in (manual, alone, turned))
    assert without.solved and found.solved
    assert 1000 < found.stats.expansions < 0.5 * without.stats.expansions
    assert found.stats.expansions < 1000 + 4 * best.stats.expansions
    assert found.cost < 1.25 * best.cost
    limited = turned.plan(INTO_THE_BAG, BEHIND_IT, 1.25, polish=0.0, expansions=1000)
    assert limited.status == Status.EXPANSION_LIMIT and limited.stats.expansions == 1000


def test_the_second_abstraction_follows_changes_of_the_map(bag, monkeypatch):
    monkeypatch.setattr(query, "TURN", 1000)
    changed = HeightMap(np.where(bag.heights > 0, bag.heights[::-1], 0.0).astype(np.float32))
    planner, fresh = (Planner(each, heuristic=Blind(MOMARO), conditioning=None) for each in (bag, changed))
    planner.plan(INTO_THE_BAG, BEHIND_IT, 1.25, polish=0.0)
    plans = [each.plan(BEHIND_IT, INTO_THE_BAG, 1.25, polish=0.0) for each in (planner.update(changed), fresh)]
    assert plans[0].solved and plans[0].stats.expansions == plans[1].stats.expansions
    np.testing.assert_array_equal(plans[0].states, plans[1].states)


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.sampled_from(CATEGORIES), st.integers(0, 10_000), st.integers(0, 1000), st.sampled_from([1, 20, 200]))
def test_turns_lose_no_plan(category, number, seed, length):
    heights, robot = small_map(category, number, 16), toy()
    states = valid_states(Naive(heights, robot), np.random.default_rng(seed), 25)
    assume(len(states) > 1)
    planner = Planner(HeightMap(heights), robot, conditioning=None)
    start, goal = states[0], states[-1:]
    guesses = [Exaggerating(planner.world).set_goal(goal[0]), planner.heuristic.set_goal(goal[0])]

    def turns():
        for number in range(8):
            yield GuideTurn(lambda _, number=number: guesses[(number + 1) % 2], length)

    settings = {"weight": 1.5, "admissible": False, "reopen": False}
    alone = solve(planner.world, start, goal, guesses[0], **settings)
    turned = solve(planner.world, start, goal, guesses[0], **settings, turns=turns(), first_turn=length)
    assert turned.status == alone.status
    if alone.expansions < length:
        assert turned.expansions == alone.expansions
        np.testing.assert_array_equal(turned.cost, alone.cost)
    if turned.status[0] == Status.SOLVED:
        path = turned.paths[0]
        np.testing.assert_allclose(path.costs.sum(), turned.cost[0], rtol=1e-5)
        np.testing.assert_array_equal(path.states[[0, -1]], [start, goal[0]])
    late = solve(
        planner.world, start, goal, guesses[0], **settings, turns=iter([GuideTurn(lambda _: None, 1)]), first_turn=1
    )
    assert late.status[0] == (Status.TIME_LIMIT if alone.expansions > 0 else alone.status[0])
