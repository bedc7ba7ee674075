"""Checkpoints and folders of abstractions from strangers: nothing is run, and damage is named."""

import json
import os
import pickle
import shutil
import warnings

import pytest
import torch

import hdsp
from hdsp.base.errors import InputError
from hdsp.base.settings import load_settings
from hdsp.learning import LearnedAbstraction, ModelSettings, build_network, train
from hdsp.learning.checkpoints import read_checkpoint
from pipeline.config import configure
from pipeline.publish_model import in_progress
from pipeline.stage import Folders
from tests.learning.synthetic import TINY_MODEL, synthetic_tasks, tiny_config


class Command:
    """Runs a command where it is unpickled."""

    def __init__(self, place):
        self.place = place

    def __reduce__(self):
        return os.system, (f"touch {self.place}",)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A finished training."""
    place = tmp_path_factory.mktemp("training")
    train(tiny_config(epochs=1), synthetic_tasks(16), {"val": synthetic_tasks(8, 1)}, place, quiet=True)
    return place


@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
def test_h4_a_command_in_a_checkpoint_is_not_run_by_publishing(folder, tmp_path):
    state = torch.load(folder / "checkpoints/best.ckpt", weights_only=True)
    (tmp_path / "checkpoints").mkdir()
    torch.save({**state, "note": Command(tmp_path / "ran")}, tmp_path / "checkpoints/best.ckpt")
    config = configure(["profile=tiny"])
    with pytest.raises(InputError, match=r"best\.ckpt is not loaded: it holds objects, which would run code$"):
        in_progress(tmp_path, config.robot, config, Folders(tmp_path, tmp_path))
    (tmp_path / "checkpoints/best.ckpt").write_bytes(pickle.dumps(Command(tmp_path / "ran")))
    with pytest.raises(InputError, match=r"best\.ckpt"):
        in_progress(tmp_path, config.robot, config, Folders(tmp_path, tmp_path))
    assert not (tmp_path / "ran").exists()


def test_h4_a_command_in_the_last_checkpoint_is_not_run_by_a_training_that_goes_on(folder, tmp_path):
    place = shutil.copytree(folder, tmp_path / "copy")
    state = torch.load(place / "checkpoints/last.ckpt", weights_only=True)
    torch.save({**state, "callbacks": Command(tmp_path / "ran")}, place / "checkpoints/last.ckpt")
    with pytest.raises(InputError, match=r"last\.ckpt is not loaded: it holds objects"):
        train(tiny_config(epochs=1), synthetic_tasks(16), {"val": synthetic_tasks(8, 1)}, place, quiet=True)
    assert not (tmp_path / "ran").exists()


@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 cut off", pickle.dumps({"epoch": 1}), b"x" * 100])
def test_a_damaged_checkpoint_is_named(tmp_path, damage):
    (tmp_path / "best.ckpt").write_bytes(damage)
    with pytest.raises(InputError, match=r"checkpoint .*best\.ckpt") as error:
        read_checkpoint(tmp_path / "best.ckpt")
    assert "\n" not in str(error.value)


def test_h4_loading_an_abstraction_runs_nothing(folder, monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("unpickled")

    for name in ("load", "loads", "Unpickler"):
        monkeypatch.setattr(pickle, name, refuse)
    monkeypatch.setattr(torch, "load", refuse)
    assert hdsp.load_abstraction(folder / "model").model.architecture == "compact"


def test_h8_one_changed_digit_in_a_configuration_is_found(tmp_path):
    model = load_settings(ModelSettings, TINY_MODEL, "model")
    abstraction = LearnedAbstraction(build_network(model), model, metrics={"cost_error": 0.125})
    place = abstraction.save_pretrained(tmp_path / "a", picture=False)
    path = place / "config.json"
    text = path.read_text()
    path.write_text(text.replace("0.125", "0.124"))
    with pytest.raises(InputError, match=r"config\.json: damaged, or edited .* the checksum differs"):
        hdsp.load_abstraction(place)
    values = json.loads(text)
    path.write_text(json.dumps({**values, "edges_threshold": 1.5}))
    with pytest.raises(InputError, match=r"edges_threshold is 1\.5; need at most 1"):
        hdsp.load_abstraction(place)
    del values["config_sha256"]  # as an earlier version wrote it, or as somebody edits it
    path.write_text(json.dumps({**values, "edges_threshold": 0.25}))
    assert hdsp.load_abstraction(place).edges_threshold == 0.25


def test_h4_the_loader_of_mlflow_models_says_that_it_runs_code(monkeypatch):
    from pipeline import served_model

    monkeypatch.setattr("mlflow.models.set_model", lambda model: None)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        served_model._define()
    assert any("runs code from its folder" in str(warning.message) for warning in said)
