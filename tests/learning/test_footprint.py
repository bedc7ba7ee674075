"""The network that evaluates footprints."""

import math

import numpy as np
import pytest
import torch

from hdsp.base.errors import InputError
from hdsp.base.settings import load_settings
from hdsp.learning import HardwareSettings, LearnedAbstraction, LearnedCosts, Provenance
from hdsp.learning.encoding import encode
from hdsp.learning.footprint_geometry import FEET, POSES, REQUIREMENT_FEATURES
from hdsp.learning.networks import ModelSettings, build_network
from hdsp.learning.task_data import mirror_goals, mirror_heights
from hdsp.terrain.height_map import HeightMap
from tests.learning.test_zoo import model_file, rough_patches

GOALS = torch.tensor([[1.0, 0, 0], [2, -1, 0], [-2, 1, 0], [0, 0, 1], [0, 0, -1], [0.92, 0.38, 0]])


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(0)
    network = build_network(model_file("footprint")).eval()
    with torch.no_grad():
        network.heads.weight.mul_(10)
        _, logits, *_ = network(torch.from_numpy(rough_patches(4))[:, None], GOALS.expand(4, -1, -1))
        network.heads.bias[1] -= logits.median()
    return network


@pytest.fixture
def patches():
    heights = torch.from_numpy(rough_patches(4))[:, None]
    heights[0, 0, 40:44, 50:60] = math.nan
    heights[1, 0, 36, 36] = math.nan
    return heights


def judged(network, heights, goals=GOALS):
    with torch.no_grad():
        return torch.stack(network(heights, goals.expand(len(heights), -1, -1)))


def test_only_differences_of_heights_count(network, patches):
    torch.testing.assert_close(judged(network, patches + 2.5), judged(network, patches), atol=1e-4, rtol=0)


def test_the_rim_of_a_patch_has_no_part_in_it(network, patches):
    changed = patches.clone()
    changed[..., 0, :], changed[..., :, -1] = 7.0, math.nan
    assert (judged(network, changed) == judged(network, patches)).all()


def test_a_turn_to_the_other_side_is_the_mirrored_turn_of_a_mirrored_network(network, patches):
    """Rotated footprints equal the opposite ones on the mirrored map with mirrored taps.

    The test uses a network with weights that are symmetric in y.
    """
    symmetric = build_network(model_file("footprint")).eval()
    symmetric.load_state_dict(network.state_dict())
    with torch.no_grad():
        layers = [*symmetric.near, *symmetric.local, symmetric.of_local]
        for kernel in (layer.weight for layer in layers if hasattr(layer, "weight")):
            kernel.copy_((kernel + kernel.flip(-1)) / 2)
        # Mirroring changes the sign of channel slope_y.
        names = [symmetric.encoding.channels[i] for i in symmetric.trunk_channels]
        symmetric.near[0].weight[:, names.index("slope_y")] = 0
        of_taps, of_feet = symmetric.of_ground.weight.split([189, REQUIREMENT_FEATURES], dim=1)
        taps = of_taps.view(-1, *symmetric.options.taps, symmetric.ground_channels)
        taps.copy_((taps + taps.flip(2)) / 2)
        for feet in of_feet.split(len(FEET), dim=1)[:2]:
            feet.copy_((feet + feet[:, [3, 2, 1, 0]]) / 2)
    mirrored = mirror_heights(patches)
    goals = torch.tensor([[0.0, 0, 1]])
    features = [symmetric.map_part(encode(symmetric.encoding, h)) for h in (patches, mirrored)]
    width = symmetric.pose_features
    left, right = (slice((POSES**2 + n) * width, (POSES**2 + n + 4) * width) for n in (0, 4))
    torch.testing.assert_close(features[0][:, left], features[1][:, right], atol=2e-3, rtol=0)
    assert (mirror_goals(goals) == torch.tensor([[0.0, 0, -1]])).all()


def test_whole_maps_in_bfloat16(network):
    heights = rough_patches(1)[0]
    terrain = HeightMap(np.tile(heights, (2, 2)))
    region, mask = (8, 8, 12, 12), np.zeros((16, 4, 4), bool)
    mask[[0, 3]] = True

    def edges(precision):
        settings = load_settings(ModelSettings, model_file("footprint"), "model")
        hardware = HardwareSettings(accelerator="cpu", precision=precision)
        return LearnedCosts(LearnedAbstraction(network, settings, Provenance(), {}, hardware)).edges(
            terrain, region, mask
        )

    exact, rough = edges("32"), edges("bf16")
    both = np.isfinite(exact) & np.isfinite(rough)
    assert both.any()
    np.testing.assert_allclose(rough[both], exact[both], rtol=0.1, atol=0.05)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"options": {"dilations": [8]}}, "dilations"),
        ({"options": {"taps": [8, 7]}}, "taps"),
        ({"options": {"spacing": 4}}, "taps"),
        ({"encoding": {"channels": ["edge"]}}, "lacks height"),
    ],
)
def test_wrong_options_are_named(change, message):
    with pytest.raises(InputError, match=message):
        build_network({"architecture": "footprint", **change})
