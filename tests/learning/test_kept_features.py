"""Features kept between evaluations change no cost."""

import numpy as np

import hdsp
from hdsp.base.gradual import finished
from hdsp.learning import LearnedCosts
from hdsp.learning.inference import kept_features
from hdsp.robot.lattice import ABSTRACT_HEADINGS, abstract_shape
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import random_map

TERRAIN = random_map(1200, "cuboid_2", 5, cells=100)


def masks():
    """Few states, and more states around them."""
    random, more = np.random.default_rng(0), np.zeros((ABSTRACT_HEADINGS, *abstract_shape(TERRAIN.shape)), bool)
    more[::3, 8:18, 9:14] = True
    return more & (random.random(more.shape) < 0.2), more


def test_costs_with_kept_features_are_those_without():
    costs = LearnedCosts(hdsp.load_abstraction("momaro"))
    few, more = masks()
    memory = costs.new_memory(TERRAIN)
    before = costs.edges(TERRAIN, mask=more)
    np.testing.assert_array_equal(finished(costs.edge_steps(TERRAIN, mask=few, memory=memory))[few], before[few])
    np.testing.assert_array_equal(finished(costs.edge_steps(TERRAIN, mask=more, memory=memory)), before)
    used = list(memory._used)
    finished(costs.edge_steps(TERRAIN, mask=more, memory=memory))
    assert memory._used == used and min(used) > 0

    heights = TERRAIN.heights.copy()
    heights[40:46, 45:50] += 0.1
    after = HeightMap(heights)
    changed = heights != TERRAIN.heights
    part = more & costs.affected(changed)
    moved = memory.after(changed)
    expected = costs.edges(after, mask=part)
    np.testing.assert_array_equal(finished(costs.edge_steps(after, mask=part, memory=moved)), expected)
    assert (expected[part] != before[part]).any()
    assert 0 < sum(moved._used) - sum(used) < 0.6 * sum(used)


def test_hardly_more_states_are_affected_than_a_change_reaches():
    costs = LearnedCosts(hdsp.load_abstraction("momaro"))
    heights = np.random.default_rng(0).normal(0.0, 0.001, TERRAIN.shape).astype(np.float32)
    mask = np.zeros((ABSTRACT_HEADINGS, *abstract_shape(TERRAIN.shape)), bool)
    mask[[0, 1, 6, 11]] = True
    before = costs.edges(HeightMap(heights), mask=mask)
    changed = np.zeros(heights.shape, bool)
    changed[48:52, 45:50] = True
    reached = (costs.edges(HeightMap(heights + 0.05 * changed), mask=mask) != before).any(axis=-1)
    affected = costs.affected(changed)
    assert not (reached & ~affected).any()
    judged = affected & np.isfinite(before).any(axis=-1)
    assert reached.sum() > 0.9 * judged.sum() > 100


def test_features_beyond_the_budget_are_dropped(monkeypatch):
    monkeypatch.setattr(kept_features, "MOST_BYTES", 1 << 16)
    costs = LearnedCosts(hdsp.load_abstraction("momaro"))
    few, more = masks()
    memory = costs.new_memory(TERRAIN)
    for mask in (few, more):
        found = finished(costs.edge_steps(TERRAIN, mask=mask, memory=memory))
        np.testing.assert_array_equal(found, costs.edges(TERRAIN, mask=mask))
