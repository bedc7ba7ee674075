"""The benchmark of real stairs: its tasks, its result, and its place in the documentation."""

import math
import shutil
from pathlib import Path

import numpy as np

from benchmarks import stairs
from hdsp.robot.robot import Robot
from tests import ROOT

PAGE = ROOT / "docs" / "climbing.md"


def test_tasks_lead_from_the_floor_to_the_landing():
    for task in stairs.random_tasks(seed=1, count=20):
        terrain, ends = task.terrain(), task.poses()
        heights = [float(terrain.height_at(x, y)) for x, y, _ in ends]
        assert sorted(heights) == [0.0, np.float32(task.steps * task.rise)] and (heights[0] == 0) == task.up
        treads = np.unique(np.round(terrain.heights, 4))
        assert len(treads) == task.steps + 1
        (x0, y0, start), (x1, y1, goal) = ends
        travel = math.atan2(y1 - y0, x1 - x0)
        assert all(abs(math.remainder(theta - travel, 2 * math.pi)) < 2 * stairs.ANGLE for theta in (start, goal))


def test_staircases_are_decided_and_the_page_says_so(tmp_path):
    copy = Path(shutil.copy(PAGE, tmp_path))
    result = stairs.main(["--count", "4", "--page", str(copy)])
    assert result["climbed"] + result["proved"] == 1 and result["refined"] == 1
    shares = result["groups"]["all"]
    assert shares["staircases"] == 4 and shares["climbed"] > 0
    assert f"| all | 4 | {shares['climbed']} | {shares['proved']} | 0.0 |" in copy.read_text()


def test_refused_steps_are_no_proof():
    (task,) = stairs.random_tasks(seed=0, count=1)
    plan, _ = stairs.solve(task._replace(tread=0.2), Robot.load("momaro"), "manual", 1.25, 1000)
    assert stairs.end_of(plan) == "proved" and "the treads are" in plan.explain()
    assert "needs * m" in stairs.kind_of(plan.explain())
    assert stairs.end_of(plan.renewed(refused=("a step",))) == "undecided"
