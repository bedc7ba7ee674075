"""Another robot: what its page says of the reports, and that its preset is one that labels can be made for."""

import json
import sys
from pathlib import Path

import pytest

from hdsp import HeightMap, Planner, Robot
from hdsp.labelling import LabelSettings, label_map
from pipeline.own_robot import BEGIN, END, PAGE, place, section
from pipeline.stage import run_stage
from tests.pipeline.conftest import ROOT


def test_the_page_has_a_row_for_each_abstraction_and_each_search():
    reports = {
        name: json.loads((ROOT / f"reports/{name}.json").read_text())
        for name in ("training", "abstraction_quality", "planning")
    }
    text = section(Robot.load("anymal_wheels"), "small", reports)
    random = reports["abstraction_quality"]["sets"]["random"]
    for values in random["methods"].values():
        assert f"{100 * values['feasibility_accuracy']:.2f} %" in text
    assert text.count("\n") > len(random["methods"]) + len(reports["planning"]["runs"])


def test_the_page_has_the_markers():
    page = (ROOT / PAGE).read_text()
    assert page.index(BEGIN) < page.index(END)


def test_it_writes_where_it_says(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["own_robot", "robot=anymal_wheels", "profile=own_robot"])
    written = []
    run_stage(lambda config, folders: written.append(folders.outputs), "own_robot", place=place)
    assert written == [Path("outputs/robots/anymal_wheels")]
    assert capsys.readouterr().err == "writing to outputs/robots/anymal_wheels\n"


def test_on_flat_ground_the_robot_can_do_every_task_and_driving_sideways_is_dear():
    robot = Robot.load("anymal_wheels")
    labels = label_map(HeightMap.flat((72, 72)), robot, LabelSettings())
    assert labels.feasible.all()
    assert labels.cost[0] == pytest.approx(0.1, abs=1e-3)  # ahead
    assert labels.cost[2] > 3 * labels.cost[0]  # to the left


def test_it_steps_up_where_it_cannot_drive():
    flat = HeightMap.flat((100, 80))
    heights = flat.heights.copy()
    heights[55:] = 0.1
    plan = Planner(HeightMap(heights), "anymal_wheels").plan((0.8, 1.0, 0.0), (1.95, 1.0, 0.0), weight=1.5)
    assert plan.solved and any(action.startswith("step ") for action in plan.actions)
