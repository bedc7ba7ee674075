"""Fingerprints of the code behind each stage, and `dvc.yaml`, which uses them."""

import re
import shutil

import pytest
import yaml

from pipeline.code import STAGES, fingerprints
from tests import ROOT

DVC = yaml.safe_load((ROOT / "dvc.yaml").read_text())["stages"]
#: Stages that label: maps, sets of scans that they judge networks on, or flat ground for the manual abstraction.
LABELLING = {"label", "import_scans", "scan_arena", "scan_courses", "train", "evaluate", "plan"}


@pytest.fixture
def project(tmp_path):
    for folder in ("hdsp", "pipeline"):
        ignored = shutil.ignore_patterns("__pycache__", "shipped")
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=ignored)
    return tmp_path


@pytest.mark.parametrize(
    ("old", "new", "stale"),
    [
        ('amount["white"] * random', 'amount["white"] * 10 * random', {"label"}),
        ("chosen = np.flatnonzero(least < limit)", "chosen = np.flatnonzero(least <= limit)", LABELLING),
        ("RESOLUTION = 0.025", "RESOLUTION = 0.05", LABELLING | {"published"}),
        ("class Footprint(TaskNetwork):", "class Footprint(TaskNetwork, More):", {"train", "evaluate", "plan"}),
        ("class Klamt2019(TaskNetwork):", "class Klamt2019(TaskNetwork, More):", {"evaluate", "plan"}),
        ("class Compact(TaskNetwork):", "class Compact(TaskNetwork, More):", set()),
        ("class Footprint(TaskNetwork):", "# A comment.\nclass Footprint(TaskNetwork):", set()),
        ("def evaluate_set(", "def evaluate_set(more=1, *, ", {"evaluate"}),
        ("def check_plan(", "def check_plan(more=1, *, ", {"plan"}),
        ("def heuristic_table(", "def heuristic_table(more=1, *, ", {"report"}),
        ("def save_quality_bars(", "def save_quality_bars(more=1, *, ", set()),
        ('".h5": _HDF5', '".hf5": _HDF5,\n    ".h5": _HDF5', set()),
    ],
)
def test_an_edit_makes_stale_what_it_decides(project, old, new, stale):
    paths = [path for path in project.rglob("*.py") if old in path.read_text()]
    assert len(paths) == 1
    paths[0].write_text(paths[0].read_text().replace(old, new))
    before, after = fingerprints("footprint"), fingerprints("footprint", project)
    assert {stage for stage in after if after[stage] != before[stage]} == stale


def test_a_training_depends_on_its_own_architecture(project):
    path = project / "hdsp/learning/networks/compact.py"
    path.write_text(
        path.read_text().replace("class Compact(TaskNetwork):", "class Compact(TaskNetwork):\n    extra = 1")
    )
    assert fingerprints("compact", project)["train"] != fingerprints("compact")["train"]
    assert fingerprints("swept", project)["train"] == fingerprints("swept")["train"]


def test_every_stage_depends_on_the_code_of_its_module_and_on_no_sources():
    modules = {name: re.match(r"python -m pipeline\.(\w+)", stage["cmd"])[1] for name, stage in DVC.items()}
    assert set(STAGES) == set(modules.values()) - {"code"}
    for name, module in modules.items():
        if module != "code":
            of_code = [dep for dep in DVC[name]["deps"] if not dep.startswith(("data/", "models/", "reports/"))]
            assert f"data/code/{module}" in DVC[name]["deps"]
            # Networks of the package, and a page that is no code and has no fingerprint.
            assert set(of_code) <= {"hdsp/learning/shipped", "pipeline/report_page.html"}, f"{name} depends on sources"
    assert not list((ROOT / "hdsp/learning/shipped").rglob("*.py"))


def test_the_stage_of_fingerprints_sees_every_source():
    assert {"hdsp", "pipeline"} == set(DVC["code"]["deps"])
    assert "model.architecture" in DVC["code"]["params"]
