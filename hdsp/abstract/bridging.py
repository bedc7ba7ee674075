"""Costs-to-go for states between the ends of an action, where the robot cannot rest."""

import math

import numpy as np

from hdsp.base.jit import njit
from hdsp.robot.lattice import DRIVE_MOVES

#: States that an action passes over: rows (action, x, y), int64 [n, 3], with (x, y) from the state to the action's end.
PASSED = np.array(
    [
        (m, dx - x, dy - y)
        for m, (dx, dy) in enumerate(DRIVE_MOVES)
        for x in sorted({math.floor(dx / 2), math.ceil(dx / 2)})
        for y in sorted({math.floor(dy / 2), math.ceil(dy / 2)})
        if (x, y) not in ((0, 0), (dx, dy))
    ],
    dtype=np.int64,
)


def passed_over(incoming: np.ndarray) -> np.ndarray:
    """Returns whether a feasible action passes over a state, bool [16, nx, ny].

    Args:
        incoming: float32 [16, nx, ny, 22], costs by end state, see `hdsp.abstract.prepared_graph.PreparedGraph`.
    """
    return _passed_over(incoming, PASSED)


def bridge(incoming: np.ndarray, distances: np.ndarray, passed: np.ndarray) -> np.ndarray:
    """Returns costs-to-go with values for states between the ends of an action, float64 [16, nx, ny].

    Args:
        incoming: as for `passed_over`.
        distances: float64 [16, nx, ny], costs-to-go.
        passed: result of `passed_over`.
    """
    return _bridge(incoming, distances, passed, PASSED)


@njit(nogil=True)
def _passed_over(incoming, passed):
    headings, nx, ny, _ = incoming.shape
    result = np.zeros((headings, nx, ny), dtype=np.bool_)
    for k in range(headings):
        for x in range(nx):
            for y in range(ny):
                for n in range(len(passed)):
                    if incoming[k, x, y, passed[n, 0]] < np.inf:
                        # The start is on the map, and so are all states between.
                        result[k, x - passed[n, 1], y - passed[n, 2]] = True
    return result


@njit(nogil=True)
def _bridge(incoming, distances, passed_over, passed):
    headings, nx, ny = distances.shape
    result = distances.copy()
    for k in range(headings):
        for a in range(nx):
            for b in range(ny):
                if distances[k, a, b] < np.inf or not passed_over[k, a, b]:
                    continue
                least = np.inf
                for n in range(len(passed)):
                    x, y = a + passed[n, 1], b + passed[n, 2]
                    if 0 <= x < nx and 0 <= y < ny and distances[k, x, y] < least:
                        least = min(least, distances[k, x, y] + 0.5 * incoming[k, x, y, passed[n, 0]])
                result[k, a, b] = least
    return result
