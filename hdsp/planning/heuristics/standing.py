"""Abstract states at which the robot can stand."""

import numpy as np

from hdsp.base.gradual import Steps, finished
from hdsp.base.jit import njit
from hdsp.detailed.actions.state_costs import foot_row
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
    return finished(standing_steps(world))


def standing_steps(world: World) -> Steps[np.ndarray]:
    """Like `standing_states`, in short steps."""
    nx, ny = abstract_shape((world.nx, world.ny))
    result = np.zeros((ABSTRACT_HEADINGS, nx, ny), dtype=np.bool_)
    rows = max(1, _STATES // max(ny, 1))
    for k in range(ABSTRACT_HEADINGS):
        for first in range(0, nx, rows):
            _find_standing(world, result, k, first, min(first + rows, nx))
            yield
    return result


@njit()
def _find_standing(world, result, k, first, end):
    """Fills rows ``first`` to ``end`` of ``result`` at one abstract heading."""
    standable, feet, samples, n = world.standable, world.tables.feet, world.tables.n_samples, world.tables.n_offsets
    apart = 2 * world.constants.neutral_x - world.constants.min_separation
    heading = k * HEADINGS_PER_ABSTRACT
    left_front, left_rear, right_rear, right_front = [foot_row(world.tables, heading, i, 0) for i in range(4)]
    for a in range(first, end):
        for b in range(result.shape[2]):
            ix, iy = CELLS_PER_ABSTRACT * a + ABSTRACT_ANCHOR, CELLS_PER_ABSTRACT * b + ABSTRACT_ANCHOR
            p = cell_index(world, ix, iy)
            result[k, a, b] = (
                _side_stands(standable, feet, samples, n, p, left_front, left_rear, apart)
                and _side_stands(standable, feet, samples, n, p, right_front, right_rear, apart)
                and _is_free_near_neutral(world, heading, p)
            )


@njit(inline="always")
def _is_free_near_neutral(world, heading, p):
    """Whether the body is free over the feet nearest to neutral; each foot has some foothold."""
    o0, o1 = _nearest_to_neutral(world, heading, p, 0), _nearest_to_neutral(world, heading, p, 1)
    o2, o3 = _nearest_to_neutral(world, heading, p, 2), _nearest_to_neutral(world, heading, p, 3)
    return body_is_free(world, heading, p, o0, o1, o2, o3)


@njit(inline="always")
def _nearest_to_neutral(world, heading, p, foot):
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
