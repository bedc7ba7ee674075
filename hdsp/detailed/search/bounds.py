"""Bounds on the cost of plans: rounding of the store, and the ratio that is proved."""

import numpy as np

from hdsp.detailed.search.estimate import geometric_estimate
from hdsp.detailed.world.world import World

#: By this share a plan must cost less than another to be better.
LEAST_GAIN = 1e-6


def rounding(world: World) -> float:
    """Share r * c by which the cost c of a way may be wrong in the store, which adds up in single precision: half a
    unit in the last place per action, and no action costs less than the least that the geometric heuristic counts."""
    e = geometric_estimate(world, np.zeros(7, dtype=np.int64))
    return 2.0**-24 / min(cost for cost in (e.distance, e.turn, e.foot) if cost > 0)


def suboptimality(cost: float, lower_bound: float, rounding: float) -> float:
    """The least bound >= 1 on cost / least cost; exactly 1 if only rounding (see there) lies between."""
    if lower_bound >= cost * (1 - 3 * rounding * cost):
        return 1.0 if np.isfinite(cost) else np.inf
    return cost / lower_bound if lower_bound > 0 else np.inf
