"""Costs and validity of detailed states, and the cells under their feet.

State cost: ``C = 1 + k (max S + sum S)`` over the feet (paper, Sec. V-A; docs/cost-model.md).
"""

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.states import unpack
from hdsp.detailed.world.body import body_is_free
from hdsp.detailed.world.world import cell_index


@njit(allocates=False)
def state_cost(world, key):
    """State cost C for a packed state; inf without a foothold for every foot, or with a blocked base."""
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    p = cell_index(world, ix, iy)
    t = world.tables
    uneven, contacts = world.uneven, t.contacts
    s0, s1 = uneven[p + contacts[foot_row(t, heading, 0, o0)]], uneven[p + contacts[foot_row(t, heading, 1, o1)]]
    s2, s3 = uneven[p + contacts[foot_row(t, heading, 2, o2)]], uneven[p + contacts[foot_row(t, heading, 3, o3)]]
    cost = merged_cost(world.constants.unevenness, s0, s1, s2, s3)
    if cost < np.inf and not body_is_free(world, heading, p, o0, o1, o2, o3):
        return np.inf
    return cost


@njit()
def state_costs(world, keys):
    """State costs, float64 [n], for packed states int64 [n]."""
    result = np.empty(len(keys))
    for i in range(len(keys)):
        result[i] = state_cost(world, keys[i])
    return result


@njit(inline="always")
def merged_cost(k, s0, s1, s2, s3):
    """State cost C (unitless) for S under the feet."""
    largest = max(max(s0, s1), max(s2, s3))
    return 1.0 + k * (np.float64(largest) + s0 + s1 + s2 + s3)


@njit(inline="always")
def foot_row(tables, heading, foot, offset):
    """First sample for a foot in ``tables.feet`` and ``tables.contacts``."""
    return ((heading * 4 + foot) * tables.n_offsets + offset) * tables.n_samples


@njit(inline="always")
def feet_cells(p, feet, n_offsets, n_samples, heading, o0, o1, o2, o3):
    """Flat cells under the four feet; with ``tables.contacts``, their places in ``world.uneven``.

    The arguments are arrays and numbers, because a tuple argument costs reference counts.
    """
    row = heading * 4 * n_offsets
    return (
        p + feet[(row + o0) * n_samples], p + feet[(row + n_offsets + o1) * n_samples],
        p + feet[(row + 2 * n_offsets + o2) * n_samples], p + feet[(row + 3 * n_offsets + o3) * n_samples],
    )  # fmt: skip


@njit(inline="always")
def separated(constants, key):
    """Whether front and rear foot keep their distance on each side."""
    apart = 2 * constants.neutral_x - constants.min_separation
    _, _, _, o0, o1, o2, o3 = unpack(key)
    return o1 - o0 <= apart and o2 - o3 <= apart


@njit(inline="always")
def supported(constants, lowest, lifted, o0, o1, o2, o3):
    """Whether the three other feet support the base: its centre lies ``support_margin`` cells inside their triangle."""
    x, y = constants.neutral_x + lowest, constants.neutral_y
    back = -constants.neutral_x + lowest
    px = (x + o0, back + o1, back + o2, x + o3)
    py = (y, y, -y, -y)
    a, b, c = (lifted + 1) % 4, (lifted + 2) % 4, (lifted + 3) % 4
    # The feet run counter-clockwise, so the centre is inside if it is to the left of each edge.
    for i, j in ((a, b), (b, c), (c, a)):
        ex, ey = px[j] - px[i], py[j] - py[i]
        left = (ey * px[i] - ex * py[i]) / np.sqrt(ex * ex + ey * ey)
        if left < constants.support_margin - 1e-9:
            return False
    return True
