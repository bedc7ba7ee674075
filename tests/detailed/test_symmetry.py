"""Mirrored and quarter-turned worlds cost what the original costs: labels and plans."""

import numpy as np
import pytest

from hdsp.detailed.estimate import geometric_estimate
from hdsp.detailed.solve import Status, solve
from hdsp.detailed.world import build_world
from hdsp.heightmap import HeightMap
from hdsp.labelling import label_map
from hdsp.lattice import ABSTRACT_ACTIONS, HEADINGS
from hdsp.robot import Robot
from hdsp.terrain import CATEGORIES, random_map
from tests.detailed.instances import blocky, near_edges, toy, valid_states
from tests.naive import Naive, dijkstra

ACTIONS = [tuple(action) for action in ABSTRACT_ACTIONS.tolist()]
CELLS = 73  # odd, so that the start cell in the middle stays there


def mirrored_state(state, ny):
    x, y, heading, f0, f1, f2, f3 = state
    return x, ny - 1 - y, -heading % HEADINGS, f3, f2, f1, f0


def quarter_turned_state(state, ny):
    x, y, heading, *feet = state
    return ny - 1 - y, x, (heading + HEADINGS // 4) % HEADINGS, *feet


def quarter_turned(heights):
    """heights[x, y] goes to [ny - 1 - y, x]: counter-clockwise."""
    return np.ascontiguousarray(heights[:, ::-1].T)


def assert_same_labels(first, second, actions):
    """Action m of the first map is action ``actions(m)`` of the second."""
    order = [ACTIONS.index(actions(*action)) for action in ACTIONS]
    assert (first.feasible == second.feasible[order]).all()
    np.testing.assert_allclose(first.cost, second.cost[order], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("category", CATEGORIES)
def test_labels_of_mirrored_and_turned_maps(category):
    robot = Robot.load("momaro")
    heights = random_map(21, category, 0, cells=CELLS).heights
    labels = label_map(HeightMap(heights), robot)
    mirrored = label_map(HeightMap(heights[:, ::-1]), robot)
    turned = label_map(HeightMap(quarter_turned(heights)), robot, start_heading=HEADINGS // 4)
    if labels is None:
        assert mirrored is None and turned is None
        return
    assert_same_labels(labels, mirrored, lambda dx, dy, turn: (dx, -dy, -turn))
    assert_same_labels(labels, turned, lambda dx, dy, turn: (-dy, dx, turn))


def test_plans_of_mirrored_and_turned_worlds_cost_the_same():
    robot = toy(step={"cost": 0.004, "cost_per_metre": 0.31})
    compared = stepping = 0
    for seed in range(40):
        rng = np.random.default_rng(1000 + seed)
        heights = blocky(rng, cells=14)
        twin = Naive(heights, robot)
        starts = near_edges(twin, valid_states(twin, rng, 60))[:1]
        if not starts:
            continue
        goals = list(dijkstra(twin, starts[0], most=60).cost)
        start, goal = starts[0], goals[-1]
        there = cost(heights, robot, start, goal)
        ny = heights.shape[1]
        mirrored = cost(heights[:, ::-1], robot, mirrored_state(start, ny), mirrored_state(goal, ny))
        turns = [quarter_turned_state(state, ny) for state in (start, goal)]
        turned = cost(quarter_turned(heights), robot, *turns)
        assert mirrored == pytest.approx(there, rel=1e-5)
        assert turned == pytest.approx(there, rel=1e-5)
        compared += 1
        stepping += any(goal[3:])
    assert compared >= 20 and stepping >= 5


def cost(heights, robot, start, goal):
    world = build_world(HeightMap(heights), robot)
    result = solve(world, np.array(start), np.array(goal), geometric_estimate(world, np.array(goal)))
    assert result.status == [Status.SOLVED]
    return result.cost[0]
