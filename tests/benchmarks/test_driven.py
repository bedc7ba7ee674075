"""The benchmark of driven plans: its tasks and its summary."""

import math

import numpy as np
import pytest

from benchmarks.driven import runs, summary, tasks, ways
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap

ROBOT = Robot.load("momaro")


@pytest.mark.parametrize("kind", [kind for kind in tasks.KINDS if kind != "places"])
def test_tasks_hide_the_true_ground_behind_noise(kind):
    task, again = (tasks.made_task(kind, 3, 5, ROBOT) for _ in range(2))
    assert np.array_equal(task.map.heights, again.map.heights) and task.start == again.start
    centers = np.argwhere(np.ones(task.map.shape)) * task.map.resolution + task.map.resolution / 2
    true = task.truth.heights_at(*centers.T).reshape(task.map.shape)
    assert np.std(task.map.heights - true) == pytest.approx(tasks.NOISE, rel=0.05)
    assert kind == "flat" or true.max() > 0.02


@pytest.mark.parametrize("number", range(8))
def test_two_ways_cross_different_ground(number):
    found = ways.make_ways(3, number, ROBOT)
    assert found.sort == ways.SORTS[number % 4] and found.through[0] != found.through[1]
    if found.sort == "sideways":
        assert not found.task.truth.obstacles
        return
    lanes = [found.task.truth.heights_at(np.linspace(1.2, 3.6, 200), np.full(200, y)) for y in ways.LANES]
    edges = [np.abs(np.diff(lane)).max() for lane in lanes]
    assert edges[0] > 0.01 > edges[1]
    assert lanes[1].max() <= lanes[0].max() + 1e-6


def test_scan_shadows_are_no_pits():
    heights = np.full((9, 9), 1.0, np.float32)
    heights[0, 0], heights[4, 3:5] = 0.2, np.nan
    filled = tasks.filled(HeightMap(heights)).heights
    assert (filled[4, 3:5] == 1.0).all() and filled[0, 0] == np.float32(0.2)


def test_kinds_take_turns(tmp_path, monkeypatch):
    """Tasks without a plan are replaced, until four times the count."""
    asked = []

    def run(job):
        asked.append((job.kind, job.number))
        return {"kind": job.kind, "number": job.number, "planned": job.kind == "flat" and job.number != 1, "ways": []}

    monkeypatch.setattr(runs, "run_job", run)
    found = runs.run_all({"flat": 2, "doors": 1}, 0, ROBOT, tmp_path, 1)
    assert asked == [("flat", 0), ("doors", 0), ("flat", 1), ("doors", 1), ("flat", 2), ("doors", 2), ("doors", 3)]
    assert [result["number"] for result in found["flat"]] == [0, 2] and not found["doors"]


def result(energy: float, cost: float, ending="arrived", number=1):
    made = {"number": number, "success": ending == "arrived", "ending": ending, "energy": energy, "cost": cost}
    return made | {"duration": 10.0, "cpu": 2.0}


def test_the_summary_counts_and_ranks(tmp_path):
    results = {
        "flat": [result(10, 1, number=n) for n in range(2)],
        "stairs": [result(50, 3), result(0, 1, "slipped", number=4)],
        "ways": [
            {"sort": "rough", "ways": [result(10, 1), result(20, 2)]},
            {"sort": "rough", "ways": [result(30, 4), result(10, 1)]},
            {"sort": "stairs", "ways": [result(50, 3), result(40, 4)]},
            {"sort": "stairs", "ways": [result(50, 3), result(40, 3.01)]},
            {"sort": "stairs", "ways": [result(50, 3), result(40, 9, "slipped")]},
        ],
    }  # fmt: skip
    found = summary.summarise("momaro", 7, results)
    assert found["driven"] == {"flat": 1.0, "stairs": 0.5} and found["all"] == 0.75
    assert found["without_plan"] == {"flat": 0, "stairs": 3}
    assert found["causes"]["stairs"] == {"slipped": 1} and found["realtime"] == 5.0
    assert found["pairs"] == 3 and found["rank_correlation"] == pytest.approx(1 / 3, abs=0.01)
    assert found["rank_correlation_by_sort"] == {"obstacle": None, "rough": 1.0, "stairs": -1.0, "sideways": None}
    found["slope"] = {"momaro": {"pitch": {"planned": 15.5, "driven": 30.0, "below": True, "ends": ["slipped"]}}}
    text = summary.text(found, "x.png")
    assert text.startswith("momaro, tasks of seed 7:")
    assert "| stairs | 2 | 0.5 | 1 slipped | 3 |" in text and "| momaro | pitch | 15.5 | 30 | slipped |" in text
    summary.draw(results, tmp_path / "x.png")
    assert (tmp_path / "x.png").stat().st_size > 5000


def test_joined_plans_follow_on_each_other():
    terrain = HeightMap.flat((160, 100))
    task = tasks.Task(terrain, terrain, (1.0, 1.25, 0.0), (2.5, 1.25, 0.0))
    plan = runs.solve(task, ROBOT, [(1.8, 1.5, math.pi / 2)])
    assert plan is not None and len(plan.states) == len(plan.actions) + 1 == len(plan.action_costs) + 1
    assert plan.cost == pytest.approx(plan.action_costs.sum())
    assert np.linalg.norm(plan.states[:, :2] - (1.8, 1.5), axis=1).min() < 0.03
    assert not plan.refine().check()
