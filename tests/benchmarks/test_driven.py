"""The benchmark of driven plans: its tasks and its summary."""

import numpy as np
import pytest

from benchmarks import driven
from hdsp.robot.robot import Robot

ROBOT = Robot.load("momaro")


@pytest.mark.parametrize("kind", [kind for kind in driven.KINDS if kind != "places"])
def test_tasks_hide_the_true_ground_behind_noise(kind):
    task, again = (driven.made_task(kind, 3, 5, ROBOT) for _ in range(2))
    assert np.array_equal(task.map.heights, again.map.heights) and task.start == again.start
    centers = np.argwhere(np.ones(task.map.shape)) * task.map.resolution + task.map.resolution / 2
    true = task.truth.heights_at(*centers.T).reshape(task.map.shape)
    assert np.std(task.map.heights - true) == pytest.approx(driven.NOISE, rel=0.05)
    assert kind == "flat" or true.max() > 0.02


def result(kind: str, energy: float, cost: float, other: tuple[float, float] | None = None, ending="arrived"):
    made = {"kind": kind, "success": ending == "arrived", "ending": ending, "energy": energy, "cost": cost}
    made |= {"duration": 10.0, "cpu": 2.0}
    return made | ({"other": result(kind, *other)} if other else {})


def test_the_summary_counts_and_ranks(tmp_path):
    results = [
        result("flat", 10, 1, (20, 2)), result("flat", 10, 1, (30, 4)), result("stairs", 50, 3, (40, 4)),
        result("stairs", 0, 1, ending="slipped"),
    ]  # fmt: skip
    found = driven.summarise("momaro", ["flat", "stairs"], results)
    assert found["driven"] == {"flat": 1.0, "stairs": 0.5} and found["all"] == 0.75
    assert found["causes"]["stairs"] == {"slipped": 1} and found["realtime"] == 5.0
    assert found["pairs"] == 3 and found["rank_correlation"] == pytest.approx(1 / 3, abs=0.01)
    assert "| stairs | 2 | 0.5 | 1 slipped |" in driven.text(found, "x.png")
    driven.draw(results, tmp_path / "x.png")
    assert (tmp_path / "x.png").stat().st_size > 5000
