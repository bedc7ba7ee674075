"""Damaged settings, by the seed: each gives settings, or one line; never a traceback."""

import json
import shutil
from collections import Counter

import numpy as np
import pytest
import yaml

from hdsp.base.errors import InputError
from hdsp.base.settings import load_settings
from hdsp.robot.robot import Robot
from tests import ROOT
from tests.base.mutations import edited, mutated_file
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


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A small abstraction, calibrated, with all kinds of notes."""
    import torch

    from hdsp.learning import LearnedAbstraction, ModelSettings, Provenance, build_network

    torch.manual_seed(0)
    model = load_settings(ModelSettings, TINY_MODEL, "model")
    provenance = Provenance.of(Robot.load("momaro"), "0123", maps=3, trainer={"splits": ["train"]})
    abstraction = LearnedAbstraction(build_network(model), model, provenance, {"cost_error/val": 0.1})
    return abstraction.calibrated(synthetic_tasks(40)).save_pretrained(tmp_path_factory.mktemp("saved") / "model")


def test_configurations_of_models(saved, tmp_path):
    from hdsp.learning import LearnedAbstraction

    folder = shutil.copytree(saved, tmp_path / "model")
    path = folder / "config.json"
    values = json.loads(path.read_text())
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
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))
    found = outcome(LearnedAbstraction.from_pretrained, path.parent)
    assert found.startswith(f"{path}: {says}")
