"""Mirrored and quarter-turned worlds have the original's costs: actions, feet, plans and labels."""

from collections import Counter

import numpy as np
import pytest

from hdsp.abstract.transform import best_feet, feet_at
from hdsp.detailed.search.estimate import geometric_estimate
from hdsp.detailed.search.outcome import Status
from hdsp.detailed.search.weighted_astar import solve
from hdsp.detailed.world.world import build_world
from hdsp.labels.rules import label_map
from hdsp.robot.lattice import ABSTRACT_ACTIONS, HEADINGS
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import CATEGORIES, random_map
from tests.detailed.instances import (
    FIXED_WHEELS,
    NIMBLE,
    WIDE_ARCS,
    action_tuple,
    by_category,
    kernel_successors,
    near_edges,
    search_tasks,
    small_map,
    toy,
    valid_states,
)
from tests.naive import Naive

ACTIONS = [tuple(action) for action in ABSTRACT_ACTIONS.tolist()]
CELLS = 73  # odd, so that the start cell in the middle stays there
MIRRORED_FEET = (3, 2, 1, 0)
KINDS = ("drive", "turn", "foot", "shift", "step")
MOMARO = Robot.load("momaro")
FIXED_MOMARO = Robot.load({**MOMARO.to_dict(), "drive": {**MOMARO.to_dict()["drive"], "sideways": False}})


def mirrored_state(state, ny):
    x, y, heading, f0, f1, f2, f3 = state
    return x, ny - 1 - y, -heading % HEADINGS, f3, f2, f1, f0


def quarter_turned_state(state, ny):
    x, y, heading, *feet = state
    return ny - 1 - y, x, (heading + HEADINGS // 4) % HEADINGS, *feet


def mirrored_action(kind, *what):
    if kind == "drive":
        return kind, what[0], -what[1]
    if kind == "turn":
        return kind, -what[0]
    if kind == "arc":
        return kind, what[0], -what[1]
    return (kind, MIRRORED_FEET[what[0]], what[1]) if kind in ("foot", "step") else (kind, *what)


def quarter_turned_action(kind, *what):
    return (kind, -what[1], what[0]) if kind == "drive" else (kind, *what)


def mirrored(heights):
    return np.ascontiguousarray(heights[:, ::-1])


def quarter_turned(heights):
    """Rotates counter-clockwise: heights[x, y] goes to [ny - 1 - y, x]."""
    return np.ascontiguousarray(heights[:, ::-1].T)


#: Symmetries: functions for heights, for a state (given the number of cells along y), and for an action.
VIEWS = [(mirrored, mirrored_state, mirrored_action), (quarter_turned, quarter_turned_state, quarter_turned_action)]


@pytest.mark.parametrize(
    "category, robot",
    [
        (category, robot)
        for category in CATEGORIES
        for robot in (NIMBLE, FIXED_WHEELS, WIDE_ARCS, toy(step={"backward": False}))
    ]
    + [(category, MOMARO) for category in CATEGORIES[2::3]],
)
def test_actions_of_mirrored_and_turned_states(category, robot):
    kinds = Counter()
    for index in range(6):
        heights = random_map(21, category, index).heights if robot is MOMARO else small_map(category, index)
        twin, rng = Naive(heights, robot), np.random.default_rng(index)
        states = valid_states(twin, rng, 25)
        states = near_edges(twin, states)[:8] + states[:2] + valid_states(twin, rng, 4, neutral=False)
        world, ny = build_world(HeightMap(heights), robot), heights.shape[1]
        seen = [(build_world(HeightMap(of(heights)), robot), state, action) for of, state, action in VIEWS]
        for state in states:
            original = kernel_successors(world, state)
            kinds.update(action[0] for action, _ in original)
            for other, of_state, of_action in seen:
                expected = {(of_action(*a), of_state(s, ny)): cost for (a, s), cost in original.items()}
                assert kernel_successors(other, of_state(state, ny)) == pytest.approx(expected, rel=1e-5), state
    turning = "turn" if robot.turn.on_the_spot else "arc"
    assert min(kinds[kind if kind != "turn" else turning] for kind in KINDS) >= 1, kinds


@pytest.mark.parametrize("robot", [toy(), MOMARO], ids=["toy", "momaro"])
@pytest.mark.parametrize("category", CATEGORIES)
def test_feet_of_mirrored_and_turned_abstract_states(category, robot):
    found = off_neutral = 0
    for index in range(5):
        heights = random_map(22, category, index).heights if robot is MOMARO else small_map(category, index)
        world, (nx, ny) = build_world(HeightMap(heights), robot), heights.shape
        seen = [(build_world(HeightMap(of(heights)), robot), state) for of, state, _ in VIEWS]
        rng = np.random.default_rng(index)
        for _ in range(60):
            base = int(rng.integers(nx)), int(rng.integers(ny)), int(rng.integers(HEADINGS))
            state = feet_at(world, base)
            for other, of_state in seen:
                same_base = of_state((*base, 0, 0, 0, 0), ny)[:3]
                value, _ = best_feet(other, *same_base)
                assert value == pytest.approx(best_feet(world, *base)[0], rel=1e-5), base
                if state is not None:
                    assert tuple(feet_at(other, same_base).tolist()) == of_state(tuple(state.tolist()), ny)
            if state is not None:
                found += 1
                off_neutral += any(state[3:])
    assert found >= 10 and off_neutral >= 3


def assert_same_labels(first, second, actions):
    """Action m on the first map is action ``actions(m)`` on the second."""
    order = [ACTIONS.index(actions(*action)) for action in ACTIONS]
    assert (first.feasible == second.feasible[order]).all()
    np.testing.assert_allclose(first.cost, second.cost[order], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    "category, robot, maps",
    [(category, MOMARO, 12) for category in CATEGORIES]
    + [(category, FIXED_MOMARO, 8) for category in CATEGORIES[1::3]],
)
def test_labels_of_mirrored_and_turned_maps(category, robot, maps):
    feasible, off_neutral = 0, 0
    for index in range(maps):
        heights = random_map(21, category, index, cells=CELLS).heights
        labels = label_map(HeightMap(heights), robot)
        reflected = label_map(HeightMap(mirrored(heights)), robot)
        turned = label_map(HeightMap(quarter_turned(heights)), robot, start_heading=HEADINGS // 4)
        if labels is None:
            assert reflected is None and turned is None
            continue
        assert_same_labels(labels, reflected, lambda dx, dy, turn: (dx, -dy, -turn))
        assert_same_labels(labels, turned, lambda dx, dy, turn: (-dy, dx, turn))
        feasible += labels.feasible.sum()
        off_neutral += labels.feasible[abs(labels.goal[:, 3:]).max(axis=1) > 1e-6].sum()
    assert feasible >= 6
    assert off_neutral >= 1 or "staircase" not in category


@by_category
def test_plans_of_mirrored_and_turned_worlds_cost_the_same(category):
    tasks, kinds = search_tasks(category), Counter()
    for task in tasks[:: len(tasks) // 30]:
        heights = np.array(task.twin.heights)
        ny = heights.shape[1]
        there = plan(heights, task.twin.robot, task.start, task.goal)
        assert there.cost[0] == pytest.approx(task.cost, rel=1e-5, abs=1e-6)
        for of, of_state, _ in VIEWS:
            other = plan(of(heights), task.twin.robot, of_state(task.start, ny), of_state(task.goal, ny))
            assert other.cost[0] == pytest.approx(task.cost, rel=1e-5, abs=1e-6)
        kinds.update(action_tuple(int(code))[0] for code in there.paths[0].actions)
    assert min(kinds[kind] for kind in KINDS) >= 2, kinds


def plan(heights, robot, start, goal):
    world = build_world(HeightMap(heights), robot)
    result = solve(world, np.array(start), np.array(goal), geometric_estimate(world, np.array(goal)))
    assert result.status == [Status.SOLVED]
    return result
