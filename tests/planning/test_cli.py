import csv

import numpy as np
import pytest

from hdsp.labels.shards import write_shard
from hdsp.planning.cli import NO_PLAN, main
from hdsp.terrain.height_map import HeightMap
from tests.labels.task_sets import random_tasks
from tests.terrain.pointcloud.clouds import moved, room


@pytest.fixture
def cloud(tmp_path):
    path = tmp_path / "room.xyz"
    np.savetxt(path, moved(room(ceiling=2.4), 3, shift=(0, 0, -1)))
    return path


def test_a_cloud_becomes_a_map_and_a_picture(tmp_path, cloud, capsys):
    out, picture = tmp_path / "map.npz", tmp_path / "map.png"
    assert main(["map", str(cloud), "--out", str(out), "--picture", str(picture)]) == 0
    terrain = HeightMap.load(out)
    assert abs(np.nanmedian(terrain.heights)) < 0.01
    assert np.nanmax(terrain.heights) < 0.4
    assert picture.read_bytes().startswith(b"\x89PNG")
    told = capsys.readouterr().out
    assert "cells of 0.025 m" in told and "floor tilted by 3.0 degrees, levelled" in told


def test_several_clouds_are_fused_and_options_reach_the_map(tmp_path, cloud):
    np.savetxt(tmp_path / "more.xyz", moved(room() + (3, 0, 0), 3, shift=(0, 0, -1)) * 1000)
    out = tmp_path / "map.h5"
    files = [str(tmp_path / "more.xyz")]
    options = ["--out", str(out), "--units", "0.001", "--box", "1.5", "-1", "4.5", "1", "--resolution", "0.05"]
    assert main(["map", *files, *options]) == 0
    terrain = HeightMap.load(out)
    assert terrain.resolution == 0.05
    assert terrain.size == pytest.approx((3, 2), abs=0.11)
    assert main(["map", str(cloud), str(cloud), "--out", str(out), "--no-level", "--lowest=-3"]) == 0
    assert np.nanmedian(HeightMap.load(out).heights) == pytest.approx(-1, abs=0.05)


def test_info_says_what_a_file_holds(tmp_path, cloud, capsys):
    HeightMap.flat((80, 40)).save(tmp_path / "map.h5")
    write_shard(tmp_path / "shard.h5", random_tasks(3), {"labels_hash": "x", "place": "yard"})
    for path in (cloud, tmp_path / "map.h5", tmp_path / "shard.h5"):
        assert main(["info", str(path)]) == 0
    points, parts, terrain, _, sign, shard = capsys.readouterr().out.splitlines()
    assert "points, x -2.0" in points and "floor at z = -1.00 m in the middle, tilted by 3.0 degrees" in points
    assert (
        parts == "HDF5, entries digest uint8 [32], heights float32 [80, 40], origin float64 [2], resolution float64 []"
    )
    assert "height map of 80 x 40 cells of 0.025 m" in terrain and "100% known" in terrain
    assert sign == "suspicious: all known heights are 0 m"
    assert "shard of 3 maps" in shard and "place: yard" in shard


def test_the_axes_of_a_file_are_named_with_an_equals_sign(tmp_path, cloud):
    np.savetxt(tmp_path / "camera.xyz", room()[:, [1, 2, 0]] * (-1, -1, 1))
    assert main(["map", str(tmp_path / "camera.xyz"), "--axes=z,-x,-y", "--out", str(tmp_path / "map.npz")]) == 0
    assert HeightMap.load(tmp_path / "map.npz").size == pytest.approx((4, 3), abs=0.06)


def plan_on(tmp_path, heights, *more, goal="1.6"):
    HeightMap(heights.astype(np.float32)).save(tmp_path / "map.npz")
    ends = ["--start", "0.9", "0.9", "0", "--goal", goal, "1.1", "-20"]
    return main(["plan", str(tmp_path / "map.npz"), *ends, *more])


def test_a_plan_is_told_and_written(tmp_path, capsys):
    out, picture = tmp_path / "plan.csv", tmp_path / "plan.png"
    more = "--heuristic", "geometric", "--weight", "1.5", "--margin", "0.02", "--out", str(out)
    assert plan_on(tmp_path, np.zeros((100, 100)), *more, "--picture", str(picture)) == 0
    told = capsys.readouterr().out
    assert "solved: drives" in told and "states expanded" in told and f"{picture}: picture" in told
    rows = list(csv.DictReader(out.open()))
    assert rows[0]["action"] == "" and {row["action"] for row in rows[1:]} <= {"drive", "turn_left", "turn_right"}
    x, y, heading = (float(rows[-1][name]) for name in ("x", "y", "heading"))
    assert (x, y, np.sin(heading)) == pytest.approx((1.6, 1.1, np.sin(np.deg2rad(-20))), abs=0.05)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_where_there_is_no_plan_the_reason_is_told(tmp_path, capsys):
    wall = np.zeros((150, 100))
    wall[70:74] = 1.0
    picture = tmp_path / "why.png"
    more = "--heuristic", "geometric", "--picture", str(picture)
    assert plan_on(tmp_path, wall, *more, goal="2.8") == NO_PLAN
    told = capsys.readouterr().out
    assert "there is no way: " in told and "an edge of 100 cm" in told and f"{picture}: picture" in told
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["plan", "none.npz", "--start", "0", "0", "0", "--goal", "1", "1", "0"], "none.npz: no such file"),
        (["info", "none.pcd"], "none.pcd: no such file"),
        (["info", "none.h5"], "none.h5: no such file"),
        (["info", "{}/none.docx"], "suffix '.docx'; need one of .npz, "),
        (["map", "{}/room.xyz", "--out", "{}/map.png"], "suffix '.png'; need one of .npz, .h5, .hdf5, .tif, .tiff"),
        (["map", "{}/room.xyz", "--out", "{}/map.npz", "--units", "0.0001"], "in metres"),
        (["map", "{}/room.xyz", "--out", "{}/map.npz", "--axes", "x,z"], "need each of x, y, z once"),
        (["map", "{}/room.xyz", "--out", "{}/map.npz", "--fill", "-2"], "fill is -2"),
    ],
)
def test_bad_input_ends_in_one_line(tmp_path, cloud, capsys, arguments, words):
    status = main([argument.format(tmp_path) for argument in arguments])
    error = capsys.readouterr().err
    assert status == 1
    assert error.startswith("error: ") and error.count("\n") == 1
    assert words in error


def test_a_call_without_a_command_shows_the_usage(capsys):
    with pytest.raises(SystemExit) as end:
        main([])
    assert end.value.code == 2
    assert "usage: hdsp" in capsys.readouterr().err


def test_m4_the_nearest_of_several_goals_with_a_free_heading_and_a_tolerance(tmp_path, capsys):
    heights = np.zeros((100, 100))
    heights[20:30, 36:44] = np.nan  # under the robot at the start
    more = ["--goal", "1.6", "1.8", "free", "--goal", "1.2", "1.0", "--tolerance", "0.2", "30"]
    assert plan_on(tmp_path, heights, *more, "--no-conditioning") == 0
    told = capsys.readouterr().out
    assert "goal 3 of 3: 1.2 1.0" in told and "unknown ground under the robot at the start" in told
    assert plan_on(tmp_path, heights, *more, "--no-conditioning", "--no-start-free") == NO_PLAN


@pytest.mark.parametrize("more", [["--goal", "1", "1", "up"], ["--goal", "1"], ["--tolerance", "1", "2", "3"]])
def test_a_goal_in_other_words_is_refused(tmp_path, more, capsys):
    assert plan_on(tmp_path, np.zeros((100, 100)), *more) == 1
    assert more[0] in capsys.readouterr().err
