"""Mistakes that show before the work begins: names, tags, own networks, values that teach nothing."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch import nn

from hdsp.base.errors import InputError
from hdsp.base.yaml_files import parse_yaml
from hdsp.learning.loading import load_abstraction
from hdsp.learning.networks import TaskNetwork, build_network
from hdsp.planning.commands.lab_command import write_lab
from hdsp.robot.lattice import PATCH_CELLS
from hdsp.robot.robot import Robot
from pipeline.config import configure, write_params
from pipeline.folders import Folders
from pipeline.publish_model import _validation
from pipeline.sweeps import checked_choices


@pytest.mark.parametrize("value", ["!!timestamp x", "!!bool x", '!!int ""', '!!float ""'])
def test_a_value_that_does_not_fit_its_tag_is_named_with_its_line(value):
    with pytest.raises(InputError, match="it, line 2: not YAML: "):
        parse_yaml(f"a: 1\nname: {value}\n", "it")


@pytest.mark.parametrize(
    "override",
    [
        "runtime.register=a/b@c", "runtime.register=a@b@c", "runtime.register=a@latest", "runtime.register=a@v3",
        "runtime.variant=../x", "search.name=../../x", "robot.name=../x", "trainer.splits=[train,train]",
        "model.encoding.scale=0", "robot.feet.min_separation=0.7",
    ],
)  # fmt: skip
def test_values_that_cannot_work_are_refused_by_name(override):
    with pytest.raises(InputError, match=override.partition("=")[0].rpartition(".")[2]):
        configure([override])


def test_noted_validation_splits_are_names_and_no_paths(tmp_path):
    config, folders = configure([]), Folders(tmp_path, tmp_path)
    for names in (["../../.."], ["a/b"], 1.5, [3]):
        with pytest.raises(InputError, match=r"provenance\.notes\.trainer"):
            _validation({"val_splits": names}, config, folders)
    with pytest.raises(InputError, match="unknown split 'val-2'"):
        _validation({"val_splits": ["val-2"]}, config, folders)


def test_losses_without_weights_are_refused_and_registered_names_accepted():
    with pytest.raises(InputError, match="or nothing is learned"):
        configure(["trainer.losses.feasibility=0", "trainer.losses.cost=0"])
    for name in ("momaro", "momaro@best", "momaro@a-1_b"):
        assert configure([f"runtime.register={name}"]).runtime.register == name


def test_wrong_parameters_leave_the_file_as_it_is(tmp_path):
    path = tmp_path / "params.yaml"
    path.write_text("before")
    for override in ("trainer.epochs=-1", "labelling.splits.train.seed=abc"):
        with pytest.raises(InputError):
            write_params(path, [override])
    assert path.read_text() == "before"


def test_runs_of_a_sweep_have_no_folder_in_common(monkeypatch):
    from pipeline.command_line import parse

    with pytest.raises(InputError, match=r"hydra\.sweep\.dir"):
        checked_choices(parse(["runtime.outputs=x", "trainer.seed=1,2", "-m"], "train"))


@pytest.mark.parametrize("name", ["class", "json", "yaml", "swept", "manual"])
def test_a_lab_hides_no_package_and_no_built_in_name(name, tmp_path):
    with pytest.raises(InputError, match=f"name '{name}'"):
        write_lab(name, tmp_path / "lab")
    assert not (tmp_path / "lab").exists()


@pytest.mark.parametrize("batch", [0, -1, 1.5, None, "x"])
def test_batches_and_goals_are_numbers(batch):
    abstraction = load_abstraction("momaro")
    patches, goals = np.zeros((2, PATCH_CELLS, PATCH_CELLS), np.float32), np.zeros((1, 3))
    with pytest.raises(InputError, match="batch is"):
        abstraction.predict(patches, goals, batch)
    with pytest.raises(InputError, match="goals: need finite numbers"):
        abstraction.predict(patches, goals + np.nan)


def test_robots_whose_neutral_feet_are_too_near_each_other_are_refused():
    values = Robot.load("momaro").to_dict()
    values["feet"]["min_separation"] = 2 * values["feet"]["neutral_x"] + 0.1
    with pytest.raises(InputError, match="the distance of neutral feet"):
        Robot.load(values)


class _Foreign(TaskNetwork):
    """A network that keeps the contract as far as it is checked before a training."""

    @dataclass
    class Options:
        pass

    def __init__(self, encoding, options):
        super().__init__(encoding)
        self.heads = nn.Linear(PATCH_CELLS, 2)

    def forward(self, heights, goals):
        found = self.heads(heights[:, 0].mean(1))[:, None].expand(-1, goals.shape[1], -1)
        return found[..., 0], found[..., 1]


class _NoHeads(_Foreign):
    def __init__(self, encoding, options):
        super().__init__(encoding, options)
        del self.heads


class _OtherShapes(_Foreign):
    def forward(self, heights, goals):
        return tuple(each[:, 0] for each in super().forward(heights, goals))


class _Fixed(_Foreign):
    def __init__(self, encoding, options):
        super().__init__(encoding, options)
        self.requires_grad_(False)


class _OneArgument(_Foreign):
    def __init__(self, encoding):
        super().__init__(encoding, None)


class _PlainOptions(_Foreign):
    Options = dict


def test_a_network_of_another_package_is_tried_before_its_training():
    state = torch.random.get_rng_state()
    assert isinstance(build_network({"architecture": f"{__name__}:_Foreign"}), _Foreign)
    torch.random.set_rng_state(state)
    for network, words in [
        ("_NoHeads", "heads"), ("_OtherShapes", r"shapes \[\(2,\), \(2,\)\]; need 2 of \[batch, goals\]"),
        ("_Fixed", "no parameters to train"), ("_OneArgument", "TypeError"), ("_PlainOptions", "a dataclass"),
    ]:  # fmt: skip
        with pytest.raises(InputError, match=words):
            build_network({"architecture": f"{__name__}:{network}"})


def test_code_that_does_not_compile_is_named(tmp_path, monkeypatch):
    (tmp_path / "broken_network.py").write_text("def (:\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError, match=r"cannot load broken_network:N: SyntaxError: .*broken_network\.py, line 1"):
        build_network({"architecture": "broken_network:N"})
