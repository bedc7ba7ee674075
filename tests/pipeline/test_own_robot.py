"""Another robot: its documentation page, and labels with its preset."""

import json
import sys
from pathlib import Path

import pytest

from hdsp import HeightMap, InputError, Planner, Robot
from hdsp.labels.rules import LabelSettings, label_map
from pipeline import own_robot
from pipeline.config import configure
from pipeline.own_robot import PAGE, check_name, markers, place, section, write_page
from pipeline.stage import Folders, run_stage
from tests.pipeline.conftest import ROOT, SMALL_NETWORK, run_python, tiny


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


def test_the_page_is_written_for_the_robot_it_has_markers_of_and_no_other(tmp_path):
    page, picture = tmp_path / PAGE.name, tmp_path / "path.png"
    page.write_text((ROOT / PAGE).read_text())
    picture.write_bytes(b"a path")
    (tmp_path / "figures").mkdir()
    write_page(page, "momaro", "other figures", picture)
    assert page.read_text() == (ROOT / PAGE).read_text() and not list((tmp_path / "figures").iterdir())
    write_page(page, "anymal_wheels", "new figures", picture)
    begin, end = markers("anymal_wheels")
    written = page.read_text().split(begin)[1].split(end)[0].split("\n")
    assert written[2:5] == ["new figures", "![A path of anymal_wheels](figures/anymal_wheels.png)", ""]
    assert (tmp_path / "figures/anymal_wheels.png").read_bytes() == b"a path"


def test_a_file_with_the_name_of_another_robot_is_refused(monkeypatch):
    momaro = Robot.load("momaro")
    check_name(momaro)
    monkeypatch.setattr(Robot, "presets", staticmethod(lambda: ["copy", "momaro"]))
    monkeypatch.setattr(Robot, "load", lambda _: momaro)
    with pytest.raises(InputError, match=r"presets/copy.yaml: its name is 'momaro'; need the file's, 'copy'"):
        check_name(momaro)


def test_splits_of_scanned_courses_are_scanned_and_the_others_labelled(monkeypatch, tmp_path):
    made = []
    for stage in ("label", "scan_courses"):
        monkeypatch.setattr(own_robot, stage, lambda _, __, split, stage=stage: made.append((stage, split)))
    monkeypatch.setattr(own_robot, "train", lambda *_: 1 / 0)
    config = configure(["profile=beyond", "robot=anymal_wheels"])
    with pytest.raises(ZeroDivisionError):
        own_robot.own_robot(config, Folders(tmp_path, tmp_path))
    assert [split for stage, split in made if stage == "scan_courses"] == ["courses"]
    assert [split for stage, split in made if stage == "label"] == list(config.labelling.used)


def test_it_writes_where_it_says(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["own_robot", "robot=anymal_wheels", "profile=own_robot"])
    written = []
    run_stage(lambda config, folders: written.append(folders.outputs), "own_robot", place=place)
    assert written == [Path("outputs/robots/anymal_wheels")]
    assert capsys.readouterr().err == "writing to outputs/robots/anymal_wheels\n"


def test_on_flat_ground_the_robot_can_do_every_task_and_parking_is_expensive():
    robot = Robot.load("anymal_wheels")
    labels = label_map(HeightMap.flat((72, 72)), robot, LabelSettings())
    assert labels.feasible.all()
    assert labels.cost[0] == pytest.approx(0.1, abs=1e-3)  # ahead
    assert labels.cost[2] > 4 * labels.cost[0]  # to the left, by driving ahead and back


def test_all_stages_run_for_a_robot_whose_wheels_do_not_steer(tmp_path):
    network = [f"model.options.{name}={value}" for name, value in SMALL_NETWORK.items()]
    run_python("pipeline.own_robot", "robot=go2w", *tiny(tmp_path), *network, tracking=tmp_path)
    quality = json.loads((tmp_path / "reports/abstraction_quality.json").read_text())["sets"]["random"]
    assert set(quality["methods"]) == {"trained", "manual", "flat"}
    runs = json.loads((tmp_path / "reports/planning.json").read_text())["runs"]
    assert {run["status"] for run in runs} == {"solved"} and min(run["cost"] for run in runs) > 0


def test_it_steps_up_where_it_cannot_drive():
    flat = HeightMap.flat((100, 80))
    heights = flat.heights.copy()
    heights[55:] = 0.1
    plan = Planner(HeightMap(heights), "anymal_wheels").plan((0.8, 1.0, 0.0), (1.95, 1.0, 0.0), weight=1.5)
    assert plan.solved and plan.steps
