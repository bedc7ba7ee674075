"""Plans on three hundred random staircases, platforms, bars, ramps and heaps of blocks are free, and become motions."""

import math

import numpy as np
import pytest

from hdsp.planning.collisions import check_plan
from hdsp.planning.planner import Planner
from hdsp.robot.robot import Robot
from hdsp.terrain.arenas import Arena
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.obstacles import Bank, Block, Scene, Staircase

KINDS = ("staircase", "platform", "bar", "ramp", "blocks")
SCENES = 60  # of each kind
CELLS_ACROSS = 72
MIDDLE = CELLS_ACROSS * 0.025 / 2
MARGIN = 0.025  # m, as in conf/planner
ROBOT = Robot.load("momaro")


def scene(kind: str, rng: np.random.Generator):
    """Obstacles ahead of a robot at (0.5, MIDDLE), and the place of a goal on them or behind them."""
    yaw, y = rng.uniform(-0.2, 0.2), MIDDLE + rng.uniform(-0.1, 0.1)
    if kind == "staircase":
        steps, rise, tread = int(rng.integers(1, 4)), rng.uniform(0.1, 0.25), rng.uniform(0.28, 0.35)
        return (Staircase(1.1, y, yaw, steps, rise, tread, rng.uniform(1.0, 2.0), 2.5),), 1.65 + (steps - 1) * tread
    if kind == "platform":
        return (Block(1.85, y, yaw, 1.5, rng.uniform(1.2, 2.0), rng.uniform(0.08, 0.3)),), 1.75
    if kind == "bar":
        thickness = rng.uniform(0.05, 0.1)  # thicker ones leave a foot no place behind them, or on them
        return (Block(1.1, y, yaw, thickness, rng.uniform(0.8, 2.4), rng.uniform(0.08, 0.3)),), 1.7 + thickness
    if kind == "ramp":
        run, angle = rng.uniform(0.6, 1.2), rng.uniform(0.05, min(ROBOT.slope.max_pitch, ROBOT.slope.max_roll))
        return (Bank(2.2, y, yaw, 2.8, rng.uniform(1.4, 2.0), run * math.tan(angle), run),), 1.9
    heights = [rng.uniform(0.02, 0.4) if rng.random() < 0.6 else 1.0 for _ in range(2)]
    places = rng.uniform((0.8, 0.0), (1.7, 2 * MIDDLE), (2, 2))
    return tuple(
        Block(*place, rng.uniform(-3, 3), *rng.uniform(0.05, 0.4, 2), height)
        for place, height in zip(places, heights, strict=True)
    ), 1.8


@pytest.mark.parametrize("kind", KINDS)
def test_plans_in_random_scenes_are_free(kind):
    solved = stepped = 0
    for number in range(SCENES):
        rng = np.random.default_rng([KINDS.index(kind), number])
        obstacles, x = scene(kind, rng)
        cells_ahead = 4 * math.ceil((x + 0.75) / 0.1)
        arena = Arena(cells_ahead * 0.025, Scene(obstacles))
        whole = arena.height_map()
        planner = Planner(HeightMap(whole.heights[:, :CELLS_ACROSS].copy(), whole.origin), ROBOT, margin=MARGIN)
        (y, aim), (heading, final) = MIDDLE + rng.uniform(-0.1, 0.1, 2), rng.uniform(-0.1, 0.1, 2)
        ends = (0.5, y, heading), (x, aim, final)
        # The map does not show the robot: an object within its body is an obstacle, and its start is invalid.
        plan = planner.plan(*ends, weight=10.0, expansions=100_000, refinable=kind != "blocks", start_free=False)
        if not plan.solved:
            continue
        solved, stepped = solved + 1, stepped + (plan.steps > 0)
        verdict = check_plan(arena, plan, ROBOT)
        assert verdict.free, (kind, number, verdict.collisions)
        assert min(verdict.body_clearance, verdict.foot_clearance) >= 0, (kind, number, verdict)
        if kind != "blocks":  # beside them a leg may be too short for a step
            assert not plan.refine().check(), (kind, number)
    least = {"bar": 0.6, "blocks": 0.4}.get(kind, 0.9)
    assert solved >= least * SCENES
    assert stepped >= {"ramp": 0, "blocks": 1}.get(kind, 0.9 * solved)
