"""Which costs-to-go of abstract states an expansion reads, for a table that is filled while a search goes on.

A search may expand a state only when all costs-to-go that its successors read are known. Every estimate is then final,
and the search is the same as with the whole table.
"""

from typing import NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.states import unpack
from hdsp.detailed.world.world import World
from hdsp.robot.lattice import ABSTRACT_ANCHOR, ABSTRACT_HEADINGS, CELLS_PER_ABSTRACT, HEADINGS_PER_ABSTRACT

#: Most abstract states that are named at once.
_MOST = 1 << 10
#: Cells; farthest look ahead for falling costs-to-go.
AHEAD = 8


class Reading(NamedTuple):
    """What a search knows about a table of costs-to-go; empty if all of it is known.

    Attributes:
        known: bool [16 * nx * ny], whether a value is final.
        reach: int64 [n, 2], distances in cells and heading steps by which successors differ from a state.
        wanted: int64 [...], abstract states whose values are missing, flat indices.
        asked: int64 [1], packed state that cannot be expanded without them.
    """

    known: np.ndarray
    reach: np.ndarray
    wanted: np.ndarray
    asked: np.ndarray


def all_known() -> Reading:
    """Returns the reading of a complete table."""
    return Reading(
        np.empty(0, np.bool_),
        np.empty((0, 2), np.int64),
        np.empty(0, np.int64),
        np.empty(0, np.int64),
    )


def reading(world: World, known: np.ndarray) -> Reading:
    """Returns the reading of a table that is filled while a search goes on; arguments as in ``Reading``."""
    t = world.tables
    shift = max(abs(t.move_dx).max(), abs(t.move_dy).max(), abs(t.shifts[:, :2]).max())
    turn = 0 if world.constants.on_the_spot else abs(t.arcs[..., :2]).max()
    reach = np.array([[shift, 0], [turn, 1]], np.int64)
    return Reading(known, reach, np.empty(_MOST, np.int64), np.zeros(1, np.int64))


@njit(allocates=False)
def missing(r, values, uneven, ahead, nx, ny, key):
    """Names the costs-to-go that the estimates of a packed state and of its successors read, and that are not known.

    Args:
        r: the reading; ``wanted`` and ``asked`` are filled.
        values, uneven, nx, ny: as in ``CostsToGo``.
        ahead: float64 [64, 2], direction of each heading.
        key: packed state.

    Returns:
        Their number; 0 if the state may be expanded.
    """
    ix, iy, heading, _, _, _, _ = unpack(key)
    r.asked[0] = key
    count = 0
    edges = False
    for n in range(len(r.reach)):
        cells, turn = r.reach[n, 0], r.reach[n, 1]
        first_a = (ix - cells - ABSTRACT_ANCHOR) // CELLS_PER_ABSTRACT
        end_a = -((ABSTRACT_ANCHOR - ix - cells) // CELLS_PER_ABSTRACT) + 1
        first_b = (iy - cells - ABSTRACT_ANCHOR) // CELLS_PER_ABSTRACT
        end_b = -((ABSTRACT_ANCHOR - iy - cells) // CELLS_PER_ABSTRACT) + 1
        for k in range((heading - turn) // HEADINGS_PER_ABSTRACT, -((-heading - turn) // HEADINGS_PER_ABSTRACT) + 1):
            for a in range(max(first_a, 0), min(end_a, nx)):
                for b in range(max(first_b, 0), min(end_b, ny)):
                    edges = edges or uneven[a * ny + b]
                    place = (k % ABSTRACT_HEADINGS * nx + a) * ny + b
                    if not r.known[place] and count < len(r.wanted):
                        r.wanted[count] = place
                        count += 1
    if count > 0 or not edges:
        return count
    # A foot's step counts as done where costs-to-go fall from a successor to a place ahead.
    for n in range(len(r.reach)):
        cells, turn = r.reach[n, 0], r.reach[n, 1]
        for far in range(1, AHEAD + 1):
            x, y = ix + np.int64(np.rint(far * ahead[heading, 0])), iy + np.int64(np.rint(far * ahead[heading, 1]))
            first_a, end_a = (x - cells - turn) // CELLS_PER_ABSTRACT, (x + cells + turn) // CELLS_PER_ABSTRACT + 1
            first_b, end_b = (y - cells - turn) // CELLS_PER_ABSTRACT, (y + cells + turn) // CELLS_PER_ABSTRACT + 1
            for k in range(_nearest(heading - turn), _nearest(heading + turn) + 1):
                for a in range(max(first_a, 0), min(end_a, nx)):
                    for b in range(max(first_b, 0), min(end_b, ny)):
                        place = (k % ABSTRACT_HEADINGS * nx + a) * ny + b
                        if r.known[place]:
                            continue
                        if count < len(r.wanted):
                            r.wanted[count] = place
                            count += 1
    return count


@njit(inline="always")
def _nearest(heading):
    return (heading + HEADINGS_PER_ABSTRACT // 2) // HEADINGS_PER_ABSTRACT
