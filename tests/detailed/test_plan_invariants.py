"""Properties of every plan from a search, for any robot, terrain, goal and weight."""

import math
from collections import Counter
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from hdsp.detailed.search.estimate import geometric_estimate
from hdsp.detailed.search.outcome import Limits, Status
from hdsp.detailed.search.weighted_astar import solve
from hdsp.detailed.world.world import build_world
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import CATEGORIES, random_map
from tests.detailed.instances import (
    action_tuple,
    by_category,
    near_edges,
    search_tasks,
    small_map,
    toy,
    valid_states,
)
from tests.naive import Naive, dijkstra
from tests.naive_ground import rotated

HALF_DIAGONAL = math.sqrt(0.5) + 1e-9  # a cell is at most this far from the point it was rounded from

robots = st.builds(
    lambda backward, clearance, level, dear: toy(
        feet={"clearance": clearance},
        drive={"level": level},
        base_shift={"backward": backward},
        step={"backward": backward, "cost": 0.05 if dear else 0.004},
    ),
    st.booleans(),
    st.sampled_from([0.0, 0.025]),
    st.sampled_from([0.07, 0.17]),
    st.booleans(),
)
terrains = st.builds(small_map, st.sampled_from(CATEGORIES), st.integers(0, 10_000), st.just(16))
property_test = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))


def planned(world, start, goal, **options):
    return solve(world, np.array(start), np.array(goal), geometric_estimate(world, np.array(goal)), **options)


@property_test
@given(robots, terrains, st.integers(0, 1000), st.booleans(), st.sampled_from([1.0, 1.25, 3.0]))
def test_plans_keep_what_a_robot_has_to_keep(robot, heights, seed, neutral, weight):
    rng = np.random.default_rng(seed)
    twin = Naive(heights, robot)
    states = valid_states(twin, rng, 25, neutral=neutral)
    assume(states)
    start = (near_edges(twin, states) + states)[0]
    for goal in [state for state in states if state != start][-3:]:
        result = planned(build_world(HeightMap(heights), robot), start, goal, weight=weight)
        assert result.status[0] in (Status.SOLVED, Status.INFEASIBLE)
        if result.status == [Status.SOLVED]:
            assert_legal(twin, start, goal, result)


@by_category
def test_plans_of_all_kinds_of_action_keep_them(category):
    kinds = Counter()
    for task in search_tasks(category):
        result = planned(task.world, task.start, task.goal)
        assert_legal(task.twin, task.start, task.goal, result)
        kinds.update(action_tuple(int(code))[0] for code in result.paths[0].actions)
    assert min(kinds[kind] for kind in MOTIONS) >= 5, kinds


@pytest.mark.parametrize("category", CATEGORIES)
def test_plans_of_momaro_keep_them_too(category):
    robot, solved = Robot.load("momaro"), 0
    for index in range(10):
        if solved == 2:
            break
        heights = random_map(17, category, index).heights
        twin, rng = Naive(heights, robot), np.random.default_rng(index)
        near = [state for state in valid_states(twin, rng, 30, headings=[0, 3, 16]) if inner(state, heights)]
        if near:
            start = (near_edges(twin, near) + near)[0]
            goal = list(dijkstra(twin, start, most=60).cost)[-1]
            result = planned(build_world(HeightMap(heights), robot), start, goal)
            assert result.status == [Status.SOLVED]
            assert_legal(twin, start, goal, result)
            solved += 1
    assert solved == 2


def inner(state, heights):
    return all(20 < at < n - 20 for at, n in zip(state[:2], heights.shape, strict=True))


def assert_legal(twin, start, goal, result):
    states = [tuple(state) for state in result.paths[0].states.tolist()]
    assert states[0] == start and states[-1] == goal
    assert len(states) == len(result.paths[0].actions) + 1 == len(result.paths[0].costs) + 1
    assert sum(result.paths[0].costs) == pytest.approx(result.cost[0], rel=1e-9)
    assert len(set(states)) == len(states), "a plan that comes by twice is not the cheapest"
    for state in states:
        assert twin.valid(state)
        assert not any(state[3:]) or twin.separated(state)
    for (state, reached), code, cost in zip(
        pairwise(states), result.paths[0].actions, result.paths[0].costs, strict=True
    ):
        action = action_tuple(int(code))
        legal = {(a, s): c for a, s, c in twin.successors(state)}
        assert legal[action, reached] == pytest.approx(cost, rel=1e-6)
        MOTIONS[action[0]](twin, state, reached, action)
        assert_base_passes(twin, state, reached)


def assert_driven(twin, state, reached, action):
    """Feet roll along straight lines and over no edge, also between the points that determine the cost."""
    assert reached[2:] == state[2:] and action[1:] == (reached[0] - state[0], reached[1] - state[1])
    for t in np.linspace(0, 1, 9):
        for foot in range(4):
            dx, dy = twin.foot_cell(state[2], foot, state[3 + foot], t * action[1], t * action[2])
            cell = state[0] + dx, state[1] + dy
            # Without clearance, a foot may cut a cell's corner between two of these points.
            if twin.robot.feet.clearance > 0:
                assert twin.inside(cell) and not twin.edge(cell), f"the foot at {cell} rolls over an edge"


def assert_turned(twin, state, reached, action):
    """The base stays, and every foot stays on its circle."""
    assert reached[:2] == state[:2] and reached[3:] == state[3:]
    assert (reached[2] - state[2]) % 64 in (1, 63)
    for at in (state, reached):
        for foot in range(4):
            x, y = twin.neutral(foot)
            radius = math.hypot(x + at[3 + foot], y)
            cell = twin.foothold(at, foot)
            assert abs(math.dist(cell, at[:2]) - radius) <= HALF_DIAGONAL
            on_circle = np.add(at[:2], rotated(at[2], x + at[3 + foot], y))
            assert abs(on_circle - cell).max() <= 0.5 + 1e-9


def assert_one_foot_moved(twin, state, reached, action):
    """Base and other feet stay; the foot moves by the action's length."""
    foot, length = action[1:]
    assert reached[:3] == state[:3]
    assert [b - a for a, b in zip(state[3:], reached[3:], strict=True)] == [
        length if i == foot else 0 for i in range(4)
    ]


def assert_shifted(twin, state, reached, action):
    """The feet stay while the base moves: each foot moves by rounding errors at most."""
    assert reached[2] == state[2] and len({b - a for a, b in zip(state[3:], reached[3:], strict=True)}) == 1
    for foot in range(4):
        assert np.abs(np.subtract(twin.foothold(state, foot), twin.foothold(reached, foot))).max() <= 1


MOTIONS = {
    "drive": assert_driven,
    "turn": assert_turned,
    "foot": assert_one_foot_moved,
    "shift": assert_shifted,
    "step": assert_one_foot_moved,
}


def assert_base_passes(twin, state, reached):
    """The base centre passes over nothing high enough to hit the body."""
    highest = min(float(twin.height(at[:2])) for at in (state, reached)) + max(b.above for b in twin.robot.body.boxes)
    for t in np.linspace(0, 1, 9):
        cell = tuple(np.rint(np.add(state[:2], t * np.subtract(reached[:2], state[:2]))).astype(int).tolist())
        assert not twin.known(cell) or twin.height(cell) <= highest + 1e-6


@property_test
@given(robots, st.integers(4, 11), st.integers(1, 3), st.integers(0, 6), st.integers(0, 1000), st.booleans())
def test_nobody_gets_through_a_wall(robot, at, thick, gap, seed, diagonal):
    """A wall across the map, straight or diagonal in steps of a cell, with a gap of some cells at one end."""
    heights = np.zeros((18, 18), dtype=np.float32)
    x, y = np.indices(heights.shape)
    along = x - (y - 9) if diagonal else x
    wall = (along >= at) & (along < at + thick + diagonal) & (y >= gap)
    heights[wall] = 0.5
    twin, world = Naive(heights, robot), build_world(HeightMap(heights), robot)
    states = valid_states(twin, np.random.default_rng(seed), 25)
    before = [state for state in states if along[state[:2]] < at]
    behind = [state for state in states if along[state[:2]] >= at + thick + diagonal]
    assume(before and behind)
    result = planned(world, before[0], behind[0])
    if gap == 0:
        assert result.status == [Status.INFEASIBLE]
    if result.status == [Status.SOLVED]:
        for state, reached in pairwise(result.paths[0].states):
            for t in np.linspace(0, 1, 17):
                cell = np.rint(state[:2] + t * (reached[:2] - state[:2])).astype(int)
                assert not wall[tuple(cell)], f"from {state} to {reached} the base goes through the wall"


@property_test
@given(robots, terrains, st.integers(0, 1000), st.sampled_from(["cost", "expansions", "memory", None]))
def test_statuses_are_honest(robot, heights, seed, limit):
    """Each search ends in agreement with plain Dijkstra or its limit."""
    rng = np.random.default_rng(seed)
    twin, world = Naive(heights, robot), build_world(HeightMap(heights), robot)
    start, goal = ((*base, int(rng.integers(64)), 0, 0, 0, 0) for base in rng.integers(0, 16, (2, 2)).tolist())
    limits = Limits(**{limit: {"cost": 0.2, "expansions": 40, "memory": 200_000}[limit]} if limit else {})
    result = planned(world, start, goal, limits=limits)
    status = result.status[0]
    found = result.paths != [None]
    assert np.isfinite(result.cost[0]) == found == (status == Status.SOLVED)
    if not twin.valid(start):
        assert status == Status.INVALID_START
        return
    if not twin.valid(goal):
        assert status == Status.INVALID_GOAL
        return
    gone = dijkstra(twin, start, [goal], most=700)
    if status == Status.SOLVED:
        assert not gone.exhausted
        assert goal not in gone.cost or result.cost[0] == pytest.approx(gone.cost[goal], rel=1e-5, abs=1e-6)
    elif status == Status.INFEASIBLE:
        assert goal not in gone.cost
    elif status == Status.COST_LIMIT:
        assert limit == "cost" and gone.cost.get(goal, np.inf) > 0.2
    elif status == Status.EXPANSION_LIMIT:
        assert limit == "expansions" and result.expansions == 40
    else:
        assert status == Status.MEMORY_LIMIT and limit == "memory" and 100_000 < result.memory <= 200_000
