"""Long searches in which several guides take turns."""

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from hdsp import HeightMap, Planner, Status
from hdsp.abstract import FlatCosts
from hdsp.detailed.search.life_cycle import GuideTurn
from hdsp.detailed.search.outcome import Limits
from hdsp.detailed.search.weighted_astar import solve
from hdsp.detailed.world.world import build_world
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
    blind = AbstractHeuristic(build_world(bag, MOMARO), bag, Blind(MOMARO))
    alone = Planner(bag, heuristic=blind, conditioning=None)
    manual, turned = (Planner(bag, heuristic=costs, conditioning=None) for costs in ("manual", Blind(MOMARO)))
    monkeypatch.setattr(query, "TURN", 1000)
    monkeypatch.setattr(query, "HARD", 10**9)
    best, without, found = (each.plan(INTO_THE_BAG, BEHIND_IT, 1.25, polish=0.0) for each in (manual, alone, turned))
    assert without.solved and found.solved
    assert 1000 < found.stats.expansions < 0.5 * without.stats.expansions
    assert found.stats.expansions <= 1000 + 2 * best.stats.expansions
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


SETTINGS = {"weight": 1.5, "admissible": False, "reopen": False}
GUIDES = 3


class Instance:
    """A task on a small map, and three guides for it, in order of their searches."""

    def __init__(self, category, number, seed):
        heights, robot = small_map(category, number, 16), toy()
        states = valid_states(Naive(heights, robot), np.random.default_rng(seed), 25)
        assume(len(states) > 1)
        planner = Planner(HeightMap(heights), robot, conditioning=None)
        self.world, self.start, self.goal = planner.world, states[0], states[-1:]
        too_high, low = (each.set_goal(states[-1]) for each in (Exaggerating(planner.world), planner.heuristic))
        self.guides = [too_high, low, low._replace(distance=0.1 * low.distance)]

    def alone(self, **options):
        """The search with each guide alone."""
        return [solve(self.world, self.start, self.goal, guide, **SETTINGS, **options) for guide in self.guides]

    def turned(self, first, turns, **options):
        """The search in turns, each (number, length) or a ``GuideTurn``, after a first one."""

        def guided():
            for number, *rest in turns:
                yield GuideTurn(number, *((lambda _, number=number: self.guides[number]), *rest)[-2:])

        options = {"turns": guided(), "first_turn": first, **options}
        return solve(self.world, self.start, self.goal, self.guides[0], **SETTINGS, **options)


instances = st.builds(Instance, st.sampled_from(CATEGORIES), st.integers(0, 10_000), st.integers(0, 1000))
lengths = st.integers(1, 100)
schedules = st.lists(st.tuples(st.integers(0, GUIDES - 1), lengths), max_size=8)


def expected(first, turns, alone):
    """Textbook twin: which search ends, and the expansions of each search until then.

    Args:
        first: length of the first turn.
        turns: (number, length) of all further turns; the last search continues to its end.
        alone: expansions of each search alone.
    """
    done = [0] * len(alone)
    for number, length in [(0, first), *turns]:
        if done[number] + length > alone[number]:
            break
        done[number] += length
    done[number] = alone[number]
    return number, done


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(instances, lengths, schedules)
def test_each_guide_searches_in_its_turns_as_if_it_were_alone(instance, first, turns):
    alone = instance.alone()
    turned = instance.turned(first, turns)
    ends, done = expected(first, turns, [each.expansions for each in alone])
    assert turned.status == alone[ends].status and turned.expansions == sum(done)
    assert turned.seen >= alone[ends].seen and turned.memory >= alone[ends].memory
    np.testing.assert_array_equal(turned.cost, alone[ends].cost)
    if turned.status[0] == Status.SOLVED:
        np.testing.assert_array_equal(turned.paths[0].states, alone[ends].paths[0].states)


@settings(max_examples=8, deadline=None, suppress_health_check=list(HealthCheck))
@given(instances, lengths, schedules, st.sampled_from([0.6, 0.95, 1.05, 2.0]))
def test_limits_hold_for_all_searches_together(instance, first, turns, share):
    alone = instance.alone()[0]
    assume(alone.status[0] == Status.SOLVED)
    dear = Limits(cost=share * alone.cost[0])
    assert instance.turned(first, turns, limits=dear).status == instance.alone(limits=dear)[0].status
    for limits in (Limits(expansions=alone.expansions // 2), Limits(memory=int(share * alone.memory))):
        limited = instance.turned(first, turns, limits=limits)
        assert limited.expansions <= limits.expansions
        assert limited.memory <= limits.memory or limited.status[0] == Status.MEMORY_LIMIT
    late = instance.turned(1, [GuideTurn(1, lambda _: None, 1)])
    assert late.status[0] == (Status.TIME_LIMIT if alone.expansions > 0 else alone.status[0])


@settings(max_examples=8, deadline=None, suppress_health_check=list(HealthCheck))
@given(instances, lengths)
def test_a_search_with_another_guide_keeps_its_states(instance, length):
    alone = instance.alone()[0]
    guide = instance.guides[1]
    turned = instance.turned(length, [GuideTurn(0, lambda _: guide, 10**9)])
    assert turned.status == alone.status
    if alone.expansions < length:
        assert turned.expansions == alone.expansions
    if turned.status[0] == Status.SOLVED:
        np.testing.assert_allclose(turned.paths[0].costs.sum(), turned.cost[0], rtol=1e-5)
    if turned.status[0] == Status.INFEASIBLE:
        assert turned.seen == alone.seen and turned.expansions <= 2 * alone.expansions


@given(st.lists(st.integers(0, 300), min_size=2, max_size=3))
def test_turns_take_a_small_multiple_of_the_best_guide(alone):
    turns = [(number, 10) for _ in range(40) for number in [*range(1, len(alone)), 0]]
    assert sum(expected(10, turns, alone)[1]) <= len(alone) * min(alone) + (len(alone) - 1) * 10
