"""Costs-to-go of cut-off states equal their twin in plain Python."""

import numpy as np
import pytest

from hdsp.abstract.cut_off import reconnect
from hdsp.robot.lattice import ABSTRACT_HEADINGS, N_ABSTRACT_ACTIONS
from tests.naive_abstract import reconnected

SHAPE = ABSTRACT_HEADINGS, 5, 4


@pytest.mark.parametrize(("known", "most"), [(0.02, 1.0), (0.3, 3.0), (0.3, 5000.0), (0.0, 1.0)])
@pytest.mark.parametrize("seed", range(3))
def test_costs_equal_their_twin(seed, known, most):
    random = np.random.default_rng(seed)
    prices = random.uniform(0.05, 0.9, (ABSTRACT_HEADINGS, N_ABSTRACT_ACTIONS))
    prices[random.random(prices.shape) < 0.3] = np.inf
    states = random.random(SHAPE) < 0.7
    costs = np.where(random.random(SHAPE) < known, random.uniform(0.0, most, SHAPE), np.inf)
    before = {(x, y, k): float(costs[k, x, y]) for k, x, y in np.argwhere(np.isfinite(costs)).tolist()}
    after = reconnected(before, {(x, y, k) for k, x, y in np.argwhere(states).tolist()}, prices)
    expected = np.full(SHAPE, np.inf)
    for (x, y, k), cost in after.items():
        expected[k, x, y] = cost
    reconnect(costs, states, prices)
    np.testing.assert_array_equal(costs, expected)
    assert known == 0 or len(after) > len(before)


def test_nothing_is_reached_without_prices():
    costs = np.full(SHAPE, np.inf)
    costs[0, 0, 0] = 1.0
    expected = costs.copy()
    reconnect(costs, np.ones(SHAPE, bool), np.full((ABSTRACT_HEADINGS, N_ABSTRACT_ACTIONS), np.inf))
    np.testing.assert_array_equal(costs, expected)
