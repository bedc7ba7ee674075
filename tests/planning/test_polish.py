"""The polish makes plans cheaper, never dearer, keeps their ends and their rules, and keeps its budget."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

import hdsp.planning.answers.plans
from hdsp import HeightMap, InputError, Planner, RefinementError
from hdsp.abstract import ManualCosts
from hdsp.detailed.actions.action import ActionKind
from hdsp.detailed.search import windows
from hdsp.detailed.search.outcome import Limits
from hdsp.planning import polish
from hdsp.terrain.random_arenas import random_arena
from hdsp.terrain.scenes import CATEGORIES
from tests.detailed.instances import action_tuple, small_map, toy, valid_states
from tests.detailed.test_refine import with_bar
from tests.naive import Naive

ENDS = (4.0, 3.35, 3.14), (1.0, 1.2, -1.57)
STEPPING = (0.5, 0.75, 0.0), (1.6, 0.75, 0.0)


def sweeps(*widths):
    """Exact sweeps, for as long as they take."""
    return tuple(polish.Sweep(width, 0.0, 40_000) for width in widths)


@pytest.fixture(scope="module")
def arena():
    return Planner(random_arena(7), heuristic="manual").prepare()


def test_a_polished_plan_is_cheaper_keeps_its_ends_and_says_how_much_it_took(arena, monkeypatch):
    stopped = polish.now() + 60
    monkeypatch.setattr(polish, "now", lambda: stopped)  # expansions end the polish, also on a busy machine
    plain, polished = (arena.plan(*ENDS, 2.0, polish=seconds) for seconds in (0, None))
    assert plain.stats.unpolished_cost is None and plain.stats.polish_expansions == 0
    assert polished.cost < 0.9 * plain.cost == 0.9 * polished.stats.unpolished_cost
    np.testing.assert_array_equal(polished.states[[0, -1]], plain.states[[0, -1]])
    assert polished.action_costs.sum() == pytest.approx(polished.cost)
    assert len(polished.states) == len(polished.actions) + 1 == len(polished.action_costs) + 1
    most = polish.DEFAULT * polish.PER_SECOND + sum(limit for _, limit in polish.OWN)
    assert 0 < polished.stats.polish_expansions <= most
    assert polished.stats.expansions == plain.stats.expansions
    again = arena.plan(*ENDS, 2.0)
    np.testing.assert_array_equal(again.states, polished.states)


def test_only_costs_that_nothing_bounds_are_polished_unasked(arena):
    assert arena.plan(*ENDS, 1.0).stats.unpolished_cost is None
    assert arena.plan(ENDS[0], (3.7, 3.2, 3.0), 2.0, anchor_weight=2.0).stats.unpolished_cost is None
    geometric = Planner(HeightMap.flat((100, 100)))
    assert geometric.plan((0.9, 0.9, 0.0), (1.6, 1.1, 0.3), 2.0).stats.unpolished_cost is None
    asked = arena.plan(*ENDS, 1.0, polish=0.1)
    assert asked.cost <= asked.stats.unpolished_cost


def test_the_default_is_a_fast_search_that_the_polish_makes_good(arena):
    plan = arena.plan(*ENDS)
    assert plan.stats.weight == polish.FAST and plan.cost < plan.stats.unpolished_cost
    assert arena.plan(*ENDS, polish=0).stats.weight == 1
    assert Planner(HeightMap.flat((100, 100))).plan((0.9, 0.9, 0.0), (1.6, 1.1, 0.3)).stats.weight == 1


def test_a_second_plan_leaves_a_way_round(arena, monkeypatch):
    """Windows of single actions find nothing, so only the second plan can be cheaper."""
    monkeypatch.setattr(polish, "SWEEPS", sweeps(0.0))
    monkeypatch.setattr(polish, "OWN", ((1.03, 10), (1.25, 30_000)))
    first, both = arena.plan(*ENDS, 3.0, polish=0), arena.plan(*ENDS, 3.0)
    second = arena.plan(*ENDS, 1.25, polish=0)
    assert both.cost <= second.cost < first.cost == both.stats.unpolished_cost
    assert both.stats.polish_expansions >= 10 + second.stats.expansions


def test_another_abstraction_finds_a_way_that_the_first_one_judges_dear(monkeypatch):
    """Windows of single actions find nothing, so only the plan of the other abstraction can be cheaper."""
    heights = np.zeros((160, 240), np.float32)
    heights[78:82, [*range(60), *range(100, 170), *range(210, 240)]] = 1.0  # two doors
    terrain, ends = HeightMap(heights), ((1.2, 2.0, 0.0), (2.8, 2.0, 0.0))
    planner, manual = (Planner(terrain, heuristic=costs, conditioning=None) for costs in (DearDoor(), "manual"))
    monkeypatch.setattr(polish, "SWEEPS", sweeps(0.0))
    monkeypatch.setattr(polish, "OWN", ())
    plain = planner.plan(*ends, 1.25, polish=0.0)
    for weight, limits in ((1.03, (30_000,)), (1.25, (10, 30_000))):
        monkeypatch.setattr(polish, "OTHER", tuple(zip((1.03, 1.25), limits, strict=False)))
        polished, other = planner.plan(*ends, 1.25, polish=5.0), manual.plan(*ends, weight, polish=0.0)
        assert polished.cost <= other.cost < 0.9 * plain.cost
        assert polished.stats.polish_expansions >= other.stats.expansions + (0 if weight == 1.03 else 10)


class DearDoor:
    """Manual costs, several times as high around the near door."""

    def edges(self, height_map, region=None, mask=None):
        edges = ManualCosts("momaro").edges(height_map, region, mask)
        edges[:, 17:23, 13:28] *= 40
        return edges


def test_a_lower_cost_proves_a_smaller_bound_and_an_optimal_plan_stays():
    planner = Planner(HeightMap.flat((100, 100)))
    start, goal = (0.6, 0.6, 0.0), (1.7, 1.8, 2.5)
    optimal = planner.plan(start, goal, polish=1.0)
    assert optimal.bound == 1 and optimal.stats.unpolished_cost is None
    plain, polished = (planner.plan(start, goal, 3.0, polish=seconds) for seconds in (0.0, 1.0))
    assert optimal.cost * (1 - 1e-6) <= polished.cost < plain.cost
    assert polished.cost / optimal.cost <= polished.bound < plain.bound == 3


@pytest.mark.parametrize("seconds", [-1, math.nan, math.inf, "0.1", True])
def test_a_budget_is_a_number_of_seconds(arena, seconds):
    for query in (arena.plan, arena.improve):
        with pytest.raises(InputError, match=r"polish is .*; it must be a finite number >= 0"):
            query(*ENDS, polish=seconds)


def test_no_window_begins_after_the_time(arena, monkeypatch):
    clock = [0.0]

    def ticking():
        clock[0] += 1e-3
        return clock[0]

    arena.plan(*ENDS, 2.0)
    monkeypatch.setattr(polish, "now", ticking)
    monkeypatch.setattr(windows, "now", ticking)
    monkeypatch.setattr(polish, "PER_SECOND", 10**9)
    short, long = (arena.plan(*ENDS, 2.0, polish=seconds) for seconds in (0.02, 0.06))
    looks = 1e-3 * (len(polish.SWEEPS) + 2)  # each sweep looks at the clock
    assert short.stats.polish_seconds <= 0.02 + looks and long.stats.polish_seconds <= 0.06 + looks
    assert long.cost < short.cost < short.stats.unpolished_cost


def test_the_limits_of_a_query_hold_for_its_polish(arena):
    spent = arena.plan(*ENDS, 2.0, polish=0).stats.expansions
    plan = arena.plan(*ENDS, 2.0, expansions=spent + 1000)
    assert 900 <= plan.stats.polish_expansions <= 1000


robots = st.builds(lambda backward: toy(step={"backward": backward}), st.booleans())
terrains = st.builds(small_map, st.sampled_from(CATEGORIES), st.integers(0, 10_000), st.just(16))


@settings(max_examples=20, deadline=None, suppress_health_check=list(HealthCheck))
@given(robots, terrains, st.integers(0, 1000), st.sampled_from([0.0, 0.1]))
def test_every_action_of_a_polished_plan_is_legal_and_one_window_finds_the_cheapest(robot, heights, seed, narrow):
    twin = Naive(heights, robot)
    states = valid_states(twin, np.random.default_rng(seed), 25)
    assume(len(states) > 1)
    planner = Planner(HeightMap(heights), robot, conditioning=None)
    start, goal = states[0], states[-1]
    ends = planner.grid.to_world(start), planner.grid.to_world(goal)
    plain = planner.plan(*ends, 4.0, start_free=False, polish=0)
    assume(plain.solved and plain.actions)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(polish, "SWEEPS", sweeps(narrow) if narrow else sweeps(0.1, 100.0))
        plan = planner.plan(*ends, 4.0, start_free=False, polish=1.0)
    assert plan.cost <= plain.cost
    found = [tuple(planner.grid.to_lattice(state[:3], state[3:]).tolist()) for state in plan.states]
    assert found[0] == start and found[-1] == goal
    for (state, reached), action, cost in zip(pairwise(found), plan.actions, plan.action_costs, strict=True):
        costs = [c for a, s, c in twin.successors(state) if s == reached and a[0] == KINDS[action.kind]]
        assert min(abs(c - cost) for c in costs) <= 1e-6 * cost
    if not narrow:
        assert plan.cost == pytest.approx(planner.plan(*ends, start_free=False).cost, rel=1e-5)


KINDS = {
    kind: action_tuple(code)[0]
    for code in (0, 20, 22, 30, 32)
    for kind in [hdsp.detailed.actions.action.action_of(code).kind]
} | {ActionKind.TURN_RIGHT: "turn"}


def test_a_refinable_plan_stays_refinable(monkeypatch):
    planner = Planner(with_bar(), heuristic="manual").prepare()
    plain = planner.plan(*STEPPING, 3.0, refinable=True, polish=0)
    polished = planner.plan(*STEPPING, 3.0, refinable=True)
    assert polished.cost < plain.cost and polished.refine().check() == []
    refine, kept = (
        hdsp.planning.answers.plans.refine_steps,
        set(zip(plain.actions, map(tuple, plain.states), strict=False)),
    )

    def strict(terrain, robot, states, actions):
        for k, action in enumerate(actions):
            if action.kind is ActionKind.STEP and (action, tuple(states[k])) not in kept:
                raise RefinementError(k, "the test refuses new steps")
        return refine(terrain, robot, states, actions)

    monkeypatch.setattr(hdsp.planning.answers.plans, "refine_steps", strict)
    kept_to = planner.plan(*STEPPING, 3.0, refinable=True)
    assert kept_to.cost <= plain.cost and kept_to.refused == ()
    assert all(
        (action, tuple(state)) in kept
        for action, state in zip(kept_to.actions, kept_to.states, strict=False)
        if action.kind is ActionKind.STEP
    )


def test_improve_polishes_the_plans_of_its_rounds_and_keeps_its_bounds(arena):
    options = {"weights": (3.0, 1.5), "expansions": 300_000}
    plain, polished = (list(arena.improve(*ENDS, polish=seconds, **options)) for seconds in (0, None))
    assert polished[0].cost < plain[0].cost and polished[0].bound < plain[0].bound
    for before, after in pairwise(polished):
        assert after.cost <= before.cost and after.bound <= before.bound
    assert polished[-1].bound <= 1.5 and polished[-1].stats.ended == "solved"
    assert polished[-1].stats.expansions <= plain[-1].stats.expansions
    assert all(plan.stats.lower_bound <= polished[-1].cost for plan in polished)


def test_a_search_for_a_window_ends_at_its_limits(arena):
    grid, world = arena.grid, arena.world
    a, b = (grid.to_lattice(pose) for pose in ((1.0, 1.2, 0.0), (1.6, 1.4, 0.5)))
    least = windows.Windows(world).path(a, b, math.inf, 100_000, math.inf).cost
    searches = windows.Windows(world)
    assert searches.least(a, b) <= least
    assert searches.path(a, b, least * (1 - 1e-5), 100_000, math.inf) is None
    assert searches.path(a, b, least * (1 + 1e-5), 100_000, math.inf).cost == pytest.approx(least)
    spent = searches.expansions
    assert searches.path(a, b, math.inf, 10, math.inf) is None and searches.expansions == spent + 10
    assert searches.path(a, b, math.inf, 100_000, -math.inf) is None and searches.expansions == spent + 10
    assert (
        windows.Windows(world, 1000).path(a, (b + (60, 40, 8, 0, 0, 0, 0)), math.inf, Limits.expansions, 1e99) is None
    )


def test_a_window_with_a_guide_takes_fewer_expansions_and_a_guide_that_contradicts_the_limit_is_left_out(monkeypatch):
    made = []

    class Recorded(windows.Windows):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            made.append(arguments)

    monkeypatch.setattr(polish, "Windows", Recorded)
    planner = Planner(with_bar(), heuristic="manual").prepare()
    plan = planner.plan(*STEPPING, 3.0)
    a, b = (planner.grid.to_lattice(state[:3], state[3:]) for state in plan.states[[0, -1]])
    exact, trusting = windows.Windows(*made[-1][:2]), windows.Windows(*made[-1])
    limit = 2 * plan.cost
    least = exact.path(a, b, limit, 1_000_000, math.inf).cost
    guided = trusting.path(a, b, limit, 1_000_000, math.inf, 0.9)
    assert least * (1 - 1e-6) <= guided.cost < limit and trusting.expansions < 0.5 * exact.expansions
    spent = trusting.expansions
    assert trusting.path(a, b, limit, 1_000_000, math.inf, 100.0).cost == pytest.approx(least)
    assert trusting.expansions == spent + exact.expansions


def test_a_plan_of_an_admissible_heuristic_has_no_guide(monkeypatch):
    """Its values rise while a search goes on, so differences between them say nothing."""
    guides = []
    monkeypatch.setattr(
        polish, "Windows", lambda *arguments: guides.append(arguments[2]) or windows.Windows(*arguments)
    )
    planner = Planner(HeightMap.flat((100, 100)), heuristic="grid")
    planner.plan((0.6, 0.6, 0.0), (1.7, 1.8, 2.5), 3.0, polish=0.1)
    assert set(guides) == {None}
