"""Abstract costs for whole maps."""

from copy import copy

import numpy as np
import pytest
import torch

from hdsp.abstract.abstract_costs import AbstractCosts, TaskPredictor
from hdsp.abstract.flat_table import planning_factors
from hdsp.base.errors import InputError
from hdsp.base.settings import load_settings
from hdsp.learning import HardwareSettings, LearnedAbstraction, LearnedCosts, ModelSettings, Provenance, build_network
from hdsp.learning.learned_costs import distinct_patches
from hdsp.learning.rotated_maps import RotatedMap
from hdsp.robot.lattice import ABSTRACT_ACTIONS, robot_frame_goals
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from tests.learning.synthetic import TINY_MODEL
from tests.learning.test_zoo import abstraction as random_abstraction


@pytest.fixture(scope="module")
def costs():
    torch.manual_seed(2)
    model = load_settings(ModelSettings, TINY_MODEL, "model")
    network = build_network(model)
    # A random network with constant predictions would leave half the code untested.
    with torch.no_grad():
        network.heads.weight[1] *= 20
    return LearnedCosts(LearnedAbstraction(network, model, hardware=HardwareSettings("cpu", "32")), threshold=0.5)


@pytest.fixture(scope="module")
def terrain():
    heights = np.zeros((66, 53), np.float32)
    heights[20:30, 10:40] = 0.3
    heights[45:, 30:33] = 1.0
    heights[50, 5] = np.nan
    return HeightMap(heights)


@pytest.fixture(scope="module")
def edges(costs, terrain):
    return costs.edges(terrain)


def test_it_fulfils_both_contracts(costs):
    assert isinstance(costs, AbstractCosts)
    assert isinstance(costs, TaskPredictor)


def test_a_threshold_opens_actions_that_are_probably_infeasible(costs, terrain, tmp_path):
    network = costs.abstraction
    patches, goals = np.zeros((1, 72, 72), np.float32), robot_frame_goals(3)[None]
    probability, cost = network.predict_probability(patches, goals)
    for threshold in (0.1, 0.5, 0.9, float(np.median(probability))):
        feasible, as_before = network.at_threshold(threshold).predict(patches, goals)
        np.testing.assert_array_equal(feasible, probability > threshold)
        np.testing.assert_array_equal(as_before, cost)
    box = 2, 3, 5, 6
    opened = [np.isfinite(LearnedCosts(network, threshold=at).edges(terrain, box)) for at in (0.01, 0.5, 0.99)]
    assert (opened[0] >= opened[1]).all() and (opened[1] >= opened[2]).all() and opened[0].sum() > opened[2].sum()
    for kind in ("planning", "label"):
        found = LearnedCosts(network, kind=kind).edges(terrain, box)
        np.testing.assert_array_equal(found, LearnedCosts(network, kind=kind, threshold=0.5).edges(terrain, box))
    other = copy(network)
    other.edges_threshold = 0.01
    other.save_pretrained(tmp_path / "mine", picture=False)
    saved = LearnedAbstraction.from_pretrained(tmp_path / "mine", hardware=network.hardware)
    np.testing.assert_array_equal(np.isfinite(LearnedCosts(saved).edges(terrain, box)), opened[0])
    np.testing.assert_array_equal(saved.predict(patches, goals)[0], probability > 0.5)
    with pytest.raises(InputError, match=r"feasibility threshold 1: a probability between 0 and 1"):
        LearnedCosts(network, threshold=1)


def test_edges_for_planning_are_corrected_by_the_ratio_on_flat_ground(costs, terrain, edges):
    robot = Robot.load("momaro")
    factors = planning_factors(robot)
    assert factors.max() == 1 and 0.6 < factors.min() < 0.7
    box = slice(None), slice(2, 5), slice(3, 6)
    planned = LearnedCosts(costs.abstraction, robot=robot, threshold=0.5)
    np.testing.assert_allclose(planned.edges(terrain, (2, 3, 5, 6)), edges[box] * factors[:, None, None], rtol=1e-4)
    # The network names a preset, which must be the robot of its training.
    for robot_hash, kind, corrected in (
        (robot.hash(), "planning", True),
        (robot.hash(), "label", False),
        ("0", "planning", False),
    ):
        abstraction = copy(costs.abstraction)
        abstraction.provenance = Provenance(robot="momaro", robot_hash=robot_hash)
        found = LearnedCosts(abstraction, kind=kind).factors
        assert (found is factors) if corrected else (found is None)
    patches = np.zeros((1, 72, 72), np.float32)
    for one, other in zip(
        planned.predict(patches, robot_frame_goals(3)[None]),
        costs.predict(patches, robot_frame_goals(3)[None]),
        strict=True,
    ):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("method", ["auto", "patches"])
def test_edges_for_planning_come_from_a_network_that_predicts_them(method, terrain, tmp_path):
    in_torch = random_abstraction("footprint", planning=True)
    with torch.no_grad():
        in_torch.network.goal_cost[-1].bias += torch.tensor([2.0, 1.9])
    box = 2, 3, 4, 5
    for abstraction in (
        in_torch,
        LearnedAbstraction.from_pretrained(in_torch.save_pretrained(tmp_path / "model", picture=False)),
    ):
        label, planned = (
            LearnedCosts(abstraction, method=method, kind=kind, threshold=0.5, robot="momaro").edges(terrain, box)
            for kind in ("label", "planning")
        )
        finite = np.isfinite(label)
        assert (np.isfinite(planned) == finite).all() and finite.any()
        assert (planned[finite] <= label[finite]).all() and (planned[finite] < label[finite]).any()
        goals = robot_frame_goals(5)[None]
        (state,) = np.argwhere(finite[5].any(axis=-1))[:1] + box[:2]
        patch = RotatedMap(terrain.heights, 5).patches(4 * state[None] + 2)
        _, cost = abstraction.for_planning().predict(patch, goals)
        _, of_label = abstraction.predict(patch, goals)
        actions = finite[5][tuple(state - box[:2])]
        np.testing.assert_allclose(planned[5][tuple(state - box[:2])][actions], cost[0][actions], rtol=1e-2)
        assert (cost <= of_label).all()
    with pytest.raises(InputError, match="predicts label costs alone"):
        random_abstraction("compact").for_planning()


def test_each_edge_is_the_prediction_for_the_patch_of_its_state(costs, terrain, edges):
    assert edges.shape == (16, 16, 13, 22)
    assert edges.dtype == np.float32
    inside = np.isfinite(edges)
    assert 0.05 < inside.mean() < 0.95
    random = np.random.default_rng(0)
    for k, a, b, m in zip(*(random.integers(0, n, 300) for n in edges.shape), strict=True):
        patch = terrain.crop_cells(4 * a + 2, 4 * b + 2, 4 * k).heights
        feasible, cost = costs.predict(patch[None], robot_frame_goals(k)[None])
        to_x, to_y = a + ABSTRACT_ACTIONS[m, 0], b + ABSTRACT_ACTIONS[m, 1]
        if feasible[0, m] and 0 <= to_x < 16 and 0 <= to_y < 13:
            assert edges[k, a, b, m] == pytest.approx(cost[0, m], abs=1e-4)
        else:
            assert np.isinf(edges[k, a, b, m])


def test_no_action_leads_off_the_map(edges):
    for m, (dx, dy, _) in enumerate(ABSTRACT_ACTIONS):
        for a in (0, 15):
            for b in range(13):
                if not (0 <= a + dx < 16 and 0 <= b + dy < 13):
                    assert np.isinf(edges[:, a, b, m]).all()


def test_a_region_is_cut_out_of_the_whole(costs, terrain, edges):
    np.testing.assert_allclose(costs.edges(terrain, region=(2, 3, 9, 13)), edges[:, 2:9, 3:13], atol=1e-5)


def test_masked_states_are_infeasible_and_the_others_unchanged(costs, terrain, edges):
    mask = np.random.default_rng(1).random(edges.shape[:3]) < 0.3
    masked = costs.edges(terrain, mask=mask)
    assert np.isinf(masked[~mask]).all()
    np.testing.assert_allclose(masked[mask], edges[mask], atol=1e-5)


def test_progress_reaches_the_end(costs, terrain):
    calls = []
    costs.edges(terrain, progress=lambda done, total: calls.append((done, total)))
    assert calls[-1] == (16 * 16 * 13, 16 * 16 * 13)
    assert [done for done, _ in calls] == sorted(done for done, _ in calls)


def test_equal_patches_are_evaluated_once(costs):
    patches = np.random.default_rng(0).random((4, 72, 72)).astype(np.float32)[[0, 1, 0, 2, 1, 3]]
    patches[[0, 2], 5, 5] = np.nan
    first, which = distinct_patches(patches)
    assert first.tolist() == [0, 1, 3, 5]
    assert np.array_equal(patches[first][which], patches, equal_nan=True)


def test_a_wrong_mask_is_named(costs, terrain):
    with pytest.raises(InputError, match="mask: shape"):
        costs.edges(terrain, mask=np.ones((16, 4, 4), bool))
