"""Bounds on plan costs: rounding errors in the store, and proven suboptimality."""

import numpy as np

from hdsp.detailed.search.estimate import geometric_estimate
from hdsp.detailed.world.world import World

#: Least relative difference in cost by which one plan is better than another.
LEAST_GAIN = 1e-6


def rounding(world: World) -> float:
    """Returns r, where a path cost c in the store has a relative rounding error of at most r * c.

    The store adds costs in single precision, with an error of half a unit in the last place per action. The cheapest
    term in the geometric heuristic is a lower bound on the cost of an action.
    """
    e = geometric_estimate(world, np.zeros(7, dtype=np.int64))
    return 2.0**-24 / min(cost for cost in (e.distance, e.turn, e.foot) if cost > 0)


def suboptimality(cost: float, lower_bound: float, rounding: float) -> float:
    """Returns the smallest proven bound >= 1 on cost / least cost; inf without a plan or without a lower bound.

    The bound is exactly 1 if ``rounding`` explains the difference between the costs.
    """
    if lower_bound >= cost * (1 - 3 * rounding * cost):
        return 1.0 if np.isfinite(cost) else np.inf
    return cost / lower_bound if lower_bound > 0 else np.inf
