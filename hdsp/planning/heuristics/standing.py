"""Abstract states at which the robot can stand, and its feet there."""

import math

import numpy as np

from hdsp.base.gradual import Steps, finished
from hdsp.base.jit import njit
from hdsp.detailed.actions.state_costs import foot_row
from hdsp.detailed.states import pack
from hdsp.detailed.world.body import body_is_free
from hdsp.detailed.world.world import World, cell_index
from hdsp.robot.lattice import (
    ABSTRACT_ANCHOR,
    ABSTRACT_HEADINGS,
    CELLS_PER_ABSTRACT,
    HEADINGS_PER_ABSTRACT,
    abstract_shape,
)

_STATES = 4000  # states that are looked at between two looks at the clock


def standing_states(world: World) -> np.ndarray:
    """Abstract states at whose anchor the robot can stand, bool [16, nx, ny].

    Some feet have footholds, far enough apart, and the body is free over the footholds nearest to neutral.
    """
    return finished(standing_steps(world)) >= 0


def standing_steps(world: World) -> Steps[np.ndarray]:
    """Feet at abstract states, in short steps.

    Returns:
        int32 [16, nx, ny], the footholds nearest to neutral, as packed bits (`hdsp.detailed.states`); -1 where the
        robot cannot stand.
    """
    nx, ny = abstract_shape((world.nx, world.ny))
    result = np.full((ABSTRACT_HEADINGS, nx, ny), -1, dtype=np.int32)
    rows = max(1, _STATES // max(ny, 1))
    for k in range(ABSTRACT_HEADINGS):
        # Values that the world keeps would take a gigabyte on a map of 100 m, and a search reads few of them.
        aside = world._replace(level_ground=np.zeros(len(world.level_ground), np.float32))
        for first in range(0, nx, rows):
            _find_standing(aside, result, k, first, min(first + rows, nx), 0, ny)
            yield
    return result


def updated_standing(before: World, world: World, feet: np.ndarray) -> np.ndarray:
    """Returns feet as from ``standing_steps`` after a change in a map of the same size.

    Args:
        before: terrain and robot before the change.
        world: the same after the change.
        feet: result before the change.
    """
    changed = np.zeros(len(world.standable), bool)
    # Neither S nor the highest ground around the body decides where the robot can stand.
    for name in ("standable", "height", "steep"):
        old, new = getattr(before, name), getattr(world, name)
        if len(old) > 0:  # slopes with one limit have no map
            changed |= old != new
    feet = feet.copy()
    cells = np.argwhere(changed.reshape(-1, world.stride)) - world.pad
    if len(cells) == 0:
        return feet
    # A robot reads no cell that is farther away from its base than the rim around the map is wide.
    low = np.maximum((cells.min(axis=0) - world.pad) // CELLS_PER_ABSTRACT, 0)
    high = np.minimum((cells.max(axis=0) + world.pad) // CELLS_PER_ABSTRACT + 1, feet.shape[1:])
    for k in range(ABSTRACT_HEADINGS):
        feet[k, low[0] : high[0], low[1] : high[1]] = -1
        _find_standing(world, feet, k, low[0], high[0], low[1], high[1])
    return feet


def uneven_cells(world: World) -> np.ndarray:
    """Abstract cells around which a foot within its reach may meet an edge, bool [nx, ny]."""
    from scipy.ndimage import maximum_filter

    nx, ny = abstract_shape((world.nx, world.ny))
    size = CELLS_PER_ABSTRACT
    inner = slice(world.pad, world.pad + size * nx), slice(world.pad, world.pad + size * ny)
    blocked = ~world.standable.reshape(-1, world.stride)[inner]
    blocks = blocked.reshape(nx, size, ny, size).any(axis=(1, 3))
    c, t = world.constants, world.tables
    reach = math.hypot(c.neutral_x + max(-t.lowest, t.n_offsets - 1 + t.lowest), c.neutral_y)
    width = 2 * math.ceil(reach / size + 1) + 1
    return maximum_filter(blocks, width, mode="constant", cval=True)


@njit(allocates=False, nogil=True)
def _find_standing(world, result, k, first, end, left, right):
    """Fills rows ``first`` to ``end`` and columns ``left`` to ``right`` of ``result`` at one abstract heading."""
    standable, feet, samples, n = world.standable, world.tables.feet, world.tables.n_samples, world.tables.n_offsets
    apart = 2 * world.constants.neutral_x - world.constants.min_separation
    heading = k * HEADINGS_PER_ABSTRACT
    left_front, left_rear = foot_row(world.tables, heading, 0, 0), foot_row(world.tables, heading, 1, 0)
    right_rear, right_front = foot_row(world.tables, heading, 2, 0), foot_row(world.tables, heading, 3, 0)
    for a in range(first, end):
        for b in range(left, right):
            ix, iy = CELLS_PER_ABSTRACT * a + ABSTRACT_ANCHOR, CELLS_PER_ABSTRACT * b + ABSTRACT_ANCHOR
            p = cell_index(world, ix, iy)
            if not _side_stands(standable, feet, samples, n, p, left_front, left_rear, apart):
                continue
            if not _side_stands(standable, feet, samples, n, p, right_front, right_rear, apart):
                continue
            o0, o1 = _nearest_to_neutral(world, heading, p, 0), _nearest_to_neutral(world, heading, p, 1)
            o2, o3 = _nearest_to_neutral(world, heading, p, 2), _nearest_to_neutral(world, heading, p, 3)
            if body_is_free(world, heading, p, o0, o1, o2, o3):
                result[k, a, b] = np.int32(pack(0, 0, 0, o0, o1, o2, o3))


@njit(inline="always")
def _nearest_to_neutral(world, heading, p, foot):
    """Offset, counted from the lowest, of a foot's foothold nearest to neutral; the foot has some foothold."""
    t = world.tables
    best = -t.lowest
    farther = max(-t.lowest, t.n_offsets - 1 + t.lowest) + 1
    for away in range(2 * farther):
        offset = -t.lowest + (away // 2 if away % 2 else -(away // 2))
        if 0 <= offset < t.n_offsets and world.standable[p + t.feet[foot_row(t, heading, foot, offset)]]:
            best = offset
            break
    return best


@njit(inline="always")
def _side_stands(standable, feet, n_samples, n_offsets, p, front, rear, apart):
    """Whether both feet on one side, given by their rows in ``feet``, find footholds far enough apart.

    The distance is largest with the front foot in its foremost and the rear foot in its rearmost foothold.
    """
    ahead, behind = n_offsets - 1, 0
    while ahead >= 0 and not standable[p + feet[front + ahead * n_samples]]:
        ahead -= 1
    while behind < n_offsets and not standable[p + feet[rear + behind * n_samples]]:
        behind += 1
    return ahead >= 0 and behind < n_offsets and behind - ahead <= apart
