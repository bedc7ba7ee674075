"""Tasks with two ways between the same poses, of four sorts.

- `obstacle`: over a block, or around it
- `rough`: over rough ground, or around it
- `stairs`: up stairs, or up a ramp
- `sideways`: the way that the planner chooses, or sideways or backward over the same ground
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from benchmarks.driven.tasks import KINDS, Pose, Task, map_of, noisy
from hdsp.planning.answers.plans import Plan
from hdsp.robot.robot import Robot
from hdsp.terrain.obstacles import Block, Obstacle, Ramp, Scene, Staircase, Tiles

SORTS = "obstacle", "rough", "stairs", "sideways"
_SIZE = 4.8, 3.6  # m
LANES = 0.9, 2.7  # m, y of the two ways


class Ways(NamedTuple):
    """A task and poses that each of its two ways passes."""

    sort: str
    task: Task
    through: tuple[tuple[Pose, ...], tuple[Pose, ...]]


def make_ways(seed: int, number: int, robot: Robot) -> Ways:
    """Returns a task with two ways."""
    random = np.random.default_rng((seed, len(KINDS), number))
    sort = SORTS[number % len(SORTS)]
    start, goal = (0.8, random.uniform(1.2, 1.8), 0.0), (4.0, random.uniform(1.2, 1.8), 0.0)
    obstacles, through = _grounds(sort, random, robot)
    scene = Scene(tuple(obstacles))
    return Ways(sort, Task(noisy(map_of(scene, _SIZE), random), scene, start, goal), through)


def _grounds(
    sort: str, random: np.random.Generator, robot: Robot
) -> tuple[list[Obstacle], tuple[tuple[Pose, ...], tuple[Pose, ...]]]:
    near, far = LANES
    middle, highest = _SIZE[0] / 2, min(0.2, robot.step.max_height)
    if sort == "obstacle":
        height, length = random.uniform(0.07, highest), random.uniform(0.3, 1.2)
        return [Block(middle, 0.4, 0.0, length, 3.0, height)], (((middle, near, 0.0),), ((middle, far, 0.0),))
    if sort == "rough":
        side, length = random.uniform(0.1, 0.25), random.uniform(0.8, 1.6)
        shape = math.ceil(length / side), math.ceil(3.0 / side)
        heights = random.uniform(0.0, random.uniform(0.3, 0.9) * robot.drive.highest_edge, shape)
        tiles = tuple(tuple((float(height), 0.0, 0.0) for height in row) for row in heights)
        field = Tiles(middle, 0.4, 0.0, length, 3.0, 0.0, side, tiles)
        return [field], (((middle, near, 0.0),), ((middle, far, 0.0),))
    if sort == "stairs":
        rise, steps = random.uniform(0.5, 1.0) * highest, int(random.integers(1, 3))
        run = rise * steps / math.tan(random.uniform(0.5, 0.85) * robot.slope.max_pitch)
        run, begin = min(run, 1.6), 1.5
        top = min(rise * steps, run * math.tan(0.9 * robot.slope.max_pitch))
        edge = begin + run
        stairs = Staircase(edge - 0.3 * (steps - 1), 0.4, 0.0, steps, top / steps, 0.3, 2.8, 6.0)
        platform = Block(edge + 3.0, 1.8, 0.0, 6.0, 6.0, top)
        ramp = Ramp(begin + run / 2, far, 0.0, run, 1.8, top)
        return [stairs, platform, ramp], (((1.0, near, 0.0),), ((1.0, far, 0.0),))
    turned = float(random.choice([math.pi / 2, -math.pi / 2, math.pi]))
    return [], ((), ((1.6, 1.5, turned), (3.2, 1.5, turned)))


def joined(plans: Sequence[Plan]) -> Plan:
    """Returns plans that follow on each other as one; each begins in the last state of the one before."""
    first = plans[0]
    return replace(
        first,
        cost=sum(plan.cost for plan in plans),
        states=np.concatenate([first.states, *(plan.states[1:] for plan in plans[1:])]),
        actions=tuple(action for plan in plans for action in plan.actions),
        action_costs=np.concatenate([plan.action_costs for plan in plans]),
        bound=math.inf,
    )
