"""Saved abstractions: loading restores them exactly, and unsuitable files are refused."""

import json
import math

import numpy as np
import pytest
import torch

from hdsp.abstract.flat_table import flat_table
from hdsp.base.errors import InputError
from hdsp.base.settings import load_settings
from hdsp.learning import HardwareSettings, LearnedAbstraction, ModelSettings, Provenance, build_network
from hdsp.learning.learned_costs import LearnedCosts
from hdsp.learning.metrics import MINIMUM_COST
from hdsp.robot.lattice import robot_frame_goals
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from tests.learning.synthetic import TINY_MODEL, synthetic_tasks

EXACT = HardwareSettings(accelerator="cpu", precision="32")


@pytest.fixture
def abstraction():
    torch.manual_seed(0)
    model = load_settings(ModelSettings, TINY_MODEL, "model")
    provenance = Provenance.of(Robot.load("momaro"), "0123", maps=3)
    return LearnedAbstraction(build_network(model), model, provenance, {"cost_error/val": 0.1}, EXACT)


@pytest.fixture
def saved(abstraction, tmp_path):
    return abstraction.save_pretrained(tmp_path / "model", picture=False)


def edit(folder, change):
    path = folder / "config.json"
    config = json.loads(path.read_text())
    change(config)
    config["config_sha256"] = ""
    path.write_text(json.dumps(config))


def test_a_round_trip_changes_no_prediction(abstraction, saved):
    tasks = synthetic_tasks(5)
    read = LearnedAbstraction.from_pretrained(saved, hardware=EXACT)
    for ours, theirs in zip(
        abstraction.predict(tasks.heights, tasks.goals), read.predict(tasks.heights, tasks.goals), strict=True
    ):
        assert np.array_equal(ours, theirs)
    assert (read.model.to_dict(), read.provenance, read.metrics) == (
        abstraction.model.to_dict(), abstraction.provenance, abstraction.metrics,
    )  # fmt: skip


def test_actions_that_are_infeasible_on_flat_ground_are_never_judged_feasible(abstraction, tmp_path):
    momaro = Robot.load("momaro").to_dict()
    factors = {**momaro["drive"]["deviation_cost"], "side": math.inf, "behind": math.inf}
    robot = Robot.load({**momaro, "drive": {**momaro["drive"], "deviation_cost": factors}})
    with torch.no_grad():
        abstraction.network.heads.bias.copy_(torch.tensor([0.4, 9.0]))  # otherwise all are feasible
    ahead_only = LearnedAbstraction(abstraction.network, abstraction.model, Provenance.of(robot), hardware=EXACT)
    read = LearnedAbstraction.from_pretrained(
        ahead_only.save_pretrained(tmp_path / "ahead", picture=False), robot, EXACT
    )
    tasks, flat = synthetic_tasks(30), flat_table(robot)
    tasks.goals[:], never = robot_frame_goals(0), np.isinf(flat[0])
    assert read.predict(tasks.heights, tasks.goals)[0].tolist() == [(~never).tolist()] * 30
    terrain = HeightMap.flat((20, 16))
    known = np.isfinite(LearnedCosts(abstraction).edges(terrain))
    edges = LearnedCosts(read).edges(terrain)
    assert (np.isfinite(edges) == (known & np.isfinite(flat)[:, None, None])).all() and known.any()
    tasks.feasible[:, never], tasks.cost[:, never] = False, 0
    figures = read.calibrated(tasks).calibration_figures(tasks)
    assert np.isfinite([figures["ece"], figures["brier"], read.calibrated(tasks).calibration.temperature]).all()


def test_predictions_do_not_depend_on_the_batch(abstraction):
    tasks = synthetic_tasks(7)
    probability, cost = abstraction.predict_probability(tasks.heights, tasks.goals, batch=7)
    again, cost_again = abstraction.predict_probability(tasks.heights, tasks.goals, batch=2)
    np.testing.assert_allclose(again, probability, atol=1e-5)
    np.testing.assert_allclose(cost_again, cost, atol=1e-5)
    assert (cost >= MINIMUM_COST).all()


def test_goals_may_be_shared_by_all_patches(abstraction):
    tasks = synthetic_tasks(3)
    _, shared = abstraction.predict(tasks.heights, tasks.goals[0])
    _, each = abstraction.predict(tasks.heights, np.stack([tasks.goals[0]] * 3))
    assert np.array_equal(shared, each)


def test_no_patches_give_no_tasks(abstraction):
    feasible, cost = abstraction.predict(np.zeros((0, 72, 72), np.float32), np.zeros((0, 22, 3), np.float32))
    assert feasible.shape == cost.shape == (0, 22)


def test_unknown_cells_give_finite_predictions(abstraction):
    probability, cost = abstraction.predict_probability(np.full((2, 72, 72), np.nan), synthetic_tasks(2).goals)
    assert np.isfinite(probability).all()
    assert np.isfinite(cost).all()


def test_saving_again_replaces_the_whole_folder(abstraction, saved):
    abstraction.metrics["cost_error/val"] = 0.05
    abstraction.save_pretrained(saved, picture=False)
    assert LearnedAbstraction.from_pretrained(saved).metrics == {"cost_error/val": 0.05}
    assert [path.name for path in saved.parent.iterdir()] == ["model"]


def test_other_files_beside_an_abstraction_are_not_lost(abstraction, saved):
    (saved / "README.md").write_text("older")
    abstraction.save_pretrained(saved, picture=False)
    (saved / ".git").mkdir()
    (saved / "notes.txt").touch()
    with pytest.raises(InputError, match=r"other files than a pretrained abstraction \(\['.git', 'notes.txt'\]\)"):
        abstraction.save_pretrained(saved, picture=False)
    assert (saved / "notes.txt").exists()


def test_a_folder_with_other_files_is_not_replaced(abstraction, tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="not replaced"):
        abstraction.save_pretrained(tmp_path, picture=False)
    for place, reason in (("thesis.tex", "Not a directory"), ("x" * 300, "File name too long")):
        with pytest.raises(InputError, match=f"cannot write .*: {reason}"):
            abstraction.save_pretrained(tmp_path / place, picture=False)
    assert (tmp_path / "thesis.tex").exists()


@pytest.mark.parametrize(
    ("key", "value"),
    [("resolution", 0.05), ("patch_cells", 64), ("abstract_headings", 8), ("abstract_actions", [[1, 0, 0]])],
)
def test_another_lattice_is_refused(saved, key, value):
    edit(saved, lambda config: config["lattice"].update({key: value}))
    with pytest.raises(InputError, match=f"lattice.{key}"):
        LearnedAbstraction.from_pretrained(saved)


def test_another_cost_model_is_refused(saved):
    edit(saved, lambda config: config["provenance"].update(cost_model_version=-1))
    with pytest.raises(InputError, match="cost_model_version is -1"):
        LearnedAbstraction.from_pretrained(saved)


def test_another_robot_is_refused(saved):
    robot = Robot.load("momaro")
    LearnedAbstraction.from_pretrained(saved, robot)
    changed = robot.to_dict()
    changed["feet"]["neutral_x"] += 0.025
    with pytest.raises(InputError, match="trained for another robot"):
        LearnedAbstraction.from_pretrained(saved, Robot.load(changed))


def test_damage_is_noticed(saved):
    weights = saved / "model.safetensors"
    whole = weights.read_bytes()
    for damaged in (whole[:-10], whole[:500] + bytes([whole[500] ^ 1]) + whole[501:], b""):
        weights.write_bytes(damaged)
        with pytest.raises(InputError, match=r"model\.safetensors: damaged"):
            LearnedAbstraction.from_pretrained(saved)
    weights.unlink()
    with pytest.raises(InputError, match=r"model\.safetensors: no such file"):
        LearnedAbstraction.from_pretrained(saved)


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"format_version": 1'])
def test_a_damaged_configuration_is_noticed(saved, text):
    (saved / "config.json").write_text(text)
    with pytest.raises(InputError, match=r"config\.json"):
        LearnedAbstraction.from_pretrained(saved)


def test_weights_of_another_architecture_are_refused(saved):
    edit(saved, lambda config: config["model"]["options"].update(hidden=64))
    with pytest.raises(InputError, match="does not fit compact"):
        LearnedAbstraction.from_pretrained(saved)


@pytest.mark.parametrize(
    ("patches", "goals"), [((2, 64, 72), (2, 22, 3)), ((2, 72, 72), (3, 22, 3)), ((2, 72, 72), (2, 22, 2))]
)
def test_wrong_shapes_are_named(abstraction, patches, goals):
    with pytest.raises(InputError, match="shape"):
        abstraction.predict(np.zeros(patches), np.zeros(goals))
