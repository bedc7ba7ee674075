"""Multi-heuristic A*: its bound holds for arbitrary guides, and searches end with the right status."""

import re
from collections import Counter
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hdsp import HeightMap, InputError, Planner, Status
from hdsp.abstract import FlatCosts
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.relaxed.relaxed_costs import costs_to_go, explore
from hdsp.detailed.search import life_cycle, open_list
from hdsp.detailed.search.bounds import rounding
from hdsp.detailed.search.estimate import estimate, geometric_estimate, pose_estimate
from hdsp.detailed.search.multi_heuristic import solve_multi
from hdsp.detailed.search.outcome import Limits
from hdsp.detailed.search.weighted_astar import solve
from hdsp.detailed.states import pack_states
from hdsp.detailed.world.world import build_world
from hdsp.terrain.scenes import CATEGORIES
from tests.detailed.instances import NIMBLE, TASKS_PER_CATEGORY, action_tuple, by_category, search_tasks, valid_states
from tests.naive_multi import shared_mha

#: Least costs come from a search in double precision; bounds hold up to rounding errors of single precision.
ROUNDED = 1 + 1e-6


def informed(task):
    """Costs-to-go in the relaxed problem: nearly exact."""
    start, goal = np.array(task.start), np.array(task.goal)
    rules, limit = Rules(), 2 * task.cost + 1
    relaxed = explore(task.world, rules, start, limit)
    table, _ = costs_to_go(task.world, rules, relaxed, start, goal[None], np.zeros(1), limit)
    return pose_estimate(task.world, table, relaxed.follow, goal[None, 3:])


def exaggerated(task):
    """Far too high, and inconsistent."""
    e, rng = anchor_of(task), np.random.default_rng(0)
    return with_table(e._replace(distance=4 * e.distance, foot=3 * e.foot), rng.uniform(0, 1, (16, 4, 4)), 0.0)


def random_or_nothing(task):
    """Random numbers; a third of the states is cut off."""
    rng = np.random.default_rng(1)
    table = np.where(rng.random((64, 14, 14)) < 0.33, np.inf, rng.uniform(0, 2 * task.cost, (64, 14, 14)))
    return with_table(anchor_of(task), table, np.inf)


def astray(task):
    """Leads away from the goal: estimates fall with the distance to it."""
    e = anchor_of(task)
    ix, iy = np.indices((14, 14))
    away = np.hypot(ix - task.goal[0], iy - task.goal[1])
    return with_table(e._replace(distance=0.0, turn=0.0, foot=0.0), (away.max() - away)[None] * 3 * e.distance, 1.0)


def all_cut_off(task):
    """Cuts off every state."""
    return with_table(anchor_of(task), np.full((1, 1, 1), np.inf), np.inf)


GUIDES = informed, exaggerated, random_or_nothing, astray, all_cut_off


def with_table(e, table, outside):
    table = np.asarray(table, dtype=np.float32)
    headings, nx, ny = table.shape
    return e._replace(
        table=np.ascontiguousarray(table).ravel(), table_nx=nx, table_ny=ny, cells=-(-14 // nx),
        heading_steps=64 // headings, outside=outside,
    )  # fmt: skip


def anchor_of(task):
    return geometric_estimate(task.world, np.array(task.goal))


def python_heuristic(task, e):
    """The same estimates for the textbook search."""
    return cache(lambda state: estimate(task.world, e, int(pack_states(np.array(state), task.world.tables.lowest)[0])))


def found(task, guides, w1, w2, **options):
    ends = np.array(task.start), np.array(task.goal)
    return solve_multi(task.world, *ends, anchor_of(task), guides, weight=w1, anchor_weight=w2, **options)


def assert_within_bound(task, result, w1, w2):
    """Asserts a correct plan cost, a cost within the promised bound, and no wrong bound."""
    assert result.status == [Status.SOLVED]
    cost = result.cost[0]
    assert task.cost <= cost * ROUNDED + 1e-9
    assert 1 <= result.bound <= w1 * w2
    assert cost <= result.bound * task.cost * ROUNDED + 1e-9
    assert result.lower_bound <= task.cost * (1 + 1e-12) + 1e-12
    # The bound differs from the ratio of the two costs by rounding only.
    slack = 1 + 6 * rounding(task.world) * cost
    assert cost <= result.bound * result.lower_bound * slack + 1e-9
    assert sum(result.expansions_by) == result.expansions


@by_category
def test_the_bound_holds_whatever_the_guides_say(category):
    tasks = search_tasks(category)
    assert len(tasks) >= TASKS_PER_CATEGORY and len(CATEGORIES) * TASKS_PER_CATEGORY >= 500
    weights = [(1.0, 1.0), (1.0, 1.5), (1.25, 1.25), (2.0, 1.0), (2.0, 3.0)]
    for i, task in enumerate(tasks):
        w1, w2 = weights[i % len(weights)]
        for guide in GUIDES:
            result = found(task, [guide(task)], w1, w2)
            assert_within_bound(task, result, w1, w2)
            assert max(result.expansions_by) <= result.seen, "each state is expanded once for anchor and guide each"
        assert_within_bound(task, found(task, [exaggerated(task), random_or_nothing(task)], w1, w2), w1, w2)


@pytest.mark.xdist_group("search cuboid_wall")
def test_good_guides_help_and_wrong_ones_cost_something():
    """Otherwise valid bounds would prove nothing about guides."""
    spent, worse = Counter(), Counter()
    for task in search_tasks("cuboid_wall"):
        for guide in (informed, exaggerated, all_cut_off):
            result = found(task, [guide(task)], 1.5, 2.0)
            spent[guide] += result.expansions
            worse[guide] += result.cost[0] > task.cost * 1.01
    assert spent[informed] < spent[all_cut_off] and worse[exaggerated] > worse[informed]


@by_category
def test_weights_of_one_find_what_plain_dijkstra_finds(category):
    for task in search_tasks(category)[::3]:
        for guide in (exaggerated, astray):
            result = found(task, [guide(task)], 1.0, 1.0)
            assert result.cost[0] == pytest.approx(task.cost, rel=1e-5, abs=1e-6)
            assert result.bound == 1


@by_category
def test_plans_are_legal_and_as_dear_as_the_textbook_says(category):
    for task in search_tasks(category)[::5]:
        result = found(task, [exaggerated(task)], 1.5, 2.0)
        states = [tuple(state) for state in result.paths[0].states.tolist()]
        assert states[0] == task.start and states[-1] == task.goal
        edges = zip(states, states[1:], result.paths[0].actions, result.paths[0].costs, strict=False)
        for state, reached, code, cost in edges:
            legal = {(a, s): c for a, s, c in task.twin.successors(state)}
            assert legal[action_tuple(int(code)), reached] == pytest.approx(cost, rel=1e-6)


@by_category
def test_the_textbook_search_does_no_better(category):
    """Both keep the bound; the kernel's deviations from the textbook cost little, and help if guides are held back."""
    expansions = Counter()
    for task in search_tasks(category)[::10]:
        anchor, guide = anchor_of(task), exaggerated(task)
        h0, h1 = python_heuristic(task, anchor), python_heuristic(task, guide)
        successors = cache(lambda state, task=task: list(task.twin.successors(state)))
        for w1, w2 in ((1.25, 1.25), (2.0, 3.0)):
            cost, split = shared_mha(successors, task.start, task.goal, h0, [h1], w1, w2)
            assert task.cost - 1e-6 <= cost <= w1 * w2 * task.cost + 1e-6
            result = found(task, [guide], w1, w2)
            assert_within_bound(task, result, w1, w2)
            expansions["textbook"] += sum(split)
            expansions["kernel"] += result.expansions
    assert expansions["kernel"] <= 1.1 * expansions["textbook"]


@pytest.mark.xdist_group("search cuboid_wall")
@given(st.data(), st.floats(1, 5), st.floats(1, 5))
def test_the_bound_holds_for_any_weights(data, w1, w2):
    task = data.draw(st.sampled_from(search_tasks("cuboid_wall")[::9]))
    guides = data.draw(st.lists(st.sampled_from(GUIDES), min_size=1, max_size=2))
    assert_within_bound(task, found(task, [guide(task) for guide in guides], w1, w2), w1, w2)


@pytest.mark.xdist_group("search cuboid_wall")
def test_a_guide_alone_would_break_the_bound():
    """Otherwise the anchor would not be the reason for the bound."""
    broken = 0
    for task in search_tasks("cuboid_wall"):
        ends = np.array(task.start), np.array(task.goal)
        plain = solve(task.world, *ends, exaggerated(task), weight=1.0, admissible=False)
        broken += plain.cost[0] > task.cost * 1.05
        assert found(task, [exaggerated(task)], 1.0, 1.05).cost[0] <= task.cost * 1.05 * ROUNDED
    assert broken > 0


# --- how it ends ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def dear_task():
    return max(search_tasks("cuboid_wall"), key=lambda task: task.cost)


limits_group = pytest.mark.xdist_group("search cuboid_wall")


@limits_group
@pytest.mark.parametrize("weights", [(1.0, 1.0), (1.5, 2.0), (4.0, 4.0)])
def test_a_cost_limit_ends_with_its_own_status(dear_task, weights):
    limit = 0.99 * dear_task.cost
    below = found(dear_task, [exaggerated(dear_task)], *weights, limits=Limits(cost=limit))
    assert below.status == [Status.COST_LIMIT] and np.isinf(below.cost[0]) and np.isinf(below.bound)
    assert below.lower_bound == limit * (1 - rounding(dear_task.world) * limit), "as far as single precision proves"
    for task in search_tasks("cuboid_wall")[::4]:
        within = found(task, [exaggerated(task)], *weights, limits=Limits(cost=1.01 * task.cost))
        assert within.cost[0] <= 1.01 * task.cost + 1e-6
        assert_within_bound(task, within, *weights)


@limits_group
def test_an_expansion_limit_ends_with_its_own_status_and_what_is_proved(dear_task):
    needed = found(dear_task, [exaggerated(dear_task)], 1.5, 1.5).expansions
    result = found(dear_task, [exaggerated(dear_task)], 1.5, 1.5, limits=Limits(expansions=needed // 2))
    assert result.status == [Status.EXPANSION_LIMIT] and result.expansions == needed // 2
    assert 0 < result.lower_bound <= dear_task.cost and np.isinf(result.bound)
    again = found(dear_task, [exaggerated(dear_task)], 1.5, 1.5, limits=Limits(expansions=needed + 1))
    assert again.status == [Status.SOLVED]


@pytest.fixture(scope="module")
def long_way():
    """A world, a start, a goal, its anchor, and an uninformative guide, which makes the search large."""
    world = build_world(HeightMap.flat((80, 80)), NIMBLE)
    start, goal = np.array((20, 20, 0, 0, 0, 0, 0)), np.array((60, 60, 16, 0, 0, 0, 0))
    anchor = geometric_estimate(world, goal)
    return world, start, goal, anchor, [anchor._replace(distance=0.0, turn=0.0, foot=0.0)]


@pytest.fixture(scope="module")
def free(long_way):
    """Result without limits."""
    result = solve_multi(*long_way, anchor_weight=1.1)
    assert result.status == [Status.SOLVED] and result.expansions > life_cycle._SLICE
    return result


@pytest.mark.parametrize("share", [0.0, 0.3, 0.7, 1.0, 4.0])
def test_no_search_holds_more_memory_than_its_limit(long_way, free, share):
    limit = int(share * free.memory)
    result = solve_multi(*long_way, anchor_weight=1.1, limits=Limits(memory=limit))
    # A limit equal to the final memory leaves no space for the last copy into larger arrays.
    assert result.status == [Status.MEMORY_LIMIT if share <= 1 else Status.SOLVED]
    assert result.memory <= limit or result.expansions == 0
    assert 0 < result.open_memory < result.memory
    assert share < 0.5 or 3 * result.memory > limit or share > 1, "it gave up too early"


def test_growing_memory_loses_nothing(long_way, free, monkeypatch):
    monkeypatch.setattr(open_list, "_ROOM", 1)
    monkeypatch.setattr(life_cycle, "_SLICE", 700)
    after = solve_multi(*long_way, anchor_weight=1.1)
    assert (after.cost[0], after.expansions_by, after.seen) == (free.cost[0], free.expansions_by, free.seen)
    assert (after.paths[0].states == free.paths[0].states).all()


def test_a_time_limit_ends_with_its_own_status(long_way):
    seen = []
    result = solve_multi(*long_way, limits=Limits(time=0.0), progress=lambda *at: seen.append(at))
    assert result.status == [Status.TIME_LIMIT] and seen[0][0] > 0


@by_category
def test_infeasibility_is_proved_though_a_guide_leads_astray(category):
    proved = 0
    for task in search_tasks(category)[::12]:
        rules = Rules(heading_center=task.start[2], heading_window=1)
        behind = (task.start[2] + 32) % 64
        for goal in valid_states(task.twin, np.random.default_rng(3), 1, headings=[behind]):
            result = found(task._replace(goal=goal), [astray(task)], 1.5, 2.0, rules=rules)
            assert result.status == [Status.INFEASIBLE] and np.isinf(result.lower_bound) and np.isinf(result.bound)
            assert result.expansions >= result.seen
            proved += 1
    assert proved >= 1


def test_start_and_goal_must_be_valid(long_way):
    world, start, goal, anchor, guides = long_way
    off = np.array((0, 0, 0, 0, 0, 0, 0))
    assert solve_multi(world, off, goal, anchor, guides).status == [Status.INVALID_START]
    assert solve_multi(world, start, off, anchor, guides).status == [Status.INVALID_GOAL]
    same = solve_multi(world, goal, goal, anchor, guides)
    assert (same.status, same.cost[0], same.bound, len(same.paths[0].actions)) == ([Status.SOLVED], 0.0, 1.0, 0)


@pytest.mark.parametrize("weights", [(0.9, 1.0), (1.0, 0.5), (np.nan, 1.0), (1.0, np.inf)])
def test_wrong_weights_are_refused(long_way, weights):
    with pytest.raises(InputError, match="weight is"):
        solve_multi(*long_way, weight=weights[0], anchor_weight=weights[1])
    with pytest.raises(InputError, match="guide"):
        solve_multi(*long_way[:4], [])


# --- Planner.plan -----------------------------------------------------------------------------------------------------

START, GOAL = (0.7, 0.7, 0.0), (1.9, 1.9, 1.2)


@pytest.fixture(scope="module")
def rough():
    """A map of 2.75 m with a block in the way."""
    heights = np.zeros((110, 110), np.float32)
    heights[50:58, 50:54] = 0.15
    return HeightMap(heights)


class Changed(FlatCosts):
    """Abstract costs multiplied by a factor; inf cuts everything off."""

    factor = 5.0

    def edges(self, height_map, region=None, mask=None):
        return super().edges(height_map, region, mask) * self.factor


class CutsEverythingOff(Changed):
    factor = np.inf


@pytest.mark.parametrize("heuristic", ["manual", Changed("momaro"), CutsEverythingOff("momaro")])
def test_plans_with_an_anchor_keep_their_bound(rough, heuristic):
    least = Planner(rough).plan(START, GOAL)
    planner = Planner(rough, heuristic=heuristic)
    plain = planner.plan(START, GOAL, weight=1.2)
    assert 1 <= plain.bound < np.inf and plain.cost <= plain.bound * least.cost * ROUNDED
    plan = planner.plan(START, GOAL, weight=1.2, anchor_weight=1.3)
    assert plan.solved and 1 <= plan.bound <= 1.2 * 1.3
    assert least.cost <= plan.cost * ROUNDED and plan.cost <= plan.bound * least.cost * ROUNDED
    assert 0 < plan.stats["lower_bound"] <= least.cost
    assert plan.stats["anchor_weight"] == 1.3 and plan.stats["weight"] == 1.2
    by = plan.stats["expansions_by"]
    assert sum(by.values()) == plan.stats["expansions"] and list(by) == ["grid", planner.heuristic.name]
    assert plan.explain().startswith("solved")
    assert planner.plan(START, GOAL, weight=1.2, anchor_weight=1.3, refinable=True).solved


def test_an_admissible_heuristic_needs_no_anchor(rough):
    planner = Planner(rough)
    one, other = planner.plan(START, GOAL, weight=1.5), planner.plan(START, GOAL, weight=1.5, anchor_weight=2.0)
    assert (one.cost, one.bound, one.stats["expansions"]) == (other.cost, other.bound, other.stats["expansions"])


def test_limits_of_a_plan_with_an_anchor(rough):
    planner = Planner(rough, heuristic=Changed("momaro"))
    with pytest.raises(InputError, match=r"memory is 1000; a query on this map needs \d+ bytes at least") as refused:
        planner.plan(START, GOAL, anchor_weight=1.5, memory=1000)
    least = int(re.search(r"needs (\d+) bytes", str(refused.value))[1])
    for limit, status in (
        ({"expansions": 3}, Status.EXPANSION_LIMIT), ({"memory": least + 1000}, Status.MEMORY_LIMIT),
        ({"cost": 0.1}, Status.COST_LIMIT),
    ):  # fmt: skip
        plan = planner.plan(START, GOAL, anchor_weight=1.5, **limit)
        assert plan.status == status and np.isinf(plan.bound) and plan.explain()
    with pytest.raises(InputError, match="anchor_weight is"):
        planner.plan(START, GOAL, anchor_weight=0.5)
    assert planner.plan((0.1, 0.1, 0.0), GOAL, anchor_weight=1.5).status == Status.INVALID_START
