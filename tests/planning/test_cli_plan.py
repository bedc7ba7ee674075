"""`hdsp plan`: its outputs, and faults that show before the search."""

import csv
import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hdsp import HeightMap, Planner
from hdsp.planning.cli import NO_PLAN, main
from hdsp.terrain.map_frame import MapFrame
from tests import ROOT

UTM = 412345.678, 5654321.123


def plan_in(tmp_path, terrain, *more, start=(0.9, 0.9, 0), goal=(1.6, 1.1, -20)):
    """Runs the command with poses relative to the map's corner."""
    terrain.save(tmp_path / "map.npz")
    (x, y), ends = terrain.origin, []
    for name, pose in (("--start", start), ("--goal", goal)):
        ends += [name, repr(x + pose[0]), repr(y + pose[1]), str(pose[2])]
    return main(["plan", str(tmp_path / "map.npz"), *ends, "--heuristic", "geometric", *more])


def rows_of(path):
    return list(csv.DictReader(path.open()))


def test_m15_a_table_keeps_millimetres_at_any_origin(tmp_path):
    for name, origin in (("near.csv", (0.0, 0.0)), ("far.csv", UTM)):
        terrain = HeightMap(np.full((100, 100), 123.456, np.float32), origin)
        assert plan_in(tmp_path, terrain, "--out", str(tmp_path / name)) == 0
    near, far = rows_of(tmp_path / "near.csv"), rows_of(tmp_path / "far.csv")
    assert list(far[0]) == [
        "action", "x", "y", "z", "heading", "front_left", "rear_left", "rear_right", "front_right"
    ]  # fmt: skip
    assert len({(row["x"], row["y"]) for row in far}) > 10
    for one, other in zip(near, far, strict=True):
        assert one["action"] == other["action"] and one["heading"] == other["heading"]
        for name, low in zip("xy", UTM, strict=True):
            assert float(other[name]) - low == pytest.approx(float(one[name]), abs=6e-4)
        assert float(other["z"]) == pytest.approx(123.456, abs=1e-3)


def test_m15_a_plan_goes_back_to_the_frame_of_the_cloud_and_its_heights(tmp_path, capsys):
    """A floor that was tilted and turned in its source: poses of the plan lie on that floor, and face along it."""
    to_source = np.eye(4)
    to_source[:3, :3] = Rotation.from_euler("ZYX", [40, 7, -4], degrees=True).as_matrix()
    to_source[:3, 3] = *UTM, 61.5
    terrain = HeightMap(np.zeros((100, 100)), (-1.25, -1.25), frame=MapFrame("utm32", "EPSG:25832", to_source))
    assert plan_in(tmp_path, terrain, "--out", str(tmp_path / "U.CSV")) == 0
    assert "in the frame of the map; source_*: in utm32 (EPSG:25832)" in capsys.readouterr().out
    for row in rows_of(tmp_path / "U.CSV"):
        value = {name: float(text) for name, text in row.items() if name != "action"}
        wanted = to_source @ (value["x"], value["y"], value["z"], 1.0)
        np.testing.assert_allclose([value[f"source_{axis}"] for axis in "xyz"], wanted[:3], atol=6e-4)
        turned = Rotation.from_quat([value[f"source_q{axis}"] for axis in "xyzw"]).as_matrix()
        ahead = to_source[:3, :3] @ (np.cos(value["heading"]), np.sin(value["heading"]), 0.0)
        np.testing.assert_allclose(turned[:, 0], ahead, atol=1e-5)
        np.testing.assert_allclose(turned[:, 2], to_source[:3, 2], atol=1e-5)


def test_m15_on_a_slope_the_base_leans_with_the_ground():
    x = (np.arange(120) + 0.5) * 0.025
    terrain = HeightMap(np.tile(0.1 * x[:, None], (1, 100)))
    plan = Planner(terrain, conditioning=None).plan((0.9, 1.2, 0.0), (1.9, 1.2, 0.0), 1.5)
    poses = plan.ground_poses()
    np.testing.assert_allclose(poses[:, 2], 0.1 * poses[:, 0], atol=2e-3)
    np.testing.assert_allclose(poses[:, 4], -np.arctan(0.1), atol=2e-3)  # a positive pitch lowers the nose
    source = plan.in_source()
    up = Rotation.from_quat(source.quaternions).as_matrix()[:, :, 2]
    np.testing.assert_allclose(up, np.tile(np.array([-0.1, 0.0, 1.0]) / np.hypot(0.1, 1), (len(up), 1)), atol=2e-3)


def test_suffixes_in_capitals_are_taken_and_full_turns_are_no_fault(tmp_path):
    out, picture = tmp_path / "U.CSV", tmp_path / "P.PNG"
    more = "--out", str(out), "--picture", str(picture)
    assert plan_in(tmp_path, HeightMap.flat((100, 100)), *more, start=(0.9, 0.9, 360), goal=(1.6, 1.1, 700)) == 0
    assert picture.read_bytes().startswith(b"\x89PNG") and len(rows_of(out)) > 10
    assert sorted(path.name for path in tmp_path.iterdir()) == ["P.PNG", "U.CSV", "map.npz"]


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--picture", "p.jpg", "suffix '.jpg'; need .png"),
        ("--picture", "p", "suffix ''; need .png"),
        ("--out", "u.json", "suffix '.json'; need .csv or .txt"),
        ("--out", "map.npz/u.csv", "cannot write"),
        ("--out", "folder.csv", "is a folder"),
        ("--time", "nan", "time is nan"),
        ("--weight", "0.5", "weight is 0.5"),
        ("--margin", "nan", "margin is nan"),
    ],
)
def test_faults_of_options_show_before_the_search(tmp_path, capsys, monkeypatch, option, value, words):
    monkeypatch.setattr("hdsp.planning.query.solve", lambda *_, **__: pytest.fail("searched before the check"))
    (tmp_path / "folder.csv").mkdir()
    HeightMap.flat((100, 100)).save(tmp_path / "map.npz")
    value = str(tmp_path / value) if option in ("--picture", "--out") else value
    assert plan_in(tmp_path, HeightMap.flat((100, 100)), option, value) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1 and words in error


@pytest.mark.parametrize(
    ("missing", "options", "extra"),
    [
        (["matplotlib"], ["--picture", "p.png"], "hdsp[viz]"),
        (["onnxruntime", "torch"], ["--heuristic", "learned"], "hdsp[learned]"),
    ],
)
def test_m18_a_missing_extra_is_named_before_the_search(tmp_path, missing, options, extra):
    HeightMap.flat((100, 100)).save(tmp_path / "map.npz")
    script = (
        f"import sys; sys.modules.update(dict.fromkeys({missing}))\n"
        "from hdsp.planning import cli, query\n"
        "query.solve = None\n"
        "sys.exit(cli.main(sys.argv[1:]))\n"
    )
    ends = ["--start", "0.9", "0.9", "0", "--goal", "1.6", "1.1", "0"]
    command = [sys.executable, "-c", script, "plan", "map.npz", *ends, *options, "--quiet"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 1 and done.stderr.count("\n") == 1
    assert missing[0] in done.stderr and f"pip install '{extra}'" in done.stderr


def test_nothing_is_written_without_a_plan_or_on_a_failure(tmp_path, monkeypatch):
    wall = np.zeros((150, 100), np.float32)
    wall[70:74] = 1.0
    out = tmp_path / "u.csv"
    assert plan_in(tmp_path, HeightMap(wall), "--out", str(out), goal=(2.8, 1.1, 0)) == NO_PLAN
    assert not out.exists()
    out.write_text("before")
    monkeypatch.setattr("csv.writer", lambda file: file.write("half") and pytest.fail("the disk is gone"))
    with pytest.raises(pytest.fail.Exception):
        plan_in(tmp_path, HeightMap.flat((100, 100)), "--out", str(out))
    assert out.read_text() == "before" and len(list(tmp_path.iterdir())) == 2


def test_the_package_runs_as_a_command():
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-m", "hdsp", "--help"], env=environment, capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.startswith("usage: hdsp") and "plan a path" in done.stdout


def test_a_motion_and_a_recording_are_written(tmp_path, capsys):
    names = [str(tmp_path / name) for name in ("motion.csv", "run.mcap")]
    terrain = HeightMap(np.zeros((100, 100)), (5e5, 5e6))
    assert plan_in(tmp_path, terrain, "--motion", names[0], "--record", names[1]) == 0
    rows = rows_of(tmp_path / "motion.csv")
    assert float(rows[0]["x"]) == pytest.approx(5e5 + 0.9, abs=0.026)
    assert f"{names[1]}: motion, {float(rows[-1]['time']):.1f} s" in capsys.readouterr().out
    assert (tmp_path / "run.mcap").read_bytes()[1:5] == b"MCAP"
    assert plan_in(tmp_path, terrain, "--motion", str(tmp_path / "motion.doc")) == 1
    assert "suffix '.doc'" in capsys.readouterr().err
