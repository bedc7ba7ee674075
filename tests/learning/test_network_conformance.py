"""The checker of networks: all models of conf/model pass, and a broken network is caught for each rule."""

import copy

import numpy as np
import pytest
import torch
from torch import nn

from hdsp.base.conformance import ConformanceError
from hdsp.base.errors import InputError
from hdsp.learning import HeightEncoding, check_network
from hdsp.learning.network_conformance import RULES
from hdsp.learning.networks.base import MapGoalLinear, TaskNetwork
from hdsp.learning.networks.dense import DenseTrunk
from tests.learning.test_zoo import MODELS, abstraction


@pytest.mark.parametrize("name", MODELS)
def test_all_models_keep_the_contract(name):
    network = abstraction(name).network
    before = copy.deepcopy(network.state_dict())
    checked = check_network(network)
    assert set(checked) == set(RULES) - (set() if network.is_dense() else {"dense"})
    assert not network.training
    assert all(torch.equal(value, before[key]) for key, value in network.state_dict().items())


class Small(TaskNetwork):
    """Two convolutions and a hidden layer: a network that fulfils the contract, for tests to break."""

    def __init__(self, encoding=None):
        super().__init__(encoding or HeightEncoding())
        channels = len(self.encoding.channels)
        self.trunk = nn.Sequential(nn.Conv2d(channels, 2, 5), nn.MaxPool2d(4), nn.Conv2d(2, 3, 3), nn.Flatten())
        self.hidden = MapGoalLinear(3 * 15 * 15, 3, 16)
        self.heads = nn.Linear(16, 2)

    def dense_trunk(self):
        return DenseTrunk(self.trunk)

    def map_part(self, encoded):
        return self.trunk(encoded)

    def goal_part(self, features, goals):
        cost, logits = self.heads(torch.relu(self.hidden(features, goals))).unbind(-1)
        return cost, logits


class NoHeads(Small):
    def __init__(self):
        super().__init__()
        self.last, self.heads = self.heads, None


class OneOutput(Small):
    def goal_part(self, features, goals):
        return torch.stack(super().goal_part(features, goals))


class AlwaysTwentyTwo(Small):
    def goal_part(self, features, goals):
        cost, logits = super().goal_part(features, goals)
        return cost.repeat(1, 2)[:, :22], logits.repeat(1, 2)[:, :22] if goals.shape[1] > 1 else logits.repeat(1, 22)


class LogarithmOfHeights(Small):
    def map_part(self, encoded):
        return super().map_part(encoded.log())


class OwnForward(Small):
    def forward(self, heights, goals):
        cost, logits = super().forward(heights, goals)
        return cost.exp(), logits


class UnflattenedTrunk(Small):
    def map_part(self, encoded):
        return super().map_part(encoded).unflatten(1, (3, -1))

    def goal_part(self, features, goals):
        return super().goal_part(features.flatten(1), goals)


class DropsOut(Small):
    def goal_part(self, features, goals):
        return super().goal_part(nn.functional.dropout(features, 0.1), goals)


class FillsHoles(Small):
    def forward(self, heights, goals):
        return super().forward(heights.nan_to_num_(nan=1.5), goals)


class RanksGoals(Small):
    def goal_part(self, features, goals):
        cost, logits = super().goal_part(features, goals)
        return cost - cost.mean(dim=1, keepdim=True), logits


class NormalisesBatches(Small):
    def map_part(self, encoded):
        return super().map_part(encoded - encoded.mean())


class PaddedButDense(Small):
    def __init__(self):
        super().__init__()
        self.trunk[0] = nn.Conv2d(1, 2, 5, padding=2)
        self.trunk[2] = nn.Conv2d(2, 3, 4)

    def is_dense(self):
        return True


class HidesATensor(Small):
    def __init__(self):
        super().__init__()
        self.scales = [torch.ones(2)]


class ForgetsABuffer(Small):
    def __init__(self):
        super().__init__()
        self.register_buffer("seen", torch.zeros(1))

    def state_dict(self, *arguments, **options):
        return {key: value * 0.5 for key, value in super().state_dict(*arguments, **options).items()}


class UnusedLayer(Small):
    def __init__(self):
        super().__init__()
        self.extra = nn.Linear(3, 3)


@pytest.mark.parametrize(
    ("broken", "rule"),
    [
        (NoHeads, "parts"),
        (OneOutput, "outputs"),
        (AlwaysTwentyTwo, "outputs"),
        (LogarithmOfHeights, "finite"),
        (OwnForward, "trunk"),
        (UnflattenedTrunk, "trunk"),
        (DropsOut, "determinism"),
        (FillsHoles, "input"),
        (RanksGoals, "goals apart"),
        (NormalisesBatches, "patches apart"),
        (PaddedButDense, "dense"),
        (HidesATensor, "saved"),
        (ForgetsABuffer, "saved"),
        (UnusedLayer, "gradients"),
    ],
)
def test_a_broken_rule_is_named(broken, rule):
    torch.manual_seed(0)
    with pytest.raises(ConformanceError) as error:
        check_network(broken())
    assert error.value.rule == rule
    assert RULES[rule] in str(error.value)
    assert "\n" not in str(error.value)


def test_the_unbroken_network_passes_with_own_inputs():
    torch.manual_seed(0)
    heights = np.random.default_rng(0).uniform(0, 0.4, (2, 72, 72)).astype(np.float32)
    assert set(check_network(Small(), heights, np.array([[1, 0, 0], [0.5, 2, 1]]))) == set(RULES)
    with pytest.raises(InputError, match=r"heights: shape \(1, 72, 72\)"):
        check_network(Small(), heights[:1])
    with pytest.raises(InputError, match=r"goals: shape \(2, 2\)"):
        check_network(Small(), goals=np.zeros((2, 2)))
