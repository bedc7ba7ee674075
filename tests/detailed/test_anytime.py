"""Anytime repair: plans that improve, valid bounds, and the end of a search."""

import math
from itertools import pairwise

import numpy as np
import pytest

from hdsp import HeightMap, InputError, Planner, Status
from hdsp.abstract import FlatCosts
from hdsp.detailed.search import anytime, life_cycle, open_list, store
from hdsp.detailed.search.estimate import geometric_estimate
from hdsp.detailed.search.open_list import OpenList
from hdsp.detailed.search.outcome import Limits
from hdsp.detailed.search.store import Store
from hdsp.detailed.search.weighted_astar import solve
from hdsp.detailed.world.world import build_world
from hdsp.planning.memory import least_memory
from hdsp.planning.refinable import RefusedSteps
from tests.detailed.instances import action_tuple, blocky, near_edges, toy, valid_states
from tests.detailed.test_refinable import refusing, steps_of
from tests.detailed.test_refine import with_bar
from tests.naive import Naive, dijkstra

NIMBLE = toy(step={"cost": 0.004, "cost_per_metre": 0.31, "cost_per_height": 0.05}, base_shift={"cost_per_metre": 1.2})
#: Turns, foot moves and base shifts are far cheaper than with the other robots, and steps have no fixed cost.
ODD = toy(
    turn={"cost": 0.004}, foot_move={"cost_per_metre": 0.05}, base_shift={"cost_per_metre": 0.07, "backward": False},
    step={"cost": 0.0, "backward": False},
)  # fmt: skip
WEIGHTS = 3.0, 2.0, 1.5, 1.25, 1.0


@pytest.fixture(scope="module")
def tasks():
    """Random tasks [(world, twin, start, goal, least cost)] with least costs from plain Dijkstra."""
    found = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        robot = (NIMBLE, toy(), ODD)[seed % 3]
        heights = blocky(rng)
        world, twin = build_world(HeightMap(heights), robot), Naive(heights, robot)
        states = valid_states(twin, rng, 40, headings=[0, 16, 3, 40])
        start = (near_edges(twin, states) + states)[0]
        gone = dijkstra(twin, start, most=300)
        for goal in list(gone.cost)[-1:-80:-20]:
            if goal == start:
                continue
            found.append((world, twin, start, goal, gone.cost[goal]))
    return found


def exaggerated(world, goal):
    """A heuristic that is neither admissible nor consistent."""
    e = geometric_estimate(world, np.array(goal))
    table = np.random.default_rng(0).uniform(0, 1, (16, 4, 4)).astype(np.float32)
    return e._replace(
        distance=4 * e.distance, turn=0.5 * e.turn, foot=3 * e.foot, table=table.ravel(), table_nx=4, table_ny=4,
        cells=3, heading_steps=4,
    )  # fmt: skip


def improvements(task, guided=False, weights=WEIGHTS, **options):
    world, start, goal = task[0], np.array(task[2]), np.array(task[3])
    guide = exaggerated(world, goal) if guided else None
    return list(anytime.improve(world, start, goal, weights, geometric_estimate(world, goal), guide, **options))


@pytest.mark.parametrize("guided", [False, True], ids=["admissible", "exaggerated"])
@pytest.mark.parametrize("steps", [20_000, 30], ids=["rounds", "slices"])
def test_bounds_hold_costs_never_rise_and_the_last_plan_is_optimal(tasks, monkeypatch, guided, steps):
    monkeypatch.setattr(life_cycle, "_SLICE", steps)  # expansions between two checks for better plans
    assert len(tasks) >= 60
    first_was_worse = 0
    for task in tasks:
        _, twin, start, goal, least = task
        found = improvements(task, guided)
        assert [each.ended for each in found[:-1]] == [None] * (len(found) - 1)
        assert found[-1].ended == Status.SOLVED
        bounds = [each.result.bound for each in found]
        for each, bound in zip(found, bounds, strict=True):
            if each.result.paths[0] is not None:
                assert least - 1e-6 <= each.result.cost[0] <= (bound + 1e-5) * least
            assert each.result.lower_bound <= least * (1 + 1e-6)
        for before, after in pairwise(found):
            assert after.result.cost[0] <= before.result.cost[0]
            assert after.result.lower_bound >= before.result.lower_bound
        assert bounds[-1] == 1
        assert found[-1].result.cost[0] == pytest.approx(least, rel=1e-5, abs=1e-6)
        first_was_worse += found[0].result.cost[0] > least * 1.001
        assert_legal(twin, found[-1].result, start, goal)
    assert first_was_worse > 10


def assert_legal(twin, result, start, goal):
    states = [tuple(state) for state in result.paths[0].states.tolist()]
    assert states[0] == start and states[-1] == goal
    for state, reached, code, cost in zip(
        states, states[1:], result.paths[0].actions, result.paths[0].costs, strict=False
    ):
        legal = {(a, s): c for a, s, c in twin.successors(state)}
        assert legal[action_tuple(int(code)), reached] == pytest.approx(cost, rel=1e-6)
    assert result.paths[0].costs.sum() == pytest.approx(result.cost[0], rel=1e-9)


def test_limits_end_the_search_with_the_best_plan_so_far(tasks):
    task = max(tasks, key=lambda task: task[4])
    needed = improvements(task)
    assert needed[0].result.expansions < needed[-1].result.expansions
    enough = needed[0].result.expansions + 1  # enough for the first plan, too few for the best plan
    (*_, last) = improvements(task, limits=Limits(expansions=enough))
    assert last.ended == Status.EXPANSION_LIMIT and last.result.status == [Status.SOLVED]
    assert last.result.expansions == enough and 0 < last.result.lower_bound <= task[4] * (1 + 1e-6)
    (only,) = improvements(task, limits=Limits(expansions=1))
    assert only.ended == Status.EXPANSION_LIMIT == only.result.status[0] and 0 < only.result.lower_bound <= task[4]
    *some, last = improvements(task, limits=Limits(cost=0.99 * task[4]))
    assert last.ended == Status.COST_LIMIT and last.result.paths == [None]
    assert all(each.result.paths == [None] for each in some)
    assert 0.98 * task[4] <= last.result.lower_bound <= task[4]
    within = improvements(task, limits=Limits(cost=1.01 * task[4]))
    assert within[-1].ended == Status.SOLVED
    assert 0 < min(each.result.cost[0] for each in within) <= 1.01 * task[4]


def owns_memory(value):
    return isinstance(value, np.ndarray) and value.base is None


def test_all_memory_counts_also_that_into_which_the_store_is_copied(monkeypatch):
    world = build_world(HeightMap.flat((100, 100)), NIMBLE)
    start, goal = np.array((20, 20, 0, 0, 0, 0, 0)), np.array((80, 80, 32, 0, 0, 0, 0))
    times, most = 0, 0

    def watched(grow, other):
        def growing(old, *more):
            nonlocal times, most
            new = grow(old, *more)
            arrays = {id(array): array.nbytes for array in (*old, *new) if owns_memory(array)}
            held[type(new)] = new.nbytes()
            times, most = times + 1, max(most, sum(arrays.values()) + held[other])
            return new

        return growing

    held = {OpenList: open_list.new_open_list().nbytes()}
    monkeypatch.setattr(life_cycle, "grown", watched(store.grown, OpenList))
    monkeypatch.setattr(open_list, "with_room", watched(open_list.with_room, Store))
    estimate = geometric_estimate(world, goal)
    free = solve(world, start, goal, estimate)
    assert free.status == [Status.SOLVED] and times > 4
    needed, most = most, 0
    held[OpenList] = open_list.new_open_list().nbytes()
    assert solve(world, start, goal, estimate, limits=Limits(memory=needed)).status == [Status.SOLVED]
    assert most == needed
    most, held[OpenList] = 0, open_list.new_open_list().nbytes()
    short = solve(world, start, goal, estimate, limits=Limits(memory=needed - 1))
    assert short.status == [Status.MEMORY_LIMIT]
    assert needed / 2 < most < needed  # the search uses the memory that the limit allows
    assert solve(world, start, goal, estimate, limits=Limits(memory=1000)).status == [Status.MEMORY_LIMIT]


# --- Planner.improve --------------------------------------------------------------------------------------------------

START, GOAL = (0.7, 0.7, 0.0), (1.9, 1.9, 1.2)


@pytest.fixture(scope="module")
def rough():
    """A map of 2.75 m with a block in the way."""
    heights = np.zeros((110, 110), np.float32)
    heights[50:58, 50:54] = 0.15
    return HeightMap(heights)


@pytest.fixture(scope="module")
def planner(rough):
    return Planner(rough)


class Dear(FlatCosts):
    """Abstract costs that are far too high."""

    def edges(self, height_map, region=None, mask=None):
        return super().edges(height_map, region, mask) * 5


def assert_each_is_news(plans):
    for before, after in pairwise(plans):
        assert after.cost < before.cost or (after.cost == before.cost and after.bound < before.bound)
        assert after.bound <= before.bound * (1 + 1e-6)
        assert before.stats["ended"] is None
    for plan in plans:
        assert plan.solved and plan.bound >= 1
        assert plan.stats["lower_bound"] <= plan.cost <= plan.bound * plan.stats["lower_bound"] * (1 + 1e-4)


@pytest.mark.parametrize("heuristic", ["geometric", Dear("momaro")], ids=["geometric", "dear"])
def test_plans_get_better_until_the_best_is_proved(rough, planner, heuristic):
    least = planner.plan(START, GOAL)
    assert least.bound == 1 and least.stats["lower_bound"] == pytest.approx(least.cost, rel=1e-4)
    plans = list(Planner(rough, heuristic=heuristic).improve(START, GOAL, polish=0))
    assert_each_is_news(plans)
    assert len(plans) >= 2 and plans[0].cost > least.cost * 1.001
    assert plans[-1].bound == 1 and plans[-1].stats["ended"] == "solved"
    assert plans[-1].cost == pytest.approx(least.cost, rel=1e-6)
    assert all(plan.stats["lower_bound"] <= least.cost for plan in plans)
    assert plans[-1].explain().startswith("solved")


def test_rounds_end_when_the_last_weight_is_proved(planner):
    plans = list(planner.improve(START, GOAL, weights=(3, 2)))
    assert plans[-1].bound <= 2 * (1 + 1e-4) and plans[-1].stats["ended"] == "solved"


def test_plan_states_its_bound(rough, planner):
    plan = planner.plan(START, GOAL, weight=2.0)
    assert plan.bound == 2 and plan.cost / 2.001 < plan.stats["lower_bound"] <= plan.cost / 2
    assert np.isinf(planner.plan(START, GOAL, expansions=3).bound)
    assert planner.plan(START, GOAL, cost=0.1).stats["lower_bound"] == 0.1
    unproved = Planner(rough, heuristic=Dear("momaro")).plan(START, GOAL)
    least = planner.plan(START, GOAL).cost
    assert 0 < unproved.stats["lower_bound"] <= least <= unproved.cost <= unproved.bound * least < np.inf


def test_each_limit_ends_with_its_status(planner):
    all_plans = list(planner.improve(START, GOAL))
    enough = all_plans[0].stats["expansions"] + 1
    some = list(planner.improve(START, GOAL, expansions=enough))
    assert_each_is_news(some)
    assert some[-1].solved and some[-1].stats["ended"] == "expansion_limit" and some[-1].bound > 1
    with pytest.raises(InputError, match=r"memory is 1000; a query on this map needs \d+ bytes at least"):
        next(planner.improve(START, GOAL, memory=1000))
    least = planner.heuristic.needed_memory() + least_memory(planner.world)
    for limit, status in (
        ({"expansions": 3}, Status.EXPANSION_LIMIT), ({"memory": least}, Status.MEMORY_LIMIT),
        ({"cost": 0.1}, Status.COST_LIMIT),
    ):  # fmt: skip
        (plan,) = planner.improve(START, GOAL, **limit)
        assert plan.status == status and plan.stats["ended"] == str(status) and np.isinf(plan.bound)
        assert plan.explain()


def test_time_runs_while_the_caller_thinks(planner, monkeypatch):
    monkeypatch.setattr(life_cycle, "_SLICE", 500)
    plans = planner.improve(START, GOAL, time=1000.0)
    first = next(plans)
    clock = life_cycle.now
    monkeypatch.setattr(life_cycle, "now", lambda: clock() + 2000)
    rest = list(plans)
    assert_each_is_news([first, *rest])
    assert ([first, *rest])[-1].stats["ended"] == "time_limit"


def test_no_way_is_proved_once_and_explained():
    heights = np.zeros((120, 120), np.float32)
    heights[58:62] = 0.6
    (plan,) = Planner(HeightMap(heights)).improve((0.6, 1.5, 0.0), (2.4, 1.5, 0.0))
    assert plan.status == Status.INFEASIBLE and plan.stats["ended"] == "infeasible"
    assert "foot gets nowhere" in plan.explain() and np.isinf(plan.stats["lower_bound"])


def test_a_start_where_the_robot_cannot_stand_is_the_only_answer(planner):
    (plan,) = planner.improve((0.1, 0.1, 0.0), GOAL)
    assert plan.status == Status.INVALID_START and "start" in plan.explain()
    (plan,) = planner.improve(START, (0.1, 0.1, 0.0))
    assert plan.status == Status.INVALID_GOAL


def test_start_and_goal_alike_cost_nothing(planner):
    (plan,) = planner.improve(START, START)
    assert (plan.cost, plan.bound, plan.stats["ended"]) == (0.0, 1.0, "solved")


@pytest.mark.parametrize("weights", [(), (2, 2), (1.5, 2), (2, 0.9), (math.nan,), (math.inf, 1)])
def test_wrong_weights_are_refused_at_once(planner, weights):
    with pytest.raises(InputError, match="weight"):
        planner.improve(START, GOAL, weights)


def test_wrong_poses_are_refused_at_once(planner):
    with pytest.raises(InputError, match=r"goal.*finite"):
        planner.improve(START, (math.nan, 1, 0))


def test_it_may_be_left_at_any_time_and_does_not_disturb_other_queries(planner):
    plans = planner.improve(START, GOAL)
    first = next(plans)
    planner.plan(START, (0.9, 0.7, 0.0))
    second = next(plans)
    assert_each_is_news([first, second])
    assert abs(second.states[-1, :2] - GOAL[:2]).max() <= 0.0126
    plans.close()
    assert list(plans) == []


def test_steps_that_cannot_be_carried_out_are_refused_and_the_rounds_go_on(planner, monkeypatch):
    """The test lets the first two plans fail at their first action."""

    def refuses(self, plan):
        if len(self.words) < 2:
            self.words.append("no")
            return True
        return False

    monkeypatch.setattr(RefusedSteps, "refuse_from", refuses)
    plans = list(planner.improve(START, GOAL, refinable=True))
    assert_each_is_news(plans)
    assert plans[0].refused == ("no", "no") and plans[-1].bound == 1


def test_all_plans_can_be_carried_out_if_asked_for(monkeypatch):
    planner = Planner(with_bar(), heuristic="manual")
    start, goal = (0.5, 0.75, 0.0), (1.6, 0.75, 0.0)
    first = next(planner.improve(start, goal, (2.0, 1.5), polish=0))
    unwanted = steps_of(first)[1]
    refusing({unwanted}, monkeypatch)
    plans = list(planner.improve(start, goal, (2.0, 1.5), refinable=True, expansions=200_000, polish=0))
    assert_each_is_news(plans)
    assert str(unwanted[0]) in plans[-1].refused[0]
    assert all(unwanted not in steps_of(plan) and plan.refine().check() == [] for plan in plans)
    assert plans[-1].stats["expansions"] <= 200_000
