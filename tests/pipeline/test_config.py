"""conf/ is the single source: params.yaml is its composition, and user errors give one-line messages."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from hdsp.base.errors import InputError
from hdsp.labels.rules import LabelSettings
from hdsp.terrain.random_arenas import ArenaSettings
from hdsp.terrain.scenes import TerrainSettings
from pipeline.config import CONF, compose, expand_choices, flatten, plain, settings, write_params
from tests import ROOT


def test_params_yaml_is_the_composition_of_conf(tmp_path):
    write_params(tmp_path / "params.yaml")
    assert (ROOT / "params.yaml").read_text() == (tmp_path / "params.yaml").read_text(), "run `make params`"


def test_params_are_the_bytes_that_dvc_writes(tmp_path):
    from dvc.utils.hydra import compose_and_dump

    write_params(tmp_path / "ours.yaml", ["model=klamt2019"])
    compose_and_dump(tmp_path / "dvc.yaml", str(ROOT / "conf"), None, "config", "", ["model=klamt2019"])
    assert (tmp_path / "ours.yaml").read_bytes() == (tmp_path / "dvc.yaml").read_bytes()


@pytest.mark.parametrize("profile", sorted(p.stem for p in (ROOT / "conf/profile").glob("*.yaml")))
@pytest.mark.parametrize("model", sorted(p.stem for p in (ROOT / "conf/model").glob("*.yaml")))
def test_each_profile_composes_with_each_model(profile, model):
    config = compose([f"profile={profile}", f"model={model}"])
    assert config.profile == profile
    assert config.model == compose([f"model={model}"]).model


def test_profile_paper_has_the_counts_and_recipe_of_the_paper():
    config = compose(["profile=paper"])
    splits = {name: split.maps_per_category for name, split in config.labelling.splits.items()}
    assert {name: splits[name] for name in ("train", "val", "random")} == {"train": 2000, "val": 100, "random": 200}
    assert not any(config.labelling.splits[name].get("sensing") for name in ("train", "val", "random"))
    assert (config.trainer.splits, config.trainer.val_splits) == (["train"], ["val"])
    assert config.model.architecture == "klamt2019"
    assert (config.trainer.epochs, config.trainer.optimizer.lr, config.trainer.optimizer.momentum) == (100, 1e-4, 0.9)
    assert config.trainer.batch == {"by": "task", "size": 1}


def test_sets_may_be_added_without_a_plus_and_sections_of_others_not():
    sets = compose(["evaluation.sets.mine.scans=somewhere"]).evaluation.sets
    assert sets.mine == {"scans": "somewhere"} and "random" in sets
    with pytest.raises(InputError, match=r"unknown config key 'evaluation\.mine'"):
        compose(["evaluation.mine=1"])


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("modle=compact", "unknown config key 'modle'"),
        ("trainer.epoch=3", "unknown config key 'trainer.epoch'; allowed under trainer: "),
        ("model=nonsense", "Available options in 'model': compact dilated"),
        ("experiment=klamt2091", "Available options in 'experiment': finish klamt2019"),
        ("model=[", "no viable alternative"),
    ],
)
def test_wrong_overrides_are_named_in_one_line(override, says):
    with pytest.raises(InputError) as caught:
        compose([override])
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_command_line_prints_that_line_alone():
    command = [sys.executable, "-m", "pipeline.report", "trainer.epoch=3"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.startswith("error: unknown config key 'trainer.epoch'")
    assert done.stderr.count("\n") == 1


def test_missing_params_file_is_named(tmp_path):
    command = [sys.executable, "-m", "pipeline.report"]
    environment = {"PYTHONPATH": str(ROOT), "PATH": ""}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert done.stderr.startswith("error: params.yaml not found")


def test_choices_are_expanded_one_at_a_time():
    assert expand_choices(["model=a,b", "seed=1"]) == [["model=a", "seed=1"], ["model=b", "seed=1"]]


def test_flat_parameters_have_dotted_names():
    assert flatten({"a": {"b": 1, "c": {"d": [2]}}, "e": 3}) == {"a.b": 1, "a.c.d": [2], "e": 3}


def test_no_stage_depends_on_the_runtime_group():
    stages = yaml.safe_load((ROOT / "dvc.yaml").read_text())["stages"]
    sections = {parameter.split(".")[0] for stage in stages.values() for parameter in stage.get("params", [])}
    assert "runtime" not in sections
    assert sections <= set(plain(compose()))


def test_each_robot_file_exists_once():
    assert (ROOT / "conf/robot").resolve() == ROOT / "hdsp/robot/presets"
    assert not Path((ROOT / "conf/robot").readlink()).is_absolute()


def test_the_configured_terrain_is_that_of_the_authors_generator():
    assert settings(TerrainSettings, compose().terrain, "terrain") == TerrainSettings()


def test_the_configured_label_rule_is_that_of_the_published_labels():
    configured = settings(LabelSettings, compose().labelling.settings, "labelling.settings")
    fitted = ("heading_window", "turn_cost_factor")
    assert [getattr(configured, name) for name in fitted] == [getattr(LabelSettings(), name) for name in fitted]


def test_the_configured_arena_is_the_default_of_the_library():
    assert settings(ArenaSettings, compose(["arena=small"]).arena.contents, "arena.contents") == ArenaSettings()


def test_an_unknown_key_of_a_settings_group_is_named():
    with pytest.raises(InputError, match=r"unknown config key terrain.cuboid_sides; allowed are area, clutter_height"):
        settings(TerrainSettings, {"cuboid_sides": [1, 2]}, "terrain")


@pytest.mark.parametrize("profile", sorted(path.stem for path in (CONF / "profile").glob("*.yaml")))
def test_what_a_profile_trains_on_has_a_stage(profile):
    config = compose([f"profile={profile}"])
    made = {*config.labelling.used, *config.simulation.used}
    assert {*config.trainer.splits, *config.trainer.val_splits} <= made
    assert set(config.labelling.used) <= set(config.labelling.splits)
    assert set(config.simulation.used) <= set(config.simulation.splits)
