import hashlib

import numpy as np
import pytest
import yaml

from hdsp.planning.cli import main
from hdsp.terrain.height_map import HeightMap
from tests import ROOT
from tests.terrain.pointcloud.clouds import moved, rectangle, room, wall

ABOUT = {"place": "a room", "what": "a room", "sensor": "a laser", "licence": "MIT", "source": "https://example.org/"}


def saved(path, points):
    np.savetxt(path, points, fmt="%.4f")
    return str(path)


def test_m9_m10_the_line_of_a_map_tells_all_that_was_done(tmp_path, capsys):
    floor = rectangle((0, 4), (0, 4), 0.0)
    floor[floor[:, 0] > 2.8, 2] = -9999
    below = rectangle((0, 0.4), (0, 0.4), -0.9)
    cloud = saved(tmp_path / "a.xyz", moved(np.concatenate([floor, below, [[900, 700, 1]]]), 0, 0))
    assert main(["map", cloud, "--out", str(tmp_path / "a.npz")]) == 0
    told = capsys.readouterr().out
    for words in (
        "no-data value z = -9999 left out",
        "1 lone point far away",
        "400 points lower than 0.5 m",
        "tilted by",
    ):
        assert words in told
    assert HeightMap.load(tmp_path / "a.npz").frame.notes  # the file keeps them
    assert main(["map", cloud, "--box", "0", "0", "2", "2", "--out", str(tmp_path / "a.npz")]) == 0
    assert HeightMap.load(tmp_path / "a.npz").size == pytest.approx((2, 2), abs=0.06)


def test_m8_the_line_tells_a_slope_and_how_to_level_it(tmp_path, capsys):
    cloud = saved(tmp_path / "hill.xyz", moved(rectangle((0, 4), (0, 4), 0.0), pitch=12, shift=(10, 0, 3)))
    assert main(["map", cloud, "--out", str(tmp_path / "hill.npz")]) == 0
    told = capsys.readouterr().out
    assert "ground inclined by 12.0 degrees, kept" in told and "--max-tilt 13 levels it" in told
    assert np.ptp(HeightMap.load(tmp_path / "hill.npz").heights) > 0.7
    assert main(["info", cloud]) == 0
    assert "ground inclined by 12.0 degrees, kept" in capsys.readouterr().out
    assert main(["map", cloud, "--max-tilt", "13", "--out", str(tmp_path / "hill.npz")]) == 0
    assert "floor tilted by 12.0 degrees, levelled" in capsys.readouterr().out
    level = HeightMap.load(tmp_path / "hill.npz")
    assert np.nanmax(np.abs(level.heights)) < 0.01
    back = level.frame.points_to_source(np.array([*level.center, 0.0]))
    assert back[2] == pytest.approx(3 - np.tan(np.radians(12)) * (back[0] - 10), abs=0.01)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--max-tilt", "100"], "--max-tilt is 100; need more than 0, and at most 90 degrees"),
        (["--max-tilt=-1"], "--max-tilt is -1; need more than 0"),
        (["--max-tilt", "nan"], "--max-tilt is nan; need more than 0"),
        (["--no-level", "--max-tilt", "10"], "--no-level keeps z, and --max-tilt levels; need one of them"),
    ],
)
def test_a_tilt_without_a_meaning_is_refused(tmp_path, capsys, options, words):
    cloud = saved(tmp_path / "a.xyz", room())
    assert main(["map", cloud, *options, "--out", str(tmp_path / "a.npz")]) == 1
    assert words in capsys.readouterr().err and not (tmp_path / "a.npz").exists()


def test_m16_another_axis_up_is_refused_until_the_axes_are_given(tmp_path, capsys):
    cloud = saved(tmp_path / "a.xyz", np.concatenate([room(), wall(-2, (-1.5, 1.5), (0, 2.4))])[:, [1, 2, 0]])
    assert main(["map", cloud, "--out", str(tmp_path / "a.npz")]) == 1
    assert "y may be up" in (error := capsys.readouterr().err) and "--axes=z,x,y makes it up" in error
    assert main(["info", cloud]) == 0
    assert "refused without axes: y may be up" in capsys.readouterr().out
    assert main(["map", cloud, "--axes=z,x,y", "--out", str(tmp_path / "a.npz")]) == 0
    assert HeightMap.load(tmp_path / "a.npz").size == pytest.approx((4, 3), abs=0.06)


def described(tmp_path, files, **values):
    entries = [
        {"path": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest(), **more} for path, more in files
    ]
    text = yaml.safe_dump({**ABOUT, "address": "https://example.org/data/", "files": entries, **values})
    (tmp_path / "scan.yaml").write_text(f"# @package scans.sources.lab\n{text}")
    return str(tmp_path / "scan.yaml")


def test_a_described_scan_becomes_a_map_by_one_command(tmp_path, capsys):
    image = pytest.importorskip("PIL.Image")
    depth = tmp_path / "depth.png"
    image.fromarray(np.full((120, 160), 1500, np.uint16)).save(depth)  # a camera 1.5 m above the floor looks down
    camera = {"fx": 100.0, "fy": 100.0, "cx": 80.0, "cy": 60.0, "depth_scale": 0.001, "nearest": 0.0}
    pose = {"pose": [0.0, 0.0, 1.5, 1.0, 0.0, 0.0, 0.0]}
    scan = described(tmp_path, [(depth, pose)], camera=camera)
    for files in ([], [str(depth)]):
        assert main(["map", *files, "--scan", scan, "--out", str(tmp_path / "a.npz")]) == 0
        assert "scan lab: a room; floor tilted by 0.0 degrees, levelled" in capsys.readouterr().out
        assert HeightMap.load(tmp_path / "a.npz").size == pytest.approx((2.4, 1.8), abs=0.06)
    assert main(["map", str(depth), str(depth), "--scan", scan, "--out", str(tmp_path / "a.npz")]) == 1
    assert "scan lab: 2 files; its description has 1" in capsys.readouterr().err


@pytest.mark.parametrize(
    "name", sorted(path.stem for path in (ROOT / "conf/scans").glob("*.yaml") if path.stem != "default")
)
def test_each_real_scan_becomes_a_map_by_one_command(tmp_path, name, capsys, monkeypatch):
    from hdsp.base.downloads import data_folder
    from hdsp.terrain.scans import find_files, load_scan

    def fetch(*_):
        raise OSError("no network in tests")

    monkeypatch.setattr("hdsp.terrain.scans.fetch", fetch)
    folder = data_folder() or ROOT / "shared/data"
    scan = ROOT / f"conf/scans/{name}.yaml"
    if not find_files(load_scan(scan), folder)[0]:
        pytest.skip("no data")
    monkeypatch.setenv("HDSP_DATA_DIR", str(folder))
    assert main(["map", "--scan", str(scan), "--out", str(tmp_path / "a.npz")]) == 0
    assert f"scan {name}: " in capsys.readouterr().out
    heights = HeightMap.load(tmp_path / "a.npz").heights
    assert (np.abs(heights[np.isfinite(heights)]) < 0.08).mean() > 0.1


def test_map_without_a_file_is_refused(tmp_path, capsys):
    assert main(["map", "--out", str(tmp_path / "a.npz")]) == 1
    assert "need a height map, point clouds, or --scan" in capsys.readouterr().err
