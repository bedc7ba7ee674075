"""The stage of simulated scans on the tiny profile, and where MuJoCo is missing."""

import importlib.util
import json
import sys

import numpy as np
import pytest

from hdsp.heightmap import HeightMap
from hdsp.shards import read_shard
from pipeline.config import compose
from pipeline.data import read_set
from pipeline.scan_arena import PICTURES, scan_arena
from pipeline.stage import Folders
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


def test_without_mujoco_the_stage_says_so_and_later_stages_go_without(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    scan_arena(compose(["profile=tiny"]), Folders(tmp_path, tmp_path))
    tasks, reason = read_set(tmp_path / "data/simulated")
    assert tasks is None and "pip install 'hdsp[simulation]'" in reason
    assert not json.loads((tmp_path / "reports/arena.json").read_text())["available"]
    assert all((tmp_path / "reports/figures" / picture).is_file() for picture in PICTURES)
