"""The poses that a search reached, for explanations of its failure."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.search.life_cycle import Search
from hdsp.detailed.search.store import BLOCK, BLOCKS, key_of
from hdsp.detailed.states import pack_states, unpack, unpack_states
from hdsp.robot.lattice import HEADINGS, cells, heading_angle

#: Way (m) that counts as much as a turn by 1 rad where poses are compared; about the lever of a foot.
METRES_PER_RADIAN = 0.3


class Reached(NamedTuple):
    """States that a search reached.

    Attributes:
        headings: uint64 [nx, ny], bit h set if a state at heading h with any feet was reached.
        nearest: int64 [7], the reached state nearest to the goal, lattice units.
    """

    headings: np.ndarray
    nearest: np.ndarray


def reached_by(search: Search, goal: np.ndarray) -> Reached:
    """Returns the states that a search reached so far; the nearest one is nearest to ``goal``, int64 [7]."""
    world = search.world
    headings = np.zeros((world.nx, world.ny), np.uint64)
    (packed,) = pack_states(goal, world.tables.lowest)
    per_heading = cells(METRES_PER_RADIAN * float(heading_angle(1)))
    nearest, least = packed, np.inf
    for store in search.stores():
        nearest, least = _collect(store, packed, per_heading, headings, nearest, least)
    return Reached(headings, unpack_states(nearest, world.tables.lowest))


@njit(nogil=True)
def _collect(store, goal, per_heading, headings, nearest, least):
    """Marks the headings of all states in a store; returns the packed state nearest to a goal, and how near it is.

    Args:
        store: states seen by a search.
        goal: packed state.
        per_heading: cells that count as much as a heading step.
        headings: as in ``Reached``; changed in place.
        nearest, least: nearest state from other stores, and how near it is.
    """
    gx, gy, gh, g0, g1, g2, g3 = unpack(goal)
    for node in range(BLOCK, BLOCK * store.counts[BLOCKS]):
        if store.g[node] == np.inf:
            continue
        key = key_of(store, node)
        x, y, h, o0, o1, o2, o3 = unpack(key)
        headings[x, y] |= np.uint64(1) << np.uint64(h)
        turn = abs(h - gh)
        away = np.hypot(np.float64(x - gx), np.float64(y - gy)) + per_heading * min(turn, HEADINGS - turn)
        # Among states at one pose, feet near the goal's feet are nearer.
        away += 1e-3 * (abs(o0 - g0) + abs(o1 - g1) + abs(o2 - g2) + abs(o3 - g3))
        if away < least:
            nearest, least = key, away
    return nearest, least
