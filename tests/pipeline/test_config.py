"""conf/ is the single source: params.yaml is its composition, and user errors give one-line messages."""

import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
import yaml
from omegaconf import OmegaConf

from hdsp.base.errors import InputError
from hdsp.labels.rules import LabelSettings
from hdsp.terrain.random_arenas import ArenaSettings
from hdsp.terrain.scenes import TerrainSettings
from pipeline.config import CONF, compose, configure, expand_choices, flatten, plain, read_params, typed, write_params
from tests import ROOT


def test_params_yaml_is_the_composition_of_conf(tmp_path):
    write_params(tmp_path / "params.yaml")
    assert (ROOT / "params.yaml").read_text() == (tmp_path / "params.yaml").read_text(), "run `make params`"


def test_params_are_the_bytes_that_dvc_writes(tmp_path):
    from dvc.utils.hydra import compose_and_dump

    write_params(tmp_path / "ours.yaml", ["model=klamt2019"])
    compose_and_dump(tmp_path / "dvc.yaml", str(ROOT / "conf"), None, "config", "", ["model=klamt2019"])
    assert (tmp_path / "ours.yaml").read_bytes() == (tmp_path / "dvc.yaml").read_bytes()


MODELS, PROFILES = (sorted(p.stem for p in (ROOT / "conf" / group).glob("*.yaml")) for group in ("model", "profile"))
#: Pairs that run by day: each profile with two models, and each model with one profile.
PAIRS = {(profile, model) for profile in PROFILES for model in ("compact", "klamt2019")}
PAIRS |= {("small", model) for model in MODELS}


@cache
def model_alone(model):
    return compose([f"model={model}"]).model


@pytest.mark.parametrize(
    ("profile", "model"),
    [
        pytest.param(profile, model, marks=[] if (profile, model) in PAIRS else pytest.mark.nightly)
        for profile in PROFILES
        for model in MODELS
    ],
)
def test_each_profile_composes_with_each_model(profile, model):
    config = compose([f"profile={profile}", f"model={model}"])
    assert config.profile == profile
    assert config.model == model_alone(model)
    assert typed(config).profile == profile


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
    with pytest.raises(InputError, match=r"^evaluation: unknown key 'mine'; allowed are edges_threshold, examples, "):
        compose(["evaluation.mine=1"])


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("modle=compact", "unknown key 'modle'; did you mean 'model'? allowed are abstraction, arena, "),
        ("trainer.epoch=3", "trainer: unknown key 'epoch'; did you mean 'epochs'? allowed are accumulate, batch, "),
        ("trainer.optimizer.lr.x=3", "trainer.optimizer.lr is 0.002, a value without keys; 'x' is unknown"),
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


@pytest.mark.parametrize(
    ("override", "says"),
    [
        (
            "labelling.settings.cost_limit_factor=abc",
            "labelling.settings.cost_limit_factor is 'abc'; need a finite number",
        ),
        ("labelling.settings=null", "labelling.settings is None; need a mapping"),
        ("labelling.used=[train,tests]", "labelling.used[1] is 'tests'; need one of labelling.splits: train, val, "),
        (
            "labelling.scheduler=cluster",
            "labelling.scheduler is 'cluster'; need null (this machine), slurm, or",
        ),
        ("labelling.slurm.jobs=0", "labelling.slurm.jobs is 0; need a whole number of at least 1"),
        ("labelling.splits.val.seed=1.5", "labelling.splits.val.seed is 1.5; need a whole number"),
        (f"labelling.splits.val.seed={2**63}", f"labelling.splits.val.seed is {2**63}; need at most {2**63 - 1}"),
        ("planner.margin=x", "planner.margin is 'x'; need a finite number"),
        ("planner.weights=[0.5]", "planner.weights[0] is 0.5; need at least 1"),
        ("planner.heuristics=[best]", "planner.heuristics[0] is 'best'; need one of trained, shipped"),
        ("trainer.epochs='3'", "trainer.epochs is '3'; need a whole number"),
        (
            "trainer.splits=[nix]",
            "trainer.splits[0] is 'nix'; need one of labelling.splits, simulation.splits, or a folder (with a /): ",
        ),
        ("model.architecture=compat", "model.architecture is 'compat'; need one of klamt2019, compact, "),
        ("model.encoding.clip=[1,0]", "model.encoding.clip is [1.0, 0.0]; need the smaller number first"),
        ("evaluation.examples=many", "evaluation.examples is 'many'; need a whole number"),
        ("abstraction.margin=-1", "abstraction.margin is -1; need at least 0"),
        ("arena.size=3.01", "arena.size is 3.01; need a positive multiple of 0.025"),
        ("arena.tasks=[]", "arena.tasks is []; need at least one task"),
        ("simulation.lidar.beams=2.5", "simulation.lidar.beams is 2.5; need a whole number"),
        ("scans.patches.known=2", "scans.patches.known is 2; need at most 1"),
        ("terrain.area=true", "terrain.area is True; need a finite number"),
        ("robot.step.max_length=1", "robot.step.max_length is 1; need at most 0.375"),
        ("runtime.workers=0", "runtime.workers is 0; need at least 1"),
        ("runtime.memory=much", "runtime.memory is 'much'; need a number of bytes, such as 2GB"),
        ("runtime.hardware.precision=16", "runtime.hardware.precision is 16; need 'auto', '32' or 'bf16'"),
        ("+trainer.epoch=3", "trainer: unknown key 'epoch'; did you mean 'epochs'?"),
        ("~planner.margin", "planner: key 'margin' is missing"),
    ],
)
def test_wrong_values_are_named_before_a_stage_begins(override, says):
    with pytest.raises(InputError) as caught:
        configure([override])
    assert str(caught.value).startswith(says)
    assert "\n" not in str(caught.value)


#: Overrides that put maps in two roles, and what is said of them.
TWICE = {
    "evaluation.sets.val.scans=x evaluation.watched=[val]": "evaluation.watched[0] is 'val'; need a set with another",
    "evaluation.sets.train.scans=x evaluation.watched=[train]": "evaluation.watched[0] is 'train'; need a set with an",
    "trainer.selection.set=random": "trainer.selection.set is 'random'; need val (trainer.val_splits); sets in evaluat",
    "trainer.val_splits=[val,train]": "trainer.val_splits[1] is 'train'; need other maps than trainer.splits[0], whi",
    "trainer.splits=[train,random]": "evaluation.sets.random.split is 'random'; need other maps than trainer.splits[1]",
    "evaluation.sets.x.split=val": "evaluation.sets.x.split is 'val'; need other maps than trainer.val_splits[0]",
    "trainer.splits=[/a/b] evaluation.sets.x.tasks=/a/b/../b/c": "evaluation.sets.x.tasks is '/a/b/../b/c'; need other",
    "evaluation.sets.x.scans=data": "evaluation.sets.x.scans is 'data'; need other maps than trainer.splits[0], which",
    "trainer.val_splits=[./data/labels/train]": "trainer.val_splits[0] is './data/labels/train'; need other maps than",
    "labelling.splits.val.seed=1": "labelling.splits.val.seed is 1; need another seed than labelling.splits.train",
    "trainer.splits=[sensed] labelling.splits.sensed.seed=3": "labelling.splits.random.seed is 3; need another seed",
    "trainer.splits=[courses] simulation.splits.more={seed:21,courses:2,patches_per_course:3} "
    "evaluation.sets.x.split=more": "simulation.splits.more.seed is 21; need another seed than simulation.splits.",
    "simulation.splits.courses.seed=4": "simulation.splits.courses.seed is 4; need another seed than simulation.patche",
}


@pytest.fixture(scope="module")
def changed():
    """The configuration with some values replaced, which takes less time than composing it."""
    base = plain(compose())

    def typed_with(words):
        values = [word.replace(":", ": ") for word in words.split()]
        return typed(OmegaConf.merge(OmegaConf.create(base), OmegaConf.from_dotlist(values)))

    return typed_with


@pytest.mark.parametrize(("words", "says"), TWICE.items())
def test_no_map_is_in_two_roles(changed, words, says):
    with pytest.raises(InputError) as caught:
        changed(words)
    assert str(caught.value).startswith(says)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "words",
    [
        "labelling.splits.sensed.seed=1",  # not used
        "trainer.splits=[train,sensed] labelling.splits.sensed.seed=1",  # both for training
        "trainer.splits=[blocked] labelling.splits.blocked.seed=3",  # the other maps of the same seed
        "labelling.splits.val.seed=1 labelling.splits.val.categories=[kerb]",
        "trainer.splits=[/a/b,/a/c] trainer.val_splits=[/a/bc] evaluation.sets.x.tasks=/a/d",
        "trainer.splits=[courses] labelling.splits.random.seed=21",  # other scenes
    ],
)
def test_maps_that_are_apart_may_be_used(changed, words):
    changed(words)


def test_a_fault_in_params_is_named_with_its_line(tmp_path):
    lines = (ROOT / "params.yaml").read_text().splitlines()
    place = next(number for number, line in enumerate(lines) if line.startswith("  epochs:"))
    lines[place] = "  epochs: many"
    (tmp_path / "params.yaml").write_text("\n".join(lines))
    with pytest.raises(InputError, match=rf"params\.yaml, line {place + 1}: trainer\.epochs is 'many'; need a whole"):
        read_params(tmp_path / "params.yaml")


def test_params_are_what_is_composed():
    assert read_params(ROOT / "params.yaml") == configure()


def test_the_command_line_prints_that_line_alone():
    command = [sys.executable, "-m", "pipeline.report", "trainer.epoch=3"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.startswith("error: trainer: unknown key 'epoch'")
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
    assert configure().terrain == TerrainSettings()


def test_the_configured_label_rule_is_that_of_the_published_labels():
    configured = configure().labelling.settings
    fitted = ("heading_window", "turn_cost_factor")
    assert [getattr(configured, name) for name in fitted] == [getattr(LabelSettings(), name) for name in fitted]


def test_the_configured_arena_is_the_default_of_the_library():
    assert configure(["arena=small"]).arena.contents == ArenaSettings()


@pytest.mark.parametrize("profile", sorted(path.stem for path in (CONF / "profile").glob("*.yaml")))
def test_what_a_profile_trains_on_has_a_stage(profile):
    config = compose([f"profile={profile}"])
    made = {*config.labelling.used, *config.simulation.used}
    assert {*config.trainer.splits, *config.trainer.val_splits} <= made
    assert set(config.labelling.used) <= set(config.labelling.splits)
    assert set(config.simulation.used) <= set(config.simulation.splits)


@pytest.mark.parametrize(
    ("word", "says"),
    [
        (
            "labelling.splits.val.categories=[wall_1,kerb,wall_1]",
            r"categories\[2\] is 'wall_1'; need each value once",
        ),
        ("evaluation.methods=[manual,manual]", r"evaluation\.methods\[1\] is 'manual'; need each value once"),
        ("planner.weights=[1.0,2.0,1.0]", r"planner\.weights\[2\] is 1\.0; need each value once"),
    ],
)
def test_values_that_are_there_twice_are_named(word, says):
    with pytest.raises(InputError, match=says):
        configure([f"++{word}"])
