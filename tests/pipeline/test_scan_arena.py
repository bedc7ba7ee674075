"""The stage for simulated scans on the tiny profile, with and without MuJoCo."""

import importlib.util
import json
import sys

import numpy as np
import pytest

from hdsp.base.errors import InputError
from hdsp.labels.shards import read_shard
from hdsp.terrain.height_map import HeightMap
from pipeline.config import configure
from pipeline.scan_arena import PICTURES, scan_arena
from pipeline.scan_courses import scan_courses
from pipeline.stage import Folders
from pipeline.task_sets import read_set
from tests.pipeline.conftest import run_python, tiny

pytestmark = [pytest.mark.pipeline]


@pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="needs MuJoCo")
def test_the_stage_writes_maps_patches_report_and_pictures(tmp_path):
    run_python("pipeline.scan_arena", *tiny(tmp_path))
    scanned, true = (HeightMap.load(tmp_path / "data/arena" / f"{name}.npz") for name in ("scanned", "true"))
    assert scanned.shape == true.shape == (400, 400)
    assert not np.isnan(true.heights).any()
    tasks, attributes = read_shard(tmp_path / "data/simulated/simulated.h5")
    report = json.loads((tmp_path / "reports/arena.json").read_text())
    assert report["available"]
    assert report["patches"]["maps"] == len(tasks) == attributes["maps"] == 2
    assert 0 < report["arena"]["accuracy"]["unknown_share"] < 1
    assert list(report["arena"]["valid"]) == ["I", "II", "III", "IV", "V", "VI", "VII"]
    for picture in PICTURES:
        assert (tmp_path / "reports/figures" / picture).read_bytes().startswith(b"\x89PNG")


@pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="needs MuJoCo")
def test_courses_to_learn_from_are_shards_that_stay_where_they_hold(tmp_path):
    folder = tmp_path / "data/labels/courses"
    folder.mkdir(parents=True)
    mine = folder / "my-own.h5"
    mine.write_bytes(b"somebody's")
    run_python("pipeline.scan_courses", "courses", *tiny(tmp_path))
    assert mine.read_bytes() == b"somebody's"
    mine.unlink()
    (path,) = folder.rglob("*.h5")
    written = path.stat().st_mtime_ns
    tasks, _ = read_shard(path)
    assert 10 < len(tasks) <= 20 and set(tasks.index) == {0}
    assert "simulated" not in {entry.name for entry in (tmp_path / "data").iterdir()}
    run_python("pipeline.scan_courses", "courses", *tiny(tmp_path), "simulation.splits.courses.courses=2")
    assert path.stat().st_mtime_ns == written, "more courses leave those that are there as they are"
    assert len(list(folder.rglob("*.h5"))) == 2
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(InputError, match=path.name):
        read_shard(path)


def test_an_unknown_split_of_courses_is_named(tmp_path):
    with pytest.raises(InputError, match="unknown split 'lawn'"):
        scan_courses(configure(["profile=tiny"]), Folders(tmp_path, tmp_path), "lawn")


def test_without_mujoco_the_stage_says_so_and_later_stages_go_without(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    for name in ("scanned.npz", "notes.txt"):
        (tmp_path / "data/arena").mkdir(parents=True, exist_ok=True)
        (tmp_path / "data/arena" / name).touch()
    scan_arena(configure(["profile=tiny"]), Folders(tmp_path, tmp_path))
    assert sorted(path.name for path in (tmp_path / "data/arena").iterdir()) == ["absent.json", "notes.txt"]
    tasks, reason = read_set(tmp_path / "data/simulated")
    assert tasks is None and "pip install 'hdsp[simulation]'" in reason
    assert not json.loads((tmp_path / "reports/arena.json").read_text())["available"]
    assert all((tmp_path / "reports/figures" / picture).is_file() for picture in PICTURES)
