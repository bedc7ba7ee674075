"""Textbook twin of the relaxed problem over base poses, see `hdsp.detailed.relaxed.relaxed_costs`: plain Python.

A node is a layer (0: neutral feet, 1: any feet) and a base pose: (layer, x, y, heading).
"""

import math
from functools import cache

from tests.naive_ground import CELL


@cache
def least_pose_cost(twin, x, y, heading):
    """Least state cost at a pose over all feet, each foot by itself; inf without a state."""
    low, high = twin.robot.offset_range()
    uneven = []
    for foot in range(4):
        states = [(x, y, heading, *([offset] * 4)) for offset in range(low, high + 1)]
        states = [state for state in states if twin.standable(twin.foothold(state, foot))]
        uneven.append(min((twin.uneven_under_foot(state, foot) for state in states), default=math.inf))
    if not twin.may_be_free((x, y), heading):
        return math.inf
    return 1 + twin.robot.drive.unevenness_cost * (max(uneven) + sum(uneven))


def relaxed_edges(twin, follow, node):
    """Yields (node, cost) for each relaxed action; ``follow`` is the cost per cell for a foot to follow a shift."""
    layer, x, y, heading = node
    neutral = (x, y, heading, 0, 0, 0, 0)
    if layer == 0:
        for _, reached, cost in twin.successors(neutral):
            if not any(reached[3:]):
                yield (0, *reached[:3]), cost
        if twin.any_foot_can_step(neutral):
            yield (1, x, y, heading), 0.0
        return
    price, (n, dx, dy) = twin.robot.base_shift.cost_per_metre * CELL, twin.shift(heading)
    for way in (1, -1) if twin.robot.base_shift.backward else (1,):
        u, v = x + way * dx, y + way * dy
        if twin.inside((u, v)) and least_pose_cost(twin, u, v, heading) < math.inf:
            mean = (least_pose_cost(twin, x, y, heading) + least_pose_cost(twin, u, v, heading)) / 2
            yield (1, u, v, heading), price * math.hypot(dx, dy) * mean + 4 * follow * n
    if twin.valid(neutral):
        yield (0, x, y, heading), 0.0
