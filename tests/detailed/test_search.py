"""Search results, compared with plain Dijkstra on random small maps of all categories."""

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.search import life_cycle
from hdsp.detailed.search.estimate import geometric_estimate, pose_estimate
from hdsp.detailed.search.outcome import Limits, Status
from hdsp.detailed.search.weighted_astar import solve
from hdsp.detailed.world.world import build_world
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import CATEGORIES
from tests.detailed.instances import (
    AHEAD_ONLY,
    FIXED_WHEELS,
    NIMBLE,
    SHORT_ARCS,
    TASKS_PER_CATEGORY,
    WIDE_ARCS,
    blocky,
    by_category,
    costs_to_go,
    near_edges,
    search_tasks,
    small_map,
    toy,
    valid_states,
    whole_graph,
)
from tests.naive import Naive


def planned(world, start, goal, **options):
    return solve(world, np.array(start), np.array(goal), geometric_estimate(world, np.array(goal)), **options)


def test_robots_whose_wheels_do_not_steer_find_what_plain_dijkstra_finds():
    tasks = search_tasks("cuboid_wall", (FIXED_WHEELS, AHEAD_ONLY, SHORT_ARCS, WIDE_ARCS))
    assert any(action[0] == "arc" for task in tasks for action in task.way)
    for task in tasks:
        for weight in (1.0, 2.0):
            result = planned(task.world, task.start, task.goal, weight=weight)
            assert result.status == [Status.SOLVED]
            assert task.cost * (1 - 1e-5) <= result.cost[0] <= weight * task.cost * (1 + 1e-5)


@by_category
def test_unweighted_search_finds_what_plain_dijkstra_finds(category):
    tasks = search_tasks(category)
    for task in tasks:
        result = planned(task.world, task.start, task.goal)
        assert result.status == [Status.SOLVED]
        assert result.cost[0] == pytest.approx(task.cost, rel=1e-5, abs=1e-6), f"from {task.start} to {task.goal}"
    assert len({(id(task.world), task.start, task.goal) for task in tasks}) == len(tasks) >= TASKS_PER_CATEGORY
    assert len(CATEGORIES) * TASKS_PER_CATEGORY >= 500
    assert sum(task.stepping for task in tasks) >= 20
    assert sum(task.off_neutral for task in tasks) >= 20
    assert sum(any(task.start[3:]) for task in tasks) >= 5


@by_category
def test_weighted_search_stays_within_its_bound(category):
    expansions = Counter()
    for task in search_tasks(category):
        for weight in (1.0, 1.25, 2.0, 3.0):
            result = planned(task.world, task.start, task.goal, weight=weight, paths=False)
            assert result.status == [Status.SOLVED]
            assert task.cost - 1e-6 <= result.cost[0] * (1 + 1e-6) and result.cost[0] <= weight * task.cost + 1e-6
            expansions[weight] += result.expansions
    assert expansions[3.0] < expansions[1.25] < expansions[1.0]


@by_category
def test_a_search_that_expands_no_state_twice_stays_within_its_bound_too(category):
    for task in search_tasks(category):
        goal = np.array(task.goal)
        for weight in (1.25, 3.0):
            guide = geometric_estimate(task.world, goal)
            result = solve(task.world, np.array(task.start), goal, guide, weight=weight, reopen=False)
            assert result.status == [Status.SOLVED]
            assert result.expansions <= result.seen
            assert task.cost - 1e-6 <= result.cost[0] * (1 + 1e-6) and result.cost[0] <= weight * task.cost + 1e-6
            assert result.cost[0] == result.paths[0].costs.sum()
            assert len(result.paths[0].states) == len(result.paths[0].actions) + 1


def exhausted(category):
    """Small worlds from a category with all states reachable from a start: [(world, twin, rules, start, graph)]."""
    found = []
    for index in range(40):
        rng = np.random.default_rng([9, CATEGORIES.index(category), index])
        heights = small_map(category, index, cells=11)
        rules = Rules(heading_center=0, heading_window=1)
        world, twin = build_world(HeightMap(heights), NIMBLE), Naive(heights, NIMBLE, window=1)
        states = valid_states(twin, rng, 30, headings=[0])
        for start in (near_edges(twin, states) + states)[:1]:
            graph = whole_graph(twin, start)
            if 150 < len(graph) < 1500:
                found.append((world, twin, rules, start, graph))
        if len(found) == 3:
            return found
    raise AssertionError("too few maps with enough states")


def inconsistent(world, to_go, rng):
    """An inconsistent estimate: exact costs-to-go for about half the poses, otherwise zero or a random share."""
    table = np.full((2, 64, world.nx, world.ny), np.inf, dtype=np.float32)
    for (ix, iy, heading, *feet), cost in to_go.items():
        entry = int(any(feet)), heading, ix, iy
        table[entry] = min(table[entry], np.float32(cost) * np.float32(0.99999))
    known = np.isfinite(table)  # states without a path to the goal keep no estimate
    shares = np.where(rng.random(table.shape) < 0.5, 1, rng.random(table.shape) * rng.integers(2, size=table.shape))
    table[known] *= shares[known].astype(np.float32)
    return pose_estimate(world, table, 0.0, np.zeros((1, 4)))._replace(foot=0.0, outside=0.0)


@by_category
def test_inconsistent_heuristics_lose_no_optimality_because_states_are_reopened(category):
    compared, reopened, worse = 0, 0, 0
    for world, _, rules, start, graph in exhausted(category):
        rng = np.random.default_rng(len(graph) + 4)
        ends = sorted(graph)
        for i in rng.permutation(len(ends))[:40]:
            goal = ends[i]
            to_go = costs_to_go(graph, goal)
            heuristic, task = inconsistent(world, to_go, rng), (np.array(start), np.array(goal))
            result = solve(world, *task, heuristic, rules=rules)
            assert result.status == [Status.SOLVED]
            assert result.cost[0] == pytest.approx(to_go[start], rel=1e-5, abs=1e-6), f"from {start} to {goal}"
            weighted = solve(world, *task, heuristic, rules=rules, weight=2.0)
            assert weighted.cost[0] <= 2 * to_go[start] + 1e-6
            never = solve(world, *task, heuristic, rules=rules, reopen=False)
            compared += 1
            reopened += result.expansions > never.expansions
            worse += never.cost[0] > to_go[start] * (1 + 1e-4)
    assert compared == 120
    assert reopened > 0 and worse > 0, "a search that never reopens should do worse: else this test shows nothing"


@by_category
def test_a_search_that_expands_no_state_twice_decides_a_cost_limit_as_plain_dijkstra_does(category):
    again, once = 0, 0
    for world, _, rules, start, graph in exhausted(category):
        rng = np.random.default_rng(len(graph) + 8)
        ends = sorted(graph)
        for i in rng.permutation(len(ends))[:40]:
            goal = ends[i]
            to_go = costs_to_go(graph, goal)
            guide, task = inconsistent(world, to_go, rng), (np.array(start), np.array(goal))
            guide = guide._replace(table=2 * guide.table)
            for share in (0.99, 1.0001, 1.2):
                limits = Limits(cost=share * to_go[start])
                result = solve(world, *task, guide, rules=rules, admissible=False, reopen=False, limits=limits)
                possible = to_go[start] <= limits.cost
                assert result.status == [Status.SOLVED if possible else Status.COST_LIMIT]
                assert not possible or to_go[start] * (1 - 1e-5) <= result.cost[0] <= limits.cost * (1 + 1e-6)
                once += result.expansions <= result.seen
                again += result.expansions > result.seen
            free = solve(world, *task, guide, rules=rules, admissible=False, reopen=False)
            assert free.status == [Status.SOLVED] and free.expansions <= free.seen
    assert once > 0 and again > 0, "both ends should occur: without and with a second round"


@by_category
def test_infeasibility_is_proved_by_exhausting_what_the_textbook_search_reaches(category):
    proved = 0
    for world, twin, rules, start, graph in exhausted(category):
        states = valid_states(twin, np.random.default_rng(0), 60, neutral=False, headings=[0, 1, 63])
        for goal in [state for state in states if state not in graph][:4]:
            result = planned(world, start, goal, rules=rules)
            assert result.status == [Status.INFEASIBLE]
            assert np.isinf(result.cost[0]) and result.paths == [None]
            assert result.seen == result.expansions == len(graph) or result.expansions > result.seen == len(graph)
            proved += 1
    assert proved >= 4


@by_category
def test_many_goals_in_one_search_end_as_they_do_alone(category):
    starts, statuses = {}, Counter()
    for task in search_tasks(category):
        starts.setdefault((id(task.world), task.start), []).append(task)
    for seed, tasks in enumerate(starts.values()):
        world, start = tasks[0].world, np.array(tasks[0].start)
        others = valid_states(tasks[0].twin, np.random.default_rng(seed), 3, neutral=seed % 2 > 0)
        off_the_map, twice = (0, 0, 0, 0, 0, 0, 0), tasks[0].goal
        goals = np.array([task.goal for task in tasks] + others + [off_the_map, twice])
        blind = geometric_estimate(world, goals[0])._replace(distance=0.0, turn=0.0, foot=0.0)
        together = solve(world, start, goals, blind)
        alone = [planned(world, start, goal) for goal in goals]
        assert together.status == [result.status[0] for result in alone]
        assert together.cost == pytest.approx([result.cost[0] for result in alone], rel=1e-5, abs=1e-6)
        for goal, cost, path in zip(goals, together.cost, together.paths, strict=True):
            assert path is None if np.isinf(cost) else (path.states[[0, -1]] == [start, goal]).all()
        statuses.update(together.status)
    assert min(statuses[kind] for kind in (Status.SOLVED, Status.INFEASIBLE, Status.INVALID_GOAL)) >= 1, statuses


@pytest.fixture(scope="module")
def dear_task():
    """World, start, goal and least cost for a task with several expansions."""
    tasks = search_tasks("cuboid_wall")
    return max(tasks, key=lambda task: task.cost)


limits_group = pytest.mark.xdist_group("search cuboid_wall")


@limits_group
def test_a_cost_limit_ends_with_its_own_status(dear_task):
    world, _, start, goal, least, _ = dear_task
    below = planned(world, start, goal, limits=Limits(cost=0.99 * least))
    assert below.status == [Status.COST_LIMIT] and np.isinf(below.cost[0])
    assert planned(world, start, goal, limits=Limits(cost=1.01 * least)).status == [Status.SOLVED]


@limits_group
@pytest.mark.parametrize("weight", [1.5, 4.0])
def test_no_plan_costs_more_than_the_cost_limit(weight):
    for task in search_tasks("cuboid_wall"):
        result = planned(task.world, task.start, task.goal, weight=weight, limits=Limits(cost=1.02 * task.cost))
        assert result.status == [Status.SOLVED]
        assert result.cost[0] <= 1.02 * task.cost + 1e-6


@limits_group
def test_an_expansion_limit_ends_with_its_own_status(dear_task):
    world, _, start, goal, _, _ = dear_task
    needed = planned(world, start, goal).expansions
    result = planned(world, start, goal, limits=Limits(expansions=needed // 2))
    assert result.status == [Status.EXPANSION_LIMIT] and result.expansions == needed // 2
    assert planned(world, start, goal, limits=Limits(expansions=needed + 1)).status == [Status.SOLVED]


@pytest.fixture(scope="module")
def long_way():
    """A world, a start and a goal with a search that takes more than 0.6 MB and more than one check of the clock."""
    return build_world(HeightMap.flat((120, 120)), NIMBLE), (20, 20, 0, 0, 0, 0, 0), (100, 100, 32, 0, 0, 0, 0)


@pytest.mark.parametrize("limit", [200_000, 300_000, 600_000, 1 << 21, 1 << 24])
def test_no_search_holds_more_memory_than_its_limit(long_way, limit):
    result = planned(*long_way, limits=Limits(memory=limit))
    assert result.status == [Status.MEMORY_LIMIT if limit < 1 << 20 else Status.SOLVED]
    assert result.memory <= limit
    assert result.status == [Status.SOLVED] or 2 * result.memory > limit, "it gave up too early"


@pytest.mark.parametrize("limit", [0, 100_000])
def test_nothing_is_searched_where_even_an_empty_store_takes_too_much_memory(long_way, limit):
    result = planned(*long_way, limits=Limits(memory=limit))
    assert result.status == [Status.MEMORY_LIMIT] and result.expansions == 0


def test_a_time_limit_ends_with_its_own_status(long_way):
    seen = []
    result = planned(*long_way, limits=Limits(time=0.0), progress=lambda *at: seen.append(at))
    assert result.status == [Status.TIME_LIMIT]
    assert seen[0][0] > 0


def test_growing_memory_loses_nothing(monkeypatch):
    heights = blocky(np.random.default_rng(5), cells=40, blocks=4)
    world, twin = build_world(HeightMap(heights), NIMBLE), Naive(heights, NIMBLE)
    states = valid_states(twin, np.random.default_rng(6), 8, headings=[0, 1, 2])
    before = [planned(world, start, goal) for start, goal in pairwise(states)]
    ordinary = life_cycle.new_store
    monkeypatch.setattr(life_cycle, "new_store", lambda shape, neutral: ordinary(shape, neutral, blocks=0))
    for (start, goal), expected in zip(pairwise(states), before, strict=True):
        result = planned(world, start, goal)
        assert result.cost[0] == expected.cost[0]
        assert (result.expansions, result.seen) == (expected.expansions, expected.seen)
        assert (result.paths[0].states == expected.paths[0].states).all()
    assert sum(result.seen > 4096 for result in before) >= 3


def test_start_and_goal_must_be_valid():
    heights = np.zeros((12, 12), dtype=np.float32)
    heights[6, 6] = np.nan
    world = build_world(HeightMap(heights), toy())
    good, bad = (3, 3, 0, 0, 0, 0, 0), (4, 5, 0, 0, 0, 0, 0)
    assert planned(world, bad, good).status == [Status.INVALID_START]
    assert planned(world, good, bad).status == [Status.INVALID_GOAL]


def test_a_start_that_is_the_goal_costs_nothing():
    world = build_world(HeightMap.flat((12, 12)), toy())
    state = (6, 6, 5, 0, 0, 0, 0)
    result = planned(world, state, state)
    assert (result.status, result.cost[0], len(result.paths[0].actions)) == ([Status.SOLVED], 0.0, 0)
