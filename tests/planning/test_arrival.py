"""Goals with a tolerance, with a free heading, several goals: plans are optimal over all states in which they end."""

import itertools
import math
import tracemalloc

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st

from hdsp import HeightMap, InputError, Planner, Status
from hdsp.abstract.transform import feet_at
from hdsp.base.gradual import finished
from hdsp.detailed.search.bounds import rounding
from hdsp.planning.ends import arrival
from hdsp.robot.lattice import HEADINGS, RESOLUTION, Grid, heading_angle
from tests.detailed.instances import NIMBLE, blocky, valid_states
from tests.naive import Naive, dijkstra

CELLS = 10
WALL = slice(30, 34)
POSE = (0.7, 1.25, 0.0)


def toy_scene(seed):
    """A planner for the toy robot, its textbook twin, a start, and a goal pose in world coordinates."""
    rng = np.random.default_rng(seed)
    heights = blocky(rng, cells=CELLS)
    twin, planner = Naive(heights, NIMBLE), Planner(HeightMap(heights), NIMBLE, conditioning=None)
    states = valid_states(twin, rng, 12, neutral=True)
    assume(len(states) >= 2)
    start, *goals = planner.grid.to_world(np.array(states))
    return planner, twin, tuple(states[0]), start, goals


def stance(planner, twin, base):
    """The state that counts at a pose within a tolerance: on neutral feet, or where that is impossible on the best."""
    neutral = (*base, 0, 0, 0, 0)
    best = None if twin.valid(neutral) else feet_at(planner.world, base)
    return neutral if twin.valid(neutral) else best if best is None else tuple(best.tolist())


def within(planner, twin, pose, distance, turn):
    """All states of the twin within a tolerance of a pose that lies on the lattice."""
    found = set()
    for x, y, heading in itertools.product(range(CELLS), range(CELLS), range(HEADINGS)):
        away = np.hypot(*(planner.grid.center((x, y)) - pose[:2]))
        off = abs((heading_angle(heading) - pose[2] + math.pi) % (2 * math.pi) - math.pi)
        if away <= distance + 1e-9 and off <= turn + 1e-9 and (state := stance(planner, twin, (x, y, heading))):
            found.add(state)
    return found


def least(gone, states):
    """Least cost to any of some states; None if the search has not got as far."""
    return min((gone.cost[state] for state in states if state in gone.cost), default=None)


@settings(max_examples=6, deadline=None, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 10_000), distance=st.sampled_from([0.0, 0.03, 0.06]), turn=st.sampled_from([0.0, 0.25]))
def test_with_a_tolerance_the_plan_is_the_cheapest_to_any_state_within_it(seed, distance, turn):
    planner, twin, begin, start, (goal, *_) = toy_scene(seed)
    exact = tuple(feet_at(planner.world, planner.grid.to_lattice(goal[:3])[:3].tolist()).tolist())
    wanted = least(dijkstra(twin, begin, most=1500), {exact} | within(planner, twin, goal, distance, turn))
    assume(wanted is not None)
    plan = planner.plan(start, goal[:3], tolerance=(distance, turn))
    assert plan.cost == pytest.approx(wanted, rel=1e-6) and plan.bound == 1
    assert np.hypot(*(plan.states[-1] - goal)[:2]) <= distance + 1e-9
    anchored = planner.plan(start, goal[:3], tolerance=(distance, turn), weight=1.2, anchor_weight=1.2)
    assert wanted - 1e-6 <= anchored.cost <= anchored.bound * wanted + 1e-6 and anchored.bound <= 1.44
    *_, last = planner.improve(start, goal[:3], tolerance=(distance, turn))
    assert last.cost == pytest.approx(wanted, rel=1e-6) and last.bound == 1


@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@example(seed=50, weight=1.0, manual=True)
@given(seed=st.integers(0, 10_000), weight=st.sampled_from([1.0, 1.5]), manual=st.booleans())
def test_several_goals_cost_the_least_of_the_single_costs_and_more_tolerance_never_costs_more(seed, weight, manual):
    planner, _, _, start, goals = toy_scene(seed)
    single = [plan.cost for plan in planner.plan_each(start, goals)]
    assert [planner.plan(start, goal).cost for goal in goals] == single
    guided = Planner(planner.terrain, NIMBLE, "manual", conditioning=None) if manual else planner
    plan = guided.plan(start, goals, weight)
    if np.isfinite(min(single)):
        end = goals[plan.goal_index]
        np.testing.assert_allclose(plan.states[-1], end, atol=1e-9)
        assert plan.cost >= min(single) - 1e-6
        assert manual or plan.cost <= weight * min(single) + 1e-6
        anchored = guided.plan(start, goals, weight, anchor_weight=1.5)
        # A bound of 1 means: no worse than the optimum, up to rounding of the costs in the store.
        rounded = 3 * rounding(planner.world) * anchored.cost
        assert anchored.cost <= min(anchored.bound, 1.5 * weight) * min(single) * (1 + rounded) + 1e-6
        *_, last = guided.improve(start, goals)
        assert last.cost == pytest.approx(min(single), rel=1e-6)
        assert min(single) >= single[last.goal_index] - 1e-6
    else:
        assert not plan.solved and plan.goal_index is None
    costs = [planner.plan(start, goals[0], tolerance=tolerance).cost for tolerance in (None, 0, 0.03, (0.06, 0.1))]
    assert all(after <= before + 1e-6 for before, after in itertools.pairwise(costs))


def test_a_free_heading_is_reached_at_the_heading_that_costs_least():
    planner = Planner(HeightMap.flat((100, 100)))
    goal = (1.6, 1.1)
    costs = [planner.plan(POSE, (*goal, float(angle))).cost for angle in heading_angle(np.arange(0, HEADINGS, 4))]
    plan = planner.plan(POSE, (*goal, None))
    assert plan.solved and plan.cost <= min(costs) and plan.cost == pytest.approx(min(costs), rel=0.05)
    assert np.hypot(*(plan.states[-1][:2] - goal)) <= RESOLUTION
    given_feet = planner.plan(POSE, (*goal, None, 0.0, 0.0, 0.0, 0.0))
    assert given_feet.cost == pytest.approx(plan.cost)


def test_a_proof_of_no_way_needs_all_goals_out_of_reach():
    heights = np.zeros((100, 100), np.float32)
    heights[60:64] = 1.0
    planner = Planner(HeightMap(heights), conditioning=None)
    beyond, before = (2.1, 1.25, 0.0), (0.6, 0.9, 0.3)
    plan = planner.plan(POSE, [beyond, (2.0, 1.0, 0.0)])
    assert plan.status == Status.INFEASIBLE and plan.stats.expansions <= 50_000 and plan.goal_index is None
    assert planner.plan(POSE, [beyond, before]).goal_index == 1
    each = planner.plan_each(POSE, [beyond, before, (1.55, 1.25, 0.0)])
    assert [plan.status for plan in each] == [Status.INFEASIBLE, Status.SOLVED, Status.INVALID_GOAL]
    assert planner.plan(POSE, beyond, tolerance=(1.2, math.pi), weight=3).solved


def test_a_goal_without_any_standing_pose_within_the_tolerance_is_invalid():
    heights = np.zeros((100, 100), np.float32)
    heights[50:60] = 1.0
    planner = Planner(HeightMap(heights), conditioning=None)
    plan = planner.plan(POSE, (1.375, 1.25, 0.0), tolerance=0.05)
    assert plan.status == Status.INVALID_GOAL
    assert "cannot stand" in plan.explain() and "nor at any other pose within the tolerance" in plan.explain()
    plan = planner.plan(POSE, [(1.375, 1.25, 0.0), (1.375, 1.0, 0.0)])
    assert plan.status == Status.INVALID_GOAL and "nor at any other goal" in plan.explain()
    assert planner.plan(POSE, [(1.375, 1.25, 0.0), (0.6, 1.0, 0.0)]).goal_index == 1


@pytest.mark.parametrize("tolerance", [-0.1, math.nan, (0.1,), (0.1, 0.2, 0.3), "near", (0.1, -1)])
def test_a_tolerance_is_a_distance_and_an_angle(tolerance):
    with pytest.raises(InputError, match="tolerance"):
        Planner(HeightMap.flat((60, 60))).plan((0.7, 0.7, 0), (0.8, 0.7, 0), tolerance=tolerance)


def test_a_tolerance_of_another_length_names_both_forms():
    for tolerance in ((1, 2, 3), [0.1], np.zeros((3, 2)), [[1, 2], 3, 4], "near", ()):
        with pytest.raises(InputError, match=r"tolerance is .*a number >= 0 in m, or a pair \(m, rad\)"):
            arrival.arrival(None, None, None, [], tolerance)


@pytest.mark.parametrize("goal", [[], [(1, 2)], [(0.8, 0.7, 0), (0.8, math.nan, 0)], (None, 0.7, 0)])
def test_goals_are_poses(goal):
    with pytest.raises(InputError, match="goal"):
        Planner(HeightMap.flat((60, 60))).plan((0.7, 0.7, 0), goal)


def test_a_goal_given_twice_or_goals_that_overlap_take_no_longer_search():
    planner = Planner(HeightMap(np.zeros((80, 80), np.float32)))
    start, goal, beside = (0.6, 1.0, 0.0), (1.3, 1.0, 0.0), (1.35, 1.0, 0.0)
    alone, twice = planner.plan(start, goal), planner.plan(start, [goal, goal])
    assert (twice.cost, twice.stats.expansions, twice.goal_index) == (alone.cost, alone.stats.expansions, 0)
    both = planner.plan(start, [goal, beside], tolerance=0.1)
    assert both.cost <= alone.cost and both.stats.expansions < 20 * alone.stats.expansions


@settings(max_examples=40, deadline=None)
@given(
    shape=st.tuples(st.integers(1, 30), st.integers(1, 30)),
    place=st.tuples(st.floats(0, 0.999), st.floats(0, 0.999)),
    distance=st.sampled_from([0.0, 0.01, 0.2, 0.5, 3.0, 1e308]),
)
def test_positions_within_a_tolerance_come_some_rows_at_a_time(shape, place, distance):
    grid = Grid((412345.678, -2.0), shape)
    xy = np.array(grid.origin) + np.array(shape) * RESOLUTION * place
    state = np.array([*grid.cell(xy), 0, 0, 0, 0, 0])
    every = np.stack(np.indices(shape), axis=-1).reshape(-1, 2)
    near = np.hypot(*(grid.center(every) - xy).T) <= distance + 1e-9
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(arrival, "_CELLS_AT_ONCE", 64)
        blocks = list(arrival._positions(grid, state, xy, distance))
    np.testing.assert_array_equal(np.concatenate(blocks), every[near | (every == state[:2]).all(axis=1)])
    assert max(map(len, blocks)) <= 64


def test_a_wide_tolerance_looks_at_memory_and_clock_before_it_makes_states(monkeypatch):
    planner = Planner(HeightMap.flat((300, 300)))
    goal = 3.7, 3.7, 0.0
    monkeypatch.setattr(arrival, "_standing_at", lambda *_: pytest.fail("made states"))
    steps = arrival.arrival_steps(planner.world, planner.grid, planner.robot, [goal], 1e308, memory=20e6)
    tracemalloc.start()
    began, pauses = next(steps), 1
    with pytest.raises(InputError, match=r"90000 states at the goal need 36000000 bytes at least; 20000000 are left"):
        for _ in steps:
            pauses += 1
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert began is None and pauses >= 2 and most < 5e6


def test_goals_share_the_memory_for_their_states():
    planner = Planner(HeightMap.flat((100, 100)))
    goals, needed = [(1.0, 1.25, 0.0), (1.5, 1.25, 0.0)], 49 * arrival.STATE_BYTES

    def states(memory):
        return finished(arrival.arrival_steps(planner.world, planner.grid, planner.robot, goals, 0.09, memory)).states

    count = len(states(math.inf))
    assert 49 < count < 98
    with pytest.raises(InputError, match="states at the goal need"):
        states(1.2 * needed)


@settings(max_examples=60, deadline=None)
@given(
    bases=st.sets(st.tuples(*[st.integers(0, 2)] * 3)),
    extra=st.tuples(*[st.integers(0, 2)] * 3, *[st.integers(-1, 1)] * 4),
    foot=st.integers(-1, 1),
)
def test_a_state_joins_others_in_their_order(bases, extra, foot):
    rows = [(*base, 0, foot, 0, 0) for base in sorted(bases)]
    joined = arrival._with_state(np.array(rows, np.int64).reshape(-1, 7), np.array(extra))
    assert joined.tolist() == [list(row) for row in sorted({*rows, extra})]
