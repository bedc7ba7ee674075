"""Stage `import_scans` with a synthetic scan and an unavailable scan."""

import hashlib
import json

import numpy as np
import pytest
import yaml

from hdsp.terrain.height_map import HeightMap
from pipeline.task_sets import read_set
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
