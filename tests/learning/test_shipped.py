"""The shipped abstraction: found, loaded, refused for another robot, and packaged."""

import json
import shutil
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hdsp
from hdsp import HeightMap, InputError, Planner, Robot
from hdsp.learning.loading import presets, robot_of
from hdsp.robot.lattice import robot_frame_goals
from tests import ROOT

MEGABYTES = 8

#: Loads and predicts in a process with the wheel only, without network, unpickling and Lightning.
PROBE = """
import pickle, socket, sys
sys.path = [sys.argv[1], *(p for p in sys.path if p and p != sys.argv[2])]
import hdsp, torch, numpy as np
assert hdsp.__file__.startswith(sys.argv[1]), hdsp.__file__
def refuse(*_, **__): raise AssertionError("not here")
socket.socket.connect = pickle.load = pickle.loads = pickle.Unpickler = torch.load = refuse
sys.modules["lightning"] = None  # only training needs it
from hdsp.robot.lattice import robot_frame_goals
feasible, cost = hdsp.load_abstraction("momaro").predict(np.zeros((1, 72, 72)), robot_frame_goals(0))
print(feasible.shape, bool(np.isfinite(cost).all()))
"""


ROBOTS = "momaro", "go2w"


@pytest.fixture(scope="module")
def abstraction():
    return hdsp.load_abstraction("momaro")


@pytest.mark.parametrize("robot", ROBOTS)
def test_it_judges_flat_ground(robot):
    abstraction = hdsp.load_abstraction(robot)
    feasible, cost = abstraction.predict(np.zeros((1, 72, 72), np.float32), robot_frame_goals(0))
    assert feasible.mean() > 0.9
    assert cost[0, 0] == pytest.approx(0.1, abs=0.03)  # 10 cm ahead
    assert abstraction.calibration.cost_quantiles


def test_what_does_not_exist_is_said_with_what_does():
    with pytest.raises(InputError, match=r"abstraction 'momo': no folder, and not one of .*\(.*momaro"):
        hdsp.load_abstraction("momo")
    assert "momaro" in presets()


def test_an_abstraction_is_of_the_robot_that_it_is_named_by(monkeypatch):
    robots = ["momaro", "momaro-legs", "my-robot"]
    monkeypatch.setattr(Robot, "presets", staticmethod(lambda: robots))
    names = ["momaro", "momaro-klamt2019", "momaro-legs", "momaro-legs-large", "my-robot-new", "other-new"]
    found = ["momaro", "momaro", "momaro-legs", "momaro-legs", "my-robot", "other-new"]
    assert [robot_of(name) for name in names] == found


def test_a_folder_of_ones_own_is_loaded_as_well(abstraction, tmp_path):
    folder = abstraction.save_pretrained(tmp_path / "mine", "float16", picture=False)
    mine = hdsp.load_abstraction(folder, "momaro")
    patches, goals = np.zeros((1, 72, 72), np.float32), robot_frame_goals(1)
    np.testing.assert_allclose(mine.predict(patches, goals)[1], abstraction.predict(patches, goals)[1], atol=0.01)
    assert (folder / "model.safetensors").stat().st_size < 0.6 * (
        Path(hdsp.__file__).parent / "learning/shipped/momaro/model.safetensors"
    ).stat().st_size or json.loads((ROOT / "hdsp/learning/shipped/momaro/config.json").read_text())[
        "precision"
    ] == "float16"
    with pytest.raises(InputError, match="precision 'int8': allowed are"):
        abstraction.save_pretrained(tmp_path / "no", "int8", picture=False)


def test_it_is_refused_for_another_robot():
    momaro = Robot.load("momaro")
    wider = replace(momaro, feet=replace(momaro.feet, neutral_y=momaro.feet.neutral_y + 0.05))
    with pytest.raises(InputError, match="trained for another robot"):
        hdsp.load_abstraction("momaro", wider)
    terrain = HeightMap.flat((24, 24))
    with pytest.raises(InputError, match="trained for another robot"):
        Planner(terrain, wider, heuristic="learned")
    with pytest.raises(
        InputError, match=r"no trained abstraction for robot 'mine' .* only for .*momaro.*learned:FOLDER"
    ):
        Planner(terrain, replace(wider, name="mine"), heuristic="learned")


@pytest.mark.parametrize("robot", ROBOTS)
def test_plans_use_it_without_a_folder(robot):
    planner = Planner(HeightMap.flat((60, 60)), robot, heuristic="learned")
    plan = planner.plan((0.7, 0.7, 0.0), (0.9, 0.8, 0.0), weight=1.5)
    assert plan.solved and plan.stats["heuristic"] == "learned"


@pytest.mark.parametrize("robot", ROBOTS)
def test_its_card_states_what_the_configuration_states(robot):
    folder = ROOT / "hdsp/learning/shipped" / robot
    card, metrics = (folder / "README.md").read_text(), json.loads((folder / "config.json").read_text())["metrics"]
    for name in ("val", "random"):
        assert f"{100 * metrics[f'feasibility_accuracy/{name}']:.2f} %" in card
        assert f"{metrics[f'cost_error/{name}']:.4f}" in card
    for title in ("Model", "Training data", "Training recipe", "Metrics", "Calibration", "Limits"):
        assert f"## {title}\n" in card


def test_a_wheel_holds_it_and_a_process_with_nothing_else_loads_it_offline_without_pickle(tmp_path):
    source = tmp_path / "source"
    shutil.copytree(ROOT / "hdsp", source / "hdsp", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md"):
        shutil.copy2(ROOT / name, source / name)
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    done = subprocess.run([*build, "-w", str(tmp_path), str(source)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as file:
        sizes = {info.filename: info.file_size for info in file.infolist()}
        file.extractall(tmp_path / "installed")
    for name in ("config.json", "model.safetensors", "README.md"):
        assert f"hdsp/learning/shipped/momaro/{name}" in sizes
    assert sizes["hdsp/learning/shipped/momaro/model.safetensors"] < MEGABYTES * 1e6
    arguments = [sys.executable, "-c", PROBE, str(tmp_path / "installed"), str(ROOT)]
    done = subprocess.run(arguments, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n")[0] == "(1, 22) True"
