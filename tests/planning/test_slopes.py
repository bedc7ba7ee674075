"""Plans on slopes up to the robot's limit; steeper ground is refused, and the reason is told."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import slopes
from hdsp.planning.collisions import check_plan
from hdsp.planning.planner import Planner
from hdsp.robot.robot import FEET, Robot
from hdsp.terrain.arenas import Arena
from hdsp.terrain.obstacles import Bank, Ramp, Scene, TiltedGround

ROBOT = Robot.load("momaro")
LIMIT = min(ROBOT.slope.max_pitch, ROBOT.slope.max_roll)


def on_wheels():
    """The robot without steps."""
    values = ROBOT.to_dict()
    return Robot.load({**values, "step": {**values["step"], "max_length": 0.0}})


def checked_plan(arena, planner, start, goal, weight=2.0):
    plan = planner.plan(start, goal, weight=weight)
    assert plan.solved, (plan.explain(), start, goal)
    assert plan.refine().check() == []
    verdict = check_plan(arena, plan, ROBOT)
    assert verdict.free, (verdict.collisions, start, goal)
    return plan


def tilted(angle, direction):
    slope = math.tan(angle)
    return Arena(3.0, Scene((), TiltedGround(slope * math.cos(direction), slope * math.sin(direction))))


@pytest.mark.parametrize("angle", [0.1, 0.2, 0.25, LIMIT])
def test_any_pose_on_a_plane_is_reached_in_any_direction(angle):
    rng = np.random.default_rng(round(angle * 1000))
    arena = tilted(angle, rng.uniform(-math.pi, math.pi))
    planner = Planner(arena.height_map(), ROBOT)
    start = (1.5, 1.5, rng.uniform(-math.pi, math.pi))
    for _ in range(3):
        plan = checked_plan(arena, planner, start, (*rng.uniform(0.7, 2.3, 2), rng.uniform(-math.pi, math.pi)))
        (leaning,) = re.findall(r"leans by up to (\d+) degrees", plan.explain())
        assert abs(int(leaning) - math.degrees(angle)) <= 1.5  # feet are as high as the cells under them


def test_ramps_between_landings_are_driven_up_down_and_across():
    angle, run = 0.9 * LIMIT, 1.6
    arena = Arena(4.0, Scene((Bank(2.6, 2.0, 0.0, 2.8, 4.0, run * math.tan(angle), run),)))
    planner = Planner(arena.height_map(), ROBOT, heuristic="manual")
    flat, ramp, landing = (0.6, 1.8, 0.0), (2.0, 2.2, math.pi / 2), (3.4, 1.9, 3.0)
    for start, goal in ((flat, landing), (ramp, flat), (landing, ramp), (ramp, landing)):
        checked_plan(arena, planner, start, goal)


def test_ground_beyond_the_limit_is_refused_in_words():
    for angle, direction in ((LIMIT + math.radians(2), 2.0), (math.radians(40), 0.0)):
        plan = Planner(tilted(angle, direction).height_map(), ROBOT).plan((1.0, 1.5, 0.0), (2.2, 1.5, 0.0))
        assert not plan.solved
        assert f"too steep there, {math.degrees(angle):.1f} degrees" in plan.explain(), plan.explain()


def test_a_ramp_of_43_degrees_is_refused_in_words():
    arena = Arena(4.0, Scene((Bank(2.6, 2.0, 0.0, 2.8, 4.0, 1.0 * math.tan(math.radians(43)), 1.0),)))
    plan = Planner(arena.height_map(), ROBOT).plan((0.6, 2.0, 0.0), (3.4, 2.0, 0.0))
    assert not plan.solved and "too steep" in plan.explain(), plan.explain()


@pytest.mark.parametrize(("height", "smear"), [(0.08, 0.05), (0.08, 0.15), (0.12, 0.1), (0.2, 0.05), (0.2, 0.15)])
def test_smeared_kerbs_are_not_rolled_over(height, smear):
    arena = Arena(2.4, Scene((Bank(1.8, 1.2, 0.0, 1.2, 2.4, height, smear),)))
    plan = Planner(arena.height_map(), on_wheels()).plan((0.6, 1.2, 0.0), (1.8, 1.2, 0.0))
    assert not plan.solved and "no way" in plan.explain()


def test_both_checks_find_ground_that_is_too_steep():
    steep = on_steep_ground()
    arena = Arena(4.0, Scene((Ramp(2.8, 2.0, 0.0, 2.4, 4.0, 2.4 * math.tan(math.radians(25))),)))
    plan = Planner(arena.height_map(), steep).plan((0.8, 2.0, 0.0), (2.8, 2.0, 0.0), weight=2.0)
    assert plan.solved
    assert check_plan(arena, plan, steep).free
    found = check_plan(arena, plan, ROBOT).collisions
    assert {hit.part for hit in found} == {f"{name} foot" for name in FEET}
    assert all("steeper than 15.5 degrees: 25.0" in hit.why for hit in found)
    motion = plan.refine()
    assert motion.check() == []
    stricter = replace(steep, slope=ROBOT.slope)
    assert any("foot is steeper than 15.5 degrees: 25" in line for line in replace(motion, robot=stricter).check())


def on_steep_ground():
    """The robot with a limit of 30 degrees."""
    values = ROBOT.to_dict()
    limits = {"max_pitch": math.radians(30), "max_roll": math.radians(30)}
    return Robot.load({**values, "slope": limits, "stance": {**values["stance"], **limits}})


def test_the_benchmark_reaches_all_goals_up_to_the_limit(monkeypatch):
    monkeypatch.setattr(slopes, "TILTS", (0.0, 10.0))
    monkeypatch.setattr(slopes, "DIRECTIONS", (0.0, 0.75 * math.pi))
    result = slopes.main(["--goals", "2", "--heuristic", "geometric", "--weight", "3", "--no-refine"])
    assert set(result["reached"].values()) == {1.0} and len(result["reached"]) == 3
    assert result["beyond"] == 0 and 1 <= result["cost_at_10"] < 1.6
