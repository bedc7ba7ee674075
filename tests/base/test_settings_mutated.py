"""Damaged settings, by the seed: each gives settings, or one line; never a traceback."""

import json
import os
import shutil
import subprocess
import sys
import time
from collections import Counter

import numpy as np
import pytest
import yaml

from hdsp.base.errors import InputError
from hdsp.base.settings import load_settings
from hdsp.base.yaml_files import read_yaml
from hdsp.robot.robot import Robot
from hdsp.terrain.arenas import read_arena
from hdsp.terrain.scans import Scan
from pipeline.config import configure, read_params
from pipeline.config_types import Config
from pipeline.stage import run_stage
from tests import ROOT
from tests.base.mutations import PIECES, WRONG, edited, mutated_file, places
from tests.learning.synthetic import TINY_MODEL, synthetic_tasks


def outcome(load, *arguments):
    """What loading gives, or the line that it ends with."""
    try:
        return load(*arguments)
    except InputError as error:
        assert len(str(error).splitlines()) == 1 and str(error), repr(error)
        return str(error)


@pytest.mark.parametrize("preset", Robot.presets())
def test_robot_files(preset, tmp_path):
    text = (ROOT / f"hdsp/robot/presets/{preset}.yaml").read_bytes()
    values, path = yaml.safe_load(text), tmp_path / "own.yaml"
    outcomes = []
    for seed in range(200):
        path.write_bytes(mutated_file(values, text, np.random.default_rng(seed)))
        outcomes.append(outcome(Robot.load, path))
    refused = [found for found in outcomes if isinstance(found, str)]
    assert all(found.startswith(str(path)) for found in refused)
    assert all(len(robot.hash()) == 64 for robot in outcomes if isinstance(robot, Robot))
    assert 100 < len(refused) < 200  # damage is noticed, and comments may be


@pytest.mark.parametrize("name", ["rsl_real_stairs", "tum_fr2_pioneer_slam2"])
def test_descriptions_of_scans(name, tmp_path):
    text = (ROOT / f"conf/scans/{name}.yaml").read_bytes()
    values, path = yaml.safe_load(text), tmp_path / "scan.yaml"

    def load():
        document = read_yaml(path, "description of a scan")
        return Scan.from_dict(name, document.values, document)

    outcomes = []
    for seed in range(60):
        path.write_bytes(mutated_file(values, text, np.random.default_rng(seed)))
        outcomes.append(outcome(load))
    refused = [found for found in outcomes if isinstance(found, str)]
    assert all(found.startswith(str(path)) for found in refused) and 25 < len(refused) < 60


def test_descriptions_of_arenas():
    values = yaml.safe_load((ROOT / "conf/arena/paper.yaml").read_bytes())
    outcomes = [outcome(read_arena, edited(values, np.random.default_rng(seed))) for seed in range(200)]
    refused = [found for found in outcomes if isinstance(found, str)]
    assert all(found.startswith("arena") for found in refused) and 100 < len(refused) < 200


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A small abstraction, calibrated, with all kinds of notes."""
    import torch

    from hdsp.learning import LearnedAbstraction, ModelSettings, Provenance, build_network

    torch.manual_seed(0)
    model = load_settings(ModelSettings, TINY_MODEL, "model")
    provenance = Provenance.of(Robot.load("momaro"), "0123", maps=3, trainer={"splits": ["train"]})
    abstraction = LearnedAbstraction(build_network(model), model, provenance, {"cost_error/val": 0.1})
    return abstraction.calibrated(synthetic_tasks(40)).save_pretrained(
        tmp_path_factory.mktemp("saved") / "model", picture=False
    )


def test_configurations_of_models(saved, tmp_path):
    from hdsp.learning import LearnedAbstraction

    folder = shutil.copytree(saved, tmp_path / "model")
    path = folder / "config.json"
    values = json.loads(path.read_text())
    del values["config_sha256"]  # types and ranges alone
    outcomes = Counter()
    for seed in range(1300):
        path.write_text(json.dumps(edited(values, np.random.default_rng(seed))))
        found = outcome(LearnedAbstraction.from_pretrained, folder)
        outcomes[type(found)] += 1
        assert isinstance(found, LearnedAbstraction) or found.startswith(str(folder)), found
    assert outcomes[str] > 1000 and outcomes[LearnedAbstraction] > 20


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("lattice", [1], "lattice is [1]; need a mapping"),
        ("metrics", 1.5, "metrics is 1.5; need a mapping"),
        ("metrics", {"cost_error/val": "low"}, "metrics['cost_error/val'] is 'low'; need a finite number"),
        ("calibration", {"temperature": 0}, "calibration.temperature is 0; need a positive number"),
        ("model", {"archtecture": "compact"}, "model: unknown key 'archtecture'; did you mean 'architecture'?"),
        ("model", {"architecture": "compact", "options": {"hidden": 0}}, "model.options.hidden is 0; need at least 1"),
        ("format_version", 2, "format_version is 2, but this program works with 1"),
    ],
)
def test_faults_of_a_model_name_file_and_key(saved, tmp_path, key, value, says):
    from hdsp.learning import LearnedAbstraction

    path = shutil.copytree(saved, tmp_path / "model") / "config.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value, "config_sha256": ""}))
    found = outcome(LearnedAbstraction.from_pretrained, path.parent)
    assert found.startswith(f"{path}: {says}")


def end_of(stage, monkeypatch, *overrides):
    """How a stage ends that is called with overrides: 0, or what `sys.exit` gets."""
    monkeypatch.setattr(sys, "argv", ["stage", *overrides])
    try:
        run_stage(stage, "stage")
    except SystemExit as error:
        return error.code
    return 0


def test_params_files(tmp_path, monkeypatch):
    text = (ROOT / "params.yaml").read_bytes()
    values = yaml.safe_load(text)
    monkeypatch.chdir(tmp_path)
    began, ends = [], Counter()
    for seed in range(60):
        (tmp_path / "params.yaml").write_bytes(mutated_file(values, text, np.random.default_rng(seed)))
        end = end_of(lambda config, folders: began.append(config), monkeypatch)
        ends[end == 0] += 1
        assert end == 0 or (end.startswith("error: params.yaml") and len(end.splitlines()) == 1), end
    assert all(isinstance(config, Config) for config in began) and len(began) == ends[True]
    assert ends[False] > 40


def overrides(values, random):
    """An override as somebody might type it: a value of another kind, a key that does not exist, a broken text."""
    paths = [path for path in places(values) if path and all(isinstance(part, str) for part in path)]
    path = paths[random.integers(len(paths))]
    key, value = ".".join(path), WRONG[random.integers(len(WRONG))]
    text = "null" if value is None else json.dumps(value).replace('"', "")
    piece = PIECES[random.integers(len(PIECES))].decode("latin-1").strip() or "x"
    forms = [
        f"{key}={text}", f"{key}={text}", f"{key}='{text}'", f"{key}.x={text}", f"{key[:-1]}={text}", f"+{key}x=1",
        f"~{key}", f"{key}={piece}", f"{key}{piece}=1", f"{path[0]}={text}", f"{path[0]}@{key}={text}",
        f"++{key}={{a: {text}}}", f"{key}=${{{key}}}", f"{key}=${{oc.env:NOTHING}}", f"hydra.{key}={text}",
    ]  # fmt: skip
    return forms[random.integers(len(forms))].replace("\n", " ")


def test_overrides(monkeypatch, tmp_path):
    values = yaml.safe_load((ROOT / "params.yaml").read_text())
    monkeypatch.chdir(tmp_path)
    began, ends = [], Counter()
    for seed in range(54):
        override = overrides(values, np.random.default_rng(seed))
        end = end_of(lambda config, folders: began.append(config), monkeypatch, override)
        ends[end == 0] += 1
        assert end == 0 or (end.startswith("error: ") and len(end.splitlines()) == 1), (override, end)
    assert all(isinstance(config, Config) for config in began) and len(began) == ends[True]
    assert ends[False] > 25


def test_a_stage_ends_with_one_line_and_status_1(tmp_path):
    (tmp_path / "params.yaml").write_text("trainer: [")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    for arguments, says in [
        ([], "error: params.yaml, line 1: not YAML: "),
        (
            ["labelling.settings.cost_limit_factor=abc"],
            "error: labelling.settings.cost_limit_factor is 'abc'; need a finite number",
        ),
    ]:
        command = [sys.executable, "-m", "pipeline.report", *arguments]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert (done.returncode, done.stderr.count("\n")) == (1, 1), done.stderr
        assert done.stderr.startswith(says)


def test_the_whole_configuration_takes_no_longer_than_a_moment():
    configure()  # validators are built
    began = time.process_time()
    read_params(ROOT / "params.yaml")
    assert time.process_time() - began < 1.0
