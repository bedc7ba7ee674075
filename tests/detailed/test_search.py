from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

from hdsp.detailed import solve as solving
from hdsp.detailed.estimate import geometric_estimate
from hdsp.detailed.solve import Limits, Status, solve
from hdsp.detailed.world import build_world
from hdsp.heightmap import HeightMap
from tests.detailed.instances import action_tuple, blocky, near_edges, toy, valid_states
from tests.naive import Naive, dijkstra, rotated, way_back

#: Steps come cheap here, so that a short textbook search finds many.
NIMBLE = toy(step={"cost": 0.004, "cost_per_metre": 0.31, "cost_per_height": 0.05}, base_shift={"cost_per_metre": 1.2})


def planned(world, start, goal, **options):
    return solve(world, np.array(start), np.array(goal), geometric_estimate(world, np.array(goal)), **options)


@pytest.fixture(scope="module")
def tasks():
    """Random tasks [(world, twin, start, goal, least cost, actions)] with what plain Dijkstra says of them."""
    found = []
    for seed in range(45):
        rng = np.random.default_rng(seed)
        robot = NIMBLE if seed % 3 else toy()
        heights = blocky(rng)
        world, twin = build_world(HeightMap(heights), robot), Naive(heights, robot)
        states = valid_states(twin, rng, 60, headings=[0, 16, 3, 40])
        starts = near_edges(twin, states)[:1] if seed % 5 else states[:1]
        starts = starts or states[:1]
        for start in starts:
            gone = dijkstra(twin, start, most=350)
            ways = {goal: way_back(gone, goal) for goal in gone.cost}
            stepping = [goal for goal, way in ways.items() if any(action[0] == "step" for action in way)]
            far = list(ways)[-50:]
            for pool, count in ((stepping, 3), (far, 3)):
                for i in rng.permutation(len(pool))[:count]:
                    goal = pool[i]
                    found.append((world, twin, start, goal, gone.cost[goal], ways[goal]))
    return found


@pytest.fixture(scope="module")
def solutions(tasks):
    return [planned(world, start, goal) for world, _, start, goal, _, _ in tasks]


def test_unweighted_search_finds_what_plain_dijkstra_finds(tasks, solutions):
    stepping = 0
    for (_, _, start, goal, least, way), result in zip(tasks, solutions, strict=True):
        assert result.status == [Status.SOLVED]
        assert result.cost[0] == pytest.approx(least, rel=1e-5, abs=1e-6), f"from {start} to {goal}"
        stepping += any(action[0] == "step" for action in way)
    assert len(tasks) >= 200
    assert stepping >= 60


def test_every_action_of_a_plan_is_legal_and_the_costs_add_up(tasks, solutions):
    kinds = Counter()
    for (_, twin, start, goal, _, _), result in zip(tasks, solutions, strict=True):
        states = [tuple(state) for state in result.states[0].tolist()]
        assert states[0] == start and states[-1] == goal
        edges = zip(states, states[1:], result.actions[0], result.edge_costs[0], strict=False)
        for state, reached, code, cost in edges:
            assert twin.valid(state)
            action = action_tuple(int(code))
            legal = {(a, s): c for a, s, c in twin.successors(state)}
            assert legal[action, reached] == pytest.approx(cost, rel=1e-6)
            kinds[action[0]] += 1
        assert len(states) == len(result.actions[0]) + 1 == len(result.edge_costs[0]) + 1
        assert sum(result.edge_costs[0]) == pytest.approx(result.cost[0], rel=1e-9)
    assert len(kinds) == 5 and min(kinds.values()) >= 5, kinds


def test_turning_keeps_the_feet_on_their_circle(tasks, solutions):
    turns = 0
    for (_, twin, _, _, _, _), result in zip(tasks, solutions, strict=True):
        for state, reached, code in zip(result.states[0], result.states[0][1:], result.actions[0], strict=False):
            if action_tuple(int(code))[0] != "turn":
                continue
            turns += 1
            assert (state[[0, 1, 3, 4, 5, 6]] == reached[[0, 1, 3, 4, 5, 6]]).all()
            for foot in range(4):
                x, y = twin.neutral(foot)
                on_circle = np.add(reached[:2], rotated(int(reached[2]), x + int(reached[3 + foot]), y))
                cell = twin.foothold(tuple(reached.tolist()), foot)
                assert abs(on_circle - cell).max() <= 0.5 + 1e-9
    assert turns > 20


@pytest.mark.parametrize("weight", [1.25, 2.0, 5.0])
def test_weighted_search_stays_within_its_bound(tasks, weight):
    worse = 0
    for world, _, start, goal, least, _ in tasks[::3]:
        result = planned(world, start, goal, weight=weight)
        assert result.status == [Status.SOLVED]
        assert least - 1e-6 <= result.cost[0] <= weight * least + 1e-6
        worse += result.cost[0] > least + 1e-5
    if weight == 5.0:
        assert worse > 0, "a heavily weighted search should not always be optimal"


def test_infeasibility_is_proved_as_by_exhausting_the_textbook_search():
    proved = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        heights = np.full((9, 9), np.nan, dtype=np.float32)
        heights[1:8, 1:8] = 0
        heights[4 + rng.integers(2) :, :] += rng.uniform(0.07, 0.3)
        robot = toy(feet={"offset_min": 0.0, "offset_max": 0.0})
        world, twin = build_world(HeightMap(heights), robot), Naive(heights, robot)
        states = valid_states(twin, rng, 20)
        if len(states) < 2:
            continue
        start, goal = states[0], states[-1]
        gone = dijkstra(twin, start, goals=[goal], most=1500)
        result = planned(world, start, goal)
        if goal in gone.cost:
            assert result.status == [Status.SOLVED]
            assert result.cost[0] == pytest.approx(gone.cost[goal], rel=1e-5, abs=1e-6)
        elif gone.exhausted:
            assert result.status == [Status.INFEASIBLE]
            assert np.isinf(result.cost[0]) and result.states == [None]
            assert result.seen == len(gone.cost)
            proved += 1
    assert proved >= 10


def test_many_goals_in_one_search_cost_what_they_cost_alone(tasks):
    world, _, start, _, _, _ = tasks[0]
    same_start = [task for task in tasks if task[0] is world and task[2] == start]
    goals = np.array([task[3] for task in same_start])
    blind = geometric_estimate(world, goals[0])._replace(distance=0.0, turn=0.0, foot=0.0)
    together = solve(world, np.array(start), goals, blind)
    assert len(goals) > 2
    assert together.cost == pytest.approx([task[4] for task in same_start], rel=1e-5)
    for goal, states in zip(goals, together.states, strict=True):
        assert (states[-1] == goal).all()


def dear_task(tasks):
    world, _, start, goal, least, _ = max(tasks, key=lambda task: task[4])
    return world, start, goal, least


def test_a_cost_limit_ends_with_its_own_status(tasks):
    world, start, goal, least = dear_task(tasks)
    below = planned(world, start, goal, limits=Limits(cost=0.99 * least))
    assert below.status == [Status.COST_LIMIT] and np.isinf(below.cost[0])
    assert planned(world, start, goal, limits=Limits(cost=1.01 * least)).status == [Status.SOLVED]


@pytest.mark.parametrize("weight", [1.5, 4.0])
def test_no_plan_costs_more_than_the_cost_limit(tasks, weight):
    for world, _, start, goal, least, _ in tasks[::4]:
        result = planned(world, start, goal, weight=weight, limits=Limits(cost=1.02 * least))
        assert result.status == [Status.SOLVED]
        assert result.cost[0] <= 1.02 * least + 1e-6


def test_an_expansion_limit_ends_with_its_own_status(tasks):
    world, start, goal, _ = dear_task(tasks)
    needed = planned(world, start, goal).expansions
    result = planned(world, start, goal, limits=Limits(expansions=needed // 2))
    assert result.status == [Status.EXPANSION_LIMIT] and result.expansions == needed // 2
    assert planned(world, start, goal, limits=Limits(expansions=needed + 1)).status == [Status.SOLVED]


def test_a_memory_limit_ends_with_its_own_status():
    world = build_world(HeightMap.flat((120, 120)), NIMBLE)
    start, goal = (20, 20, 0, 0, 0, 0, 0), (100, 100, 32, 0, 0, 0, 0)
    limit = 1 << 20
    result = planned(world, start, goal, limits=Limits(memory=limit))
    assert result.status == [Status.MEMORY_LIMIT]
    assert result.memory <= limit


def test_a_time_limit_ends_with_its_own_status():
    world = build_world(HeightMap.flat((120, 120)), NIMBLE)
    start, goal = (20, 20, 0, 0, 0, 0, 0), (100, 100, 32, 0, 0, 0, 0)
    seen = []
    result = planned(world, start, goal, limits=Limits(time=0.0), progress=lambda *at: seen.append(at))
    assert result.status == [Status.TIME_LIMIT]
    assert seen[0][0] > 0


def test_growing_memory_loses_nothing(monkeypatch):
    heights = blocky(np.random.default_rng(5), cells=40, blocks=4)
    world, twin = build_world(HeightMap(heights), NIMBLE), Naive(heights, NIMBLE)
    states = valid_states(twin, np.random.default_rng(6), 8, headings=[0, 1, 2])
    before = [planned(world, start, goal) for start, goal in pairwise(states)]
    ordinary = solving.new_store
    monkeypatch.setattr(solving, "new_store", lambda shape, neutral: ordinary(shape, neutral, blocks=0))
    for (start, goal), expected in zip(pairwise(states), before, strict=True):
        result = planned(world, start, goal)
        assert result.cost[0] == expected.cost[0]
        assert (result.expansions, result.seen) == (expected.expansions, expected.seen)
        assert (result.states[0] == expected.states[0]).all()
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
    assert (result.status, result.cost[0], len(result.actions[0])) == ([Status.SOLVED], 0.0, 0)
