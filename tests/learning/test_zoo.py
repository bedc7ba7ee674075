"""All models in conf/model, and properties of single architectures."""

import numpy as np
import pytest
import torch

from hdsp.base.errors import InputError
from hdsp.base.settings import load_settings
from hdsp.learning import HardwareSettings, LearnedAbstraction, LearnedCosts, ModelSettings
from hdsp.learning.networks import ARCHITECTURES, build_network
from hdsp.learning.networks.dense import DenseTrunk
from hdsp.learning.task_data import mirror_goals
from hdsp.robot.lattice import robot_frame_goals
from hdsp.terrain.height_map import HeightMap
from pipeline.config import compose, plain
from tests import ROOT

MODELS = sorted(path.stem for path in (ROOT / "conf/model").glob("*.yaml"))
EXACT = HardwareSettings("cpu", "32", 1)


def abstraction(name: str, **options) -> LearnedAbstraction:
    """A model from conf/model with random weights; its costs and predictions vary like a trained model's."""
    torch.manual_seed(0)
    settings = model_file(name)
    model = load_settings(ModelSettings, settings | {"options": settings["options"] | options}, "model")
    network = build_network(model).eval()
    half = len(network.heads.bias) // 2  # the first half are costs, the second half logits
    with torch.no_grad():
        network.heads.weight *= 20
        network.heads.bias[:half] += 0.5
        goals = torch.from_numpy(robot_frame_goals(2)).expand(2, -1, -1)
        _, logits, *_ = network(torch.from_numpy(rough_patches(2))[:, None], goals)
        network.heads.bias[half:] -= logits.median()
    return LearnedAbstraction(network, model, hardware=EXACT)


def model_file(name: str) -> dict:
    return plain(compose([f"model={name}"]).model)


DENSE = [name for name in MODELS if build_network(model_file(name)).is_dense()]


@pytest.mark.parametrize("name", MODELS)
def test_averaging_of_weights_leaves_constants_as_they_are(name):
    network = build_network(model_file(name))
    averaged = torch.optim.swa_utils.AveragedModel(
        network, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(0.9), use_buffers=True
    )
    for _ in range(3):
        averaged.update_parameters(network)
    for (key, kept), constant in zip(averaged.module.named_buffers(), network.buffers(), strict=True):
        assert torch.equal(kept, constant), key


def rough_patches(count: int) -> np.ndarray:
    random = np.random.default_rng(0)
    patches = random.uniform(0, 0.3, (count, 72, 72)).astype(np.float32)
    patches[random.random(patches.shape) < 0.01] = np.nan
    return patches


def test_each_architecture_has_a_model_of_its_name():
    assert set(ARCHITECTURES) <= set(MODELS)
    assert {model_file(name)["architecture"] for name in MODELS} == set(ARCHITECTURES)


@pytest.mark.parametrize("name", MODELS)
def test_a_model_answers_and_comes_back_from_disk(name, tmp_path):
    ours = abstraction(name)
    patches, goals = rough_patches(3), robot_frame_goals(2)
    probability, cost = ours.predict_probability(patches, goals)
    assert probability.shape == cost.shape == (3, 22)
    assert np.isfinite(probability).all() and np.isfinite(cost).all()
    assert len(np.unique(probability)) > 22  # they depend on the goal and on the patch
    read = LearnedAbstraction.from_pretrained(ours.save_pretrained(tmp_path / "model", picture=False), hardware=EXACT)
    rounding = 0 if read.engine is None else 1e-5  # evaluated without torch
    for found, expected in zip(read.predict_probability(patches, goals), (probability, cost), strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=rounding)


@pytest.mark.parametrize("name", MODELS)
def test_a_step_against_the_gradient_lessens_the_loss(name):
    network = abstraction(name).network.train()
    heights = torch.from_numpy(rough_patches(2))[:, None]
    goals = torch.from_numpy(robot_frame_goals(1)).expand(2, -1, -1)

    def loss():
        cost, logits, *_ = network(heights, goals)
        return (cost - 0.3).square().mean() + (logits + 1).square().mean()

    before = loss()
    before.backward()
    with torch.no_grad():
        squared = sum(parameter.grad.square().sum() for parameter in network.parameters())
        for parameter in network.parameters():
            parameter -= 1e-3 * before.detach() / squared * parameter.grad
        assert loss() < before


@pytest.mark.parametrize("name", MODELS)
def test_gradients_are_finite_in_bfloat16(name):
    network = abstraction(name).network.train().to(memory_format=torch.channels_last)
    heights = torch.from_numpy(rough_patches(8))[:, None]
    with torch.autocast("cpu", torch.bfloat16):
        cost, logits, *_ = network(heights, torch.from_numpy(robot_frame_goals(1)).expand(8, -1, -1))
    (cost.sum() + logits.sum()).backward()
    assert all(parameter.grad.isfinite().all() for parameter in network.parameters())


def test_which_models_are_dense():
    assert {"klamt2019_dense", "dilated", "footprint", "table"} <= set(DENSE)
    assert not {"klamt2019", "compact"} & set(DENSE)  # they pad with zeros


@pytest.mark.parametrize("name", DENSE)
def test_dense_evaluation_gives_what_each_patch_gives(name):
    terrain = HeightMap(np.random.default_rng(1).uniform(0, 0.3, (60, 44)).astype(np.float32))
    mask = np.zeros((16, 15, 11), bool)
    mask[[0, 3, 6]] = np.random.default_rng(2).random((3, 15, 11)) < 0.2
    ours = abstraction(name)
    expected = LearnedCosts(ours, method="patches").edges(terrain, mask=mask)[mask]
    found = LearnedCosts(ours, method="dense").edges(terrain, mask=mask)[mask]
    assert 0 < np.isfinite(expected).mean() < 1
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_a_dilated_trunk_is_evaluated_densely_behind_a_pooling_too():
    torch.manual_seed(0)
    trunk = torch.nn.Sequential(torch.nn.MaxPool2d(2), torch.nn.Conv2d(1, 3, 3, dilation=4), torch.nn.Flatten())
    dense = DenseTrunk(trunk)
    heights = torch.rand(1, 1, 80, 77)
    corners = torch.tensor([(0, 0), (3, 5), (8, 1)])
    windows = dense.windows(dense(heights), corners)
    patches = torch.cat([heights[:, :, x : x + 72, y : y + 72] for x, y in corners.tolist()])
    torch.testing.assert_close(windows, trunk(patches))


def test_the_table_knows_the_actions_at_every_heading_and_their_mirror_images():
    network = abstraction("table").network
    seen = set()
    for heading in range(16):
        goals = torch.from_numpy(robot_frame_goals(heading))[None]
        entries = network.entries(goals)
        torch.testing.assert_close(network.actions[entries], goals, atol=1e-5, rtol=0)
        network.entries(mirror_goals(goals))
        seen |= set(entries.flatten().tolist())
    assert seen == set(range(82))


def test_the_table_refuses_other_goals():
    with pytest.raises(InputError, match=r"goal \(1.5, 0, 0\): the architecture table knows the 22 abstract actions"):
        abstraction("table").predict(rough_patches(1), np.array([[1, 0, 0], [1.5, 0, 0]], np.float32))


def test_a_goal_map_shows_front_and_rear_feet_at_the_goal():
    network = abstraction("goalmap").network
    start, ahead, turned = network.paint(torch.tensor([[[0.0, 0, 0], [1, 0, 0], [0, 0, 4]]]))[0]
    torch.testing.assert_close(start.sum((1, 2)), torch.tensor([2.0, 2.0]))
    rows = torch.arange(36) + 0.5
    assert (start[0].sum(1) * rows).sum() / 2 * 2 == 36.5 + 13  # cells from the lower corner of the patch
    assert (start[1].sum(1) * rows).sum() / 2 * 2 == 36.5 - 13
    torch.testing.assert_close(ahead[:, 2:], start[:, :-2])  # one abstract step is four cells, two of these
    torch.testing.assert_close((turned[0].sum(0) * rows).sum(), torch.tensor(36.5 + 13))  # a quarter turn to the left


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (
            {"options": {"kernels": [3, 6, 14, 4]}},
            "model.options.kernels is [3, 6, 14, 4]; need odd numbers for the first two",
        ),
        ({"options": {"kernels": [3, 7, 45, 4]}}, "kernels is [3, 7, 45, 4]; need kernels that leave some of 72 cells"),
        (
            {"architecture": "dilated", "options": {"pool": 80}},
            "kernels that with dilations [1, 2, 4, 8] and pool 80 fit a patch of 72 cells",
        ),
        (
            {"architecture": "dilated", "options": {"widths": [8]}},
            "kernels is [5, 3, 3, 3]; need as many entries as widths, [8]",
        ),
    ],
)
def test_wrong_options_are_named(config, message):
    with pytest.raises(InputError) as error:
        build_network(config)
    assert message in str(error.value)
