"""Two hundred plans up and down random staircases; every plan becomes a motion."""

import math

import numpy as np
import pytest

from hdsp import HeightMap, Planner
from hdsp.robot.lattice import RESOLUTION

PLANS, GROUPS = 200, 8
BY_DAY = 0, 2, 3  # the shorter groups
AHEAD = 1.1  # m, to the first riser


def staircase(rng):
    """A staircase along x, and the poses below and above it."""
    steps, rise, tread = int(rng.integers(2, 5)), rng.uniform(0.15, 0.25), rng.uniform(0.25, 0.35)
    top = AHEAD + (steps - 1) * tread
    heights = np.zeros((math.ceil((top + 1.3) / 0.1) * 4, 60), np.float32)
    for step in range(steps):
        heights[math.ceil((AHEAD + step * tread) / RESOLUTION) :] = rise * (step + 1)
    return HeightMap(heights), (0.6, 0.75), (top + 0.65, 0.75)


@pytest.mark.parametrize(
    "group", [n if n in BY_DAY else pytest.param(n, marks=pytest.mark.nightly) for n in range(GROUPS)]
)
def test_plans_on_staircases_can_be_carried_out(group):
    rng = np.random.default_rng(group)
    done, drawn = 0, 0
    while done < PLANS // GROUPS:
        terrain, below, above = staircase(rng)
        planner = Planner(terrain, heuristic="manual").prepare()
        for _ in range(8):
            drawn += 1
            ends = [(*below, 0.0), (*above, 0.0)] if rng.random() < 0.6 else [(*above, math.pi), (*below, math.pi)]
            (x, y, theta), goal = ends
            start = (x, y + rng.uniform(-0.05, 0.05), theta + rng.uniform(-0.1, 0.1))
            plan = planner.plan(start, goal, weight=2, refinable=True, expansions=150_000)
            if not plan.solved or done == PLANS // GROUPS:
                break  # some staircases need longer searches, but the test is about motions
            done += 1
            motion = plan.refine()
            assert plan.steps >= 8
            assert motion.check() == [], plan.explain()
            assert motion.margins().min() >= planner.robot.stance.margin
            assert motion.heights_over_ground().min() >= -1e-4
            lengths = motion.leg_lengths()
            legs = planner.robot.legs
            assert legs.min_length <= lengths.min() and lengths.max() <= legs.max_length
    assert done == PLANS // GROUPS and drawn <= 2 * done
