"""`hdsp lab`: a package outside this one, which a process with nothing else finds."""

import subprocess
import sys
from importlib.metadata import EntryPoint

import pytest
import yaml

from hdsp.base import extensions
from hdsp.base.errors import InputError
from hdsp.learning.network_conformance import check_network
from hdsp.learning.networks import build_network
from hdsp.planning.commands.lab_command import FILES, write_lab
from hdsp.terrain.scenes import random_map
from pipeline.config import Source, configure


@pytest.fixture
def lab(tmp_path, monkeypatch):
    """A written package, found as if it were installed."""
    folder = write_lab("own_lab_2", tmp_path / "lab")
    monkeypatch.syspath_prepend(folder)
    points = [
        EntryPoint("own_lab_2", "own_lab_2.learning:OwnLab2", "hdsp.networks"),
        EntryPoint("own_lab_2", "own_lab_2.planning:OwnLab2Heuristic", "hdsp.heuristics"),
        EntryPoint("own_lab_2_posts", "own_lab_2.planning:posts", "hdsp.terrain"),
    ]
    monkeypatch.setattr(extensions, "entry_points", lambda group: [p for p in points if p.group == group])
    extensions.extensions.cache_clear()
    yield folder
    extensions.extensions.cache_clear()
    for name in [name for name in sys.modules if name.startswith("own_lab_2")]:
        del sys.modules[name]


def test_its_files_are_whole_and_its_entry_points_are_those_announced(lab):
    assert all((lab / place.format(name="own_lab_2")).is_file() for place in FILES.values())
    for path in lab.rglob("*.py"):
        compile(path.read_text(), str(path), "exec")
    announced = (lab / "pyproject.toml").read_text()
    for place in ("own_lab_2.learning:OwnLab2", "own_lab_2.planning:OwnLab2Heuristic", "own_lab_2.planning:posts"):
        assert f'"{place}"' in announced
    stages = yaml.safe_load((lab / "dvc.yaml").read_text())["stages"]
    assert set(stages) == {"code", "label", "train", "evaluate", "plan"}


def test_its_configuration_composes_and_names_its_own_parts(lab):
    config = configure(["profile=tiny"], Source(lab / "conf", "own_lab_2"))
    assert config.model.architecture == "own_lab_2"
    assert config.labelling.splits["train"].categories[-1] == "own_lab_2_posts"
    assert config.planner.heuristics[-1] == "own_lab_2"
    from pipeline.parts import training_parts

    parts = training_parts(config.trainer, config.runtime.lightning)
    assert parts.loss is not None and set(parts.metrics) == {"false_feasible"} and len(parts.callbacks) == 1
    with pytest.raises(InputError, match=r"trainer.loss._target_ is 'own_lab_2.learning.nix'"):
        place = "trainer.loss._target_=own_lab_2.learning.nix"
        wrong = configure(["profile=tiny", place], Source(lab / "conf", "own_lab_2"))
        training_parts(wrong.trainer, wrong.runtime.lightning)


def test_its_network_keeps_the_contract_and_its_terrain_has_posts(lab):
    model = yaml.safe_load((lab / "conf/model/own_lab_2.yaml").read_text())
    assert "gradients" in check_network(build_network(model))
    assert random_map(1, "own_lab_2_posts", 0).heights.max() == 1.0


def test_wrong_names_and_folders_are_refused(tmp_path):
    for name in ("Own", "own-lab", "hdsp", "class 1"):
        with pytest.raises(InputError, match="need a Python identifier"):
            write_lab(name, tmp_path / "new")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is not empty"):
        write_lab("own", tmp_path)


def test_the_command_writes_it(tmp_path):
    command = [sys.executable, "-m", "hdsp", "lab", "own", "--folder", str(tmp_path / "x")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0 and "pip install -e" in done.stdout
    assert (tmp_path / "x/own/learning.py").is_file()
