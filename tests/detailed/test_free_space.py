"""Costs between poses on even ground: against a textbook search, consistent, and almost exact."""

import heapq
import math

import numpy as np
import pytest

from hdsp.base.jit import njit
from hdsp.detailed.search.estimate import least_foot_cost
from hdsp.detailed.search.free_space import free_cost, new_free_space
from hdsp.detailed.world.world import build_world
from hdsp.robot.lattice import HEADINGS
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from tests.detailed.instances import FIXED_WHEELS, SHORT_ARCS, toy
from tests.naive import Naive
from tests.naive_ground import CELL, INF, MOVES

REACH = 7  # cells
AHEAD_SHIFTS = toy(base_shift={"backward": False})
COVERED = Robot.load("momaro"), AHEAD_SHIFTS


@njit()
def costs(free, turn, first, poses):
    found = np.empty(len(poses))
    for i in range(len(poses)):
        found[i] = free_cost(free, turn, poses[i, 0], poses[i, 1], first, poses[i, 2])
    return found


def from_pose(robot, first, poses):
    world = build_world(HeightMap.flat((8, 8)), robot)
    free = new_free_space(world, least_foot_cost(world))
    assert len(free.norm) > 0
    return costs(free, world.constants.turn, first, np.array(poses))


def edges(robot, twin, heading):
    """Drives, turns, and base shifts with the feet that follow, on even ground: (dx, dy, heading, cost)."""
    for dx, dy in MOVES:
        yield dx, dy, heading, math.hypot(dx, dy) * CELL * twin.deviation(heading, dx, dy)
    for way in (1, -1):
        yield 0, 0, (heading + way) % HEADINGS, robot.turn.cost
    steps, dx, dy = twin.shift(heading)
    step, longest = robot.step, twin.longest_step()
    follow = min(robot.foot_move.cost_per_metre * CELL, step.cost_per_metre * CELL + step.cost / longest)
    yield dx, dy, heading, math.hypot(dx, dy) * CELL * robot.base_shift.cost_per_metre + 4 * steps * follow


def textbook(robot, first):
    """Least costs from (0, 0, first) to all poses within reach, by Dijkstra's algorithm."""
    twin = Naive(np.zeros((4, 4)), robot)
    out = {heading: list(edges(robot, twin, heading)) for heading in range(HEADINGS)}
    best, settled, queue = {(0, 0, first): 0.0}, {}, [(0.0, (0, 0, first))]
    while queue:
        cost, pose = heapq.heappop(queue)
        if pose in settled:
            continue
        settled[pose] = cost
        x, y, heading = pose
        for dx, dy, new, price in out[heading]:
            reached = x + dx, y + dy, new
            if max(abs(reached[0]), abs(reached[1])) <= REACH and cost + price < best.get(reached, INF):
                best[reached] = cost + price
                heapq.heappush(queue, (cost + price, reached))
    return settled


@pytest.mark.parametrize("robot", COVERED, ids=lambda robot: robot.name)
@pytest.mark.parametrize("first", [0, 7])
def test_costs_on_even_ground_are_a_close_lower_bound(robot, first):
    exact = textbook(robot, first)
    found = from_pose(robot, first, list(exact))
    known = np.array(list(exact.values()))
    assert len(exact) == HEADINGS * (2 * REACH + 1) ** 2
    assert (found <= known * (1 + 1e-12) + 1e-12).all()
    # Moves count in real multiples: over a few cells, this matters; the greatest lower bound otherwise is about 0.8.
    assert np.mean(found[known > 0] / known[known > 0]) > 0.96


@pytest.mark.parametrize("robot", COVERED, ids=lambda robot: robot.name)
def test_costs_on_even_ground_fall_by_no_more_than_an_action_costs(robot):
    twin, rng = Naive(np.zeros((4, 4)), robot), np.random.default_rng(0)
    for first in (3, 30):
        poses = np.column_stack([rng.integers(-90, 90, (300, 2)), rng.integers(HEADINGS, size=300)])
        moves = [(pose, *edge) for pose in poses.tolist() for edge in edges(robot, twin, pose[2])]
        here = from_pose(robot, first, [pose for pose, *_ in moves])
        there = from_pose(robot, first, [(pose[0] + dx, pose[1] + dy, new) for pose, dx, dy, new, _ in moves])
        assert (there <= here + np.array([price for *_, price in moves]) + 1e-9).all()


@pytest.mark.parametrize("robot", [toy(), FIXED_WHEELS, SHORT_ARCS], ids=["shifts", "wheels", "arcs"])
def test_other_robots_have_no_such_costs(robot):
    world = build_world(HeightMap.flat((8, 8)), robot)
    follow = 0.0 if world.constants.shift_backward else least_foot_cost(world)
    assert new_free_space(world, follow).nbytes() == 0
