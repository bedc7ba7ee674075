"""Dense evaluation of whole maps."""

import numpy as np
import pytest
import torch

from benchmarks.edges import random_abstraction, rough_map
from hdsp.abstract import LocalCosts
from hdsp.base.errors import InputError
from hdsp.learning import HardwareSettings, LearnedCosts
from hdsp.learning.rotated_maps import RotatedMap
from hdsp.learning.torch_evaluation import WINDOWS
from hdsp.robot.lattice import abstract_anchor
from hdsp.terrain.patches import crop_patches


def abstraction(**settings):
    return random_abstraction(HardwareSettings("cpu", "32"), **settings)


@pytest.fixture(scope="module")
def dense_network():
    return abstraction(architecture="klamt2019", options={"padded": False})


@pytest.fixture(scope="module")
def padded_network():
    return abstraction(architecture="klamt2019")


@pytest.fixture(scope="module")
def terrain():
    return rough_map((110, 78), seed=0)  # several tiles at all headings, and remaining cells at the upper borders


@pytest.fixture(scope="module")
def edges(dense_network, terrain):
    return LearnedCosts(dense_network).edges(terrain)


def test_the_answers_are_those_of_each_patch(dense_network, terrain, edges):
    mask = np.random.default_rng(1).random(edges.shape[:3]) < 0.1
    expected = LearnedCosts(dense_network, method="patches").edges(terrain, mask=mask)[mask]
    assert 0.1 < np.isfinite(expected).mean() < 0.9
    np.testing.assert_allclose(edges[mask], expected, atol=1e-4)
    assert np.std(expected[np.isfinite(expected)]) > 0.01


def test_maps_smaller_than_a_patch(dense_network):
    small = rough_map((21, 13), seed=0)
    expected = LearnedCosts(dense_network, method="patches").edges(small)
    np.testing.assert_allclose(LearnedCosts(dense_network).edges(small), expected, atol=1e-4)


def test_a_region_is_the_whole_to_the_last_bit(dense_network, terrain, edges):
    region = (3, 5, 20, 11)
    mask = np.random.default_rng(2).random((16, 17, 6)) < 0.5
    part = LearnedCosts(dense_network).edges(terrain, region, mask)
    np.testing.assert_array_equal(part[mask], edges[:, 3:20, 5:11][mask])
    assert np.isinf(part[~mask]).all()


def test_q4_a_step_evaluates_the_trunk_on_one_tile_or_one_group_of_windows(dense_network):
    done = [0]
    small = rough_map((42, 42), seed=0)
    mask = np.zeros((16, 10, 10), bool)
    mask[1] = True
    steps = LearnedCosts(dense_network).edge_steps(small, mask=mask, progress=lambda states, _: done.append(states))
    pauses = sum(1 for _ in steps)
    assert done[-1] == 100 and max(np.diff(done)) <= WINDOWS
    assert pauses > len(done) - 1  # the trunk has steps of its own


def test_a_padded_network_is_evaluated_exactly_unless_asked_otherwise(padded_network, terrain):
    region = (8, 6, 12, 10)
    exact = LearnedCosts(padded_network).edges(terrain, region)
    np.testing.assert_array_equal(exact, LearnedCosts(padded_network, method="patches").edges(terrain, region))
    approximate = LearnedCosts(padded_network, method="dense").edges(terrain, region)
    both = np.isfinite(exact) & np.isfinite(approximate)
    assert not np.array_equal(exact, approximate)
    assert both.mean() > 0.05
    assert np.median(abs(exact[both] - approximate[both])) < 0.3 * np.median(exact[both])


def test_dense_evaluation_of_a_padded_trunk_is_that_of_a_wider_one(padded_network):
    """Features agree away from the patch's rim; the others differ because of the padding with zeros."""
    network = padded_network.network
    trunk = network.dense_trunk()
    heights = torch.rand(1, 1, 80, 80, generator=torch.Generator().manual_seed(0))
    with torch.inference_mode():
        inside = trunk(heights)
        features = trunk.windows(inside, torch.tensor([[0, 0]])).view(40, 7, 7)
        patch = network.map_part(heights[:, :, 4:76, 4:76]).view(40, 7, 7)
    assert trunk.margin == 4
    assert not trunk.exact
    assert features.shape == patch.shape
    np.testing.assert_allclose(features[:, 3, 3], patch[:, 3, 3], atol=1e-5)


@pytest.mark.parametrize("method", ["auto", "patches"])
@pytest.mark.parametrize("network", ["dense_network", "padded_network"])
def test_only_affected_states_change(network, method, request):
    costs = LearnedCosts(request.getfixturevalue(network), method=method)
    assert isinstance(costs, LocalCosts)
    before = rough_map((96, 80), seed=0)
    changed = np.zeros(before.shape, bool)
    changed[10:13, 70:74] = True
    affected = costs.affected(changed)
    # The patches themselves tell whether they contain a changed cell.
    states = np.argwhere(np.ones_like(affected))
    for k in range(16):
        bases = abstract_anchor(states[states[:, 0] == k][:, [1, 2, 0]])[:, :2]
        if network == "dense_network":
            patches = RotatedMap(changed.astype(np.float32), k).patches(bases)
        else:
            patches = crop_patches(changed.astype(np.float32), bases, 4 * k)
        np.testing.assert_array_equal(affected[k].ravel(), (patches > 0).any(axis=(1, 2)))
    assert not costs.affected(np.zeros(before.shape, bool)).any()


def test_a_network_that_cannot_be_evaluated_densely_says_so():
    with pytest.raises(InputError, match="method dense: swept"):
        LearnedCosts(abstraction(architecture="swept"), method="dense")
    with pytest.raises(InputError, match="'sparse'"):
        LearnedCosts(abstraction(architecture="klamt2019"), method="sparse")


@pytest.mark.parametrize("heading", range(16))
def test_patches_of_a_rotated_map(heading):
    """At quarter turns they equal the patches cut at the base; otherwise the base is off by at most half a cell."""
    terrain = rough_map((90, 100), seed=0)
    bases = np.array([(46, 50), (2, 2), (86, 98), (40, 10)])
    rotated = RotatedMap(terrain.heights, heading)
    patches, cut = rotated.patches(bases), crop_patches(terrain.heights, bases, 4 * heading)
    if heading % 4 == 0:
        np.testing.assert_array_equal(patches, cut)
    x = RotatedMap(np.add.outer(np.arange(90.0), np.zeros(100)), heading).patches(bases)[:, 36, 36]
    y = RotatedMap(np.add.outer(np.zeros(90), np.arange(100.0)), heading).patches(bases)[:, 36, 36]
    moved = np.column_stack([x, y]) - bases
    assert np.nanmax(abs(moved)) <= 1


@pytest.mark.nightly
def test_the_benchmark_counts_and_compares(capsys):
    from benchmarks import edges

    result = edges.main(["--size", "1.5", "--sample", "0.02", "--threads", "1"])
    assert result["update_identical"]
    assert result["largest_difference"] < 1e-4
    assert result["differently_feasible"] < 1e-3
    assert 0 < result["affected_states"] <= 1
    assert capsys.readouterr().out.count("\n") == 1
