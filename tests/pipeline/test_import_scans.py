"""Stage `import_scans` with a synthetic scan and an unavailable scan."""

import hashlib
import json

import numpy as np
import pytest
import yaml

from hdsp.labels.shards import write_shard
from hdsp.terrain.height_map import HeightMap
from pipeline.config import configure
from pipeline.import_scans import import_scans as stage
from pipeline.published import published
from pipeline.stage import Folders
from pipeline.task_sets import read_set
from tests.labels.task_sets import random_tasks
from tests.pipeline.conftest import ROOT, run_python
from tests.terrain.pointcloud.clouds import box, rectangle

pytestmark = [pytest.mark.pipeline]

ABOUT = {"what": "ground", "sensor": "none", "licence": "MIT", "source": "https://example.org"}
REAL = [path.stem for path in (ROOT / "conf/scans").glob("*.yaml") if path.stem != "default"]


def import_scans(folder, sources):
    """Runs the stage with these sources instead of the real ones."""
    overrides = [f"~scans.sources.{name}" for name in REAL]
    for name, values in sources.items():
        text = yaml.safe_dump(values, default_flow_style=True, width=10_000).strip()
        overrides.append(f"+scans.sources.{name}={text}")
    where = [f"runtime.data_dir={folder}", f"runtime.outputs={folder}"]
    return run_python("pipeline.import_scans", "profile=tiny", "scans.patches.count=2", *where, *overrides).stdout


def test_shards_and_files_that_no_stage_wrote_stay(tmp_path, monkeypatch):
    config, folders = configure([f"~scans.sources.{name}" for name in REAL]), Folders(tmp_path, tmp_path)
    real = tmp_path / "data/real"
    for name, about in {"mine": {}, "gone": {"scan": "gone"}, "copy": {"scan": "gone"}}.items():
        write_shard(real / f"{name}.h5", random_tasks(1), {"labels_hash": "0", **about})
    (real / "notes.txt").touch()
    (real / "folder.h5").mkdir()
    stage(config, folders)
    assert sorted(path.name for path in real.iterdir()) == ["copy.h5", "folder.h5", "mine.h5", "notes.txt"]
    assert len(read_set(real)[0]) == 2

    monkeypatch.setattr("hdsp.labels.published_tasks.find_published", lambda _: (None, "not there"))
    for name in ("published.h5", "mine.h5"):
        write_shard(tmp_path / "data/published" / name, random_tasks(1), {"labels_hash": "0"})
    published(config, folders)
    assert sorted(path.name for path in (tmp_path / "data/published").iterdir()) == ["absent.json", "mine.h5"]


def missing(name):
    """A scan with an address that refuses connections."""
    files = [{"path": "a.xyz", "sha256": "0" * 64}]
    return {**ABOUT, "place": name, "address": "http://127.0.0.1:9/", "files": files}


def test_scans_become_maps_labels_and_a_report_by_place_and_the_missing_one_is_named(tmp_path):
    yard = tmp_path / "real" / "yard" / "yard.xyz"
    yard.parent.mkdir(parents=True)
    np.savetxt(yard, np.concatenate([rectangle((-2, 2), (-2, 2), 0.4), box((1.2, 1.6), (-2, 2), 0.9)]))
    files = [{"path": "yard.xyz", "sha256": hashlib.sha256(yard.read_bytes()).hexdigest()}]
    sources = {"yard": {**missing("the yard"), "files": files}, "nowhere": missing("nowhere")}

    said = import_scans(tmp_path, sources)
    assert "skipped: scan nowhere: not in" in said and "2 patches from 1 places" in said
    tasks, reason = read_set(tmp_path / "data/real")
    assert reason == ""
    assert list(tasks.category) == ["the yard"] * 2
    assert HeightMap.load(tmp_path / "data/real_maps/yard.npz").size == pytest.approx((4, 4), abs=0.06)
    report = json.loads((tmp_path / "reports/real_scans.json").read_text())
    assert report["patches_per_place"] == {"the yard": 2}
    assert report["scans"]["yard"]["licence"] == "MIT"
    assert list(report["missing"]) == ["nowhere"]
    assert (tmp_path / "reports/figures/real_scans.png").read_bytes().startswith(b"\x89PNG")

    said = import_scans(tmp_path, {"nowhere": missing("nowhere")})  # the stage removes the shard of a removed scan
    assert "0 patches from 0 places" in said
    tasks, reason = read_set(tmp_path / "data/real")
    assert tasks is None
    assert "scan nowhere" in reason
    assert "HDSP_DATA_DIR" in reason
