"""Kernels of the manual abstraction: the terrain at poses, and the costs of actions through poses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.robot.lattice import ABSTRACT_HEADINGS

_FEET = 4
#: Bits in the code of a pose: a foot is on a step (one bit for each), the way is closed, and the pose is known.
_CLOSED, _KNOWN = np.uint8(1 << _FEET), np.uint8(2 << _FEET)
_STEPS = np.uint8(_CLOSED - 1)
_ZERO, _ONE = np.float32(0), np.float32(1)
_ROUNDING = 1e-4  # m


class CoarseGround(NamedTuple):
    """Coarse terrain, all [nx, ny]; beyond it, the ground is unknown.

    Attributes:
        walls: bool, no foot passes.
        edges: bool, no wheel passes.
        ranges: float32, height range, m; 0 where unknown.
        tops: float32, highest ground, m; NaN where unknown.
        heights: float32, mean height, m; likewise.
        near_tops: float32, an upper bound on the highest ground below the body of a robot in this cell, m.
    """

    walls: np.ndarray
    edges: np.ndarray
    ranges: np.ndarray
    tops: np.ndarray
    heights: np.ndarray
    near_tops: np.ndarray


class CoarsePoseCells(NamedTuple):
    """Cells that a pose reads at each heading, relative to its base cell; rows of ``around`` and ``body`` end early.

    Attributes:
        feet: int64 [16, 4, 3, 2], cell under each neutral foot, and within its reach ahead and behind.
        around: int64 [16, n, 2], cells whose height range makes the ground uneven.
        around_counts: int64 [16], rows in use.
        body: int64 [16, n, 2], cells below the body.
        places: float64 [16, n, 3], their place in the robot frame (m), and the body height above ground (m).
        body_counts: int64 [16], rows in use.
        farthest: float64 [16, 3], greatest distance of these cells ahead and aside, and least body height (m).
        limits: float64 [4], half of the feet's distance along x and along y (m), steepest gradients ahead and left.
    """

    feet: np.ndarray
    around: np.ndarray
    around_counts: np.ndarray
    body: np.ndarray
    places: np.ndarray
    body_counts: np.ndarray
    farthest: np.ndarray
    limits: np.ndarray


class Goals(NamedTuple):
    """Goals of actions.

    Attributes:
        met: int64 [goals, n, 2], cells on the way, relative to the start, with poses at the start heading; rows end
            early, and the last one in use is the end.
        counts: int64 [goals], rows in use.
        turns: int64 [goals], abstract headings to a further pose in the start cell; 0 = none.
        may_step: bool [goals], whether feet may step on the way.
        flat: float32 [goals], costs on flat ground.
    """

    met: np.ndarray
    counts: np.ndarray
    turns: np.ndarray
    may_step: np.ndarray
    flat: np.ndarray


class Known(NamedTuple):
    """Poses that were looked at.

    Attributes:
        codes: uint8 [16, nx, ny], bits as above; 0 = not looked at.
        unevenness: float32 [16, nx, ny], mean height range, m.
        measured: bool [16], headings at which the unevenness is known.
    """

    codes: np.ndarray
    unevenness: np.ndarray
    measured: np.ndarray

    @classmethod
    def nothing(cls, nx: int, ny: int) -> Known:
        shape = ABSTRACT_HEADINGS, nx, ny
        return cls(np.zeros(shape, np.uint8), np.empty(shape, np.float32), np.zeros(ABSTRACT_HEADINGS, bool))


def filled(rows: list[list], width: int, kind: type) -> tuple[np.ndarray, np.ndarray]:
    """Returns lists of rows as one array [lists, most, width], zero beyond their ends, and the lengths of the lists."""
    counts = np.array([len(each) for each in rows], np.int64)
    result = np.zeros((len(rows), counts.max(), width), kind)
    for target, each in zip(result, rows, strict=True):
        target[: len(each)] = np.reshape(each, (-1, width))
    return result, counts


@njit(allocates=False, nogil=True)
def find_costs(ground, cells, known, heading, places, shape, goals, which, unevenness_cost, step_cost, costs):
    """Computes costs of actions.

    Args:
        ground: ``CoarseGround``.
        cells: ``CoarsePoseCells``.
        known: ``Known`` for this ground; completed.
        heading: of all starts.
        places: int64 [n, 2], start cells.
        shape: int64 [2]; actions that end in a later cell, or before cell (0, 0), are infeasible.
        goals: ``Goals``.
        which: int64 [m], goals.
        unevenness_cost, step_cost: as in the settings, float32 and float64.
        costs: float32 [n, m], result; inf = infeasible.
    """
    _measure(ground, cells, known, heading)
    for goal in which:
        if goals.turns[goal] != 0:
            _measure(ground, cells, known, (heading + goals.turns[goal]) % ABSTRACT_HEADINGS)
    ny = known.codes.shape[2]
    codes, unevenness = known.codes[heading].reshape(-1), known.unevenness[heading].reshape(-1)
    for n in range(len(places)):
        a, b = places[n, 0], places[n, 1]
        for m in range(len(which)):
            goal, costs[n, m] = which[m], np.inf
            count = goals.counts[goal]
            end_x, end_y = a + goals.met[goal, count - 1, 0], b + goals.met[goal, count - 1, 1]
            if goals.flat[goal] == np.inf or not (0 <= end_x < shape[0] and 0 <= end_y < shape[1]):
                continue
            met, uneven = np.uint8(0), _ZERO
            for i in range(count):
                x, y = a + goals.met[goal, i, 0], b + goals.met[goal, i, 1]
                at = np.uint64(x * ny + y)
                code = codes[at]
                if code == 0:
                    code = _look(ground, cells, known, heading, x, y)
                met |= code
                if met & _CLOSED:
                    break
                uneven += unevenness[at]
            if goals.turns[goal] != 0 and not met & _CLOSED:
                turned = (heading + goals.turns[goal]) % ABSTRACT_HEADINGS
                met |= _look(ground, cells, known, turned, a, b)
                uneven += known.unevenness[turned, a, b]
                count += 1
            steps = met & _STEPS
            if met & _CLOSED or (steps and not goals.may_step[goal]):
                continue
            cost = np.float32(
                goals.flat[goal] * np.float32(_ONE + unevenness_cost * np.float32(uneven / np.float32(count)))
            )
            stepping = 0
            while steps:
                stepping += steps & 1
                steps >>= 1
            costs[n, m] = cost + step_cost * stepping


@njit(inline="always")
def _look(ground, cells, known, heading, a, b):
    code = known.codes[heading, a, b]
    if code == 0:
        code = _pose(ground, cells, heading, a, b)
        known.codes[heading, a, b] = code
    return code


@njit(allocates=False, nogil=True)
def _measure(ground, cells, known, heading):
    """Completes the unevenness of all poses at a heading."""
    if known.measured[heading]:
        return
    known.measured[heading] = True
    nx, ny = ground.ranges.shape
    count = cells.around_counts[heading]
    for a in range(nx):
        total = known.unevenness[heading, a]
        total[:] = _ZERO
        # Single precision and this order of the sum are part of the costs, to the last bit.
        for i in range(count):
            x, aside = a + cells.around[heading, i, 0], cells.around[heading, i, 1]
            if 0 <= x < nx:
                first, end = max(-aside, 0), min(ny - aside, ny)
                if first < end:
                    part, ranges = total[first:end], ground.ranges[x, first + aside : end + aside]
                    for b in range(len(part)):
                        part[b] += ranges[b]
        for b in range(ny):
            total[b] /= np.float32(count)


@njit(allocates=False)
def _pose(ground, cells, heading, a, b):
    """Code of a pose."""
    nx, ny = ground.walls.shape
    code = _KNOWN
    for foot in range(_FEET):
        x, y = a + cells.feet[heading, foot, 0, 0], b + cells.feet[heading, foot, 0, 1]
        if not (0 <= x < nx and 0 <= y < ny) or ground.walls[x, y]:
            code |= _CLOSED
        elif ground.edges[x, y]:
            code |= np.uint8(1 << foot)
            held = True
            for beside in range(1, cells.feet.shape[2]):
                x, y = a + cells.feet[heading, foot, beside, 0], b + cells.feet[heading, foot, beside, 1]
                held = held and (not (0 <= x < nx and 0 <= y < ny) or ground.edges[x, y])
            if held:
                code |= _CLOSED
    if not code & _CLOSED and _body_hits(ground, cells, heading, a, b):
        code |= _CLOSED
    return code


@njit(inline="always")
def _height(ground, cells, heading, foot, a, b):
    """Height under a foot that stands on known ground."""
    return ground.heights[a + cells.feet[heading, foot, 0, 0], b + cells.feet[heading, foot, 0, 1]]


@njit(inline="always")
def _body_hits(ground, cells, heading, a, b):
    """Whether ground rises into the body over the plane under the feet (`hdsp.detailed.base_pose`)."""
    nx, ny = ground.walls.shape
    z0, z1 = _height(ground, cells, heading, 0, a, b), _height(ground, cells, heading, 1, a, b)
    z2, z3 = _height(ground, cells, heading, 2, a, b), _height(ground, cells, heading, 3, a, b)
    length, width = cells.limits[0], cells.limits[1]
    steepest_ahead, steepest_left = cells.limits[2], cells.limits[3]
    ahead = np.float64(z0 + z3 - z1 - z2) / (4 * length)
    left = np.float64(z0 + z1 - z2 - z3) / (4 * width)
    ahead = min(max(ahead, -steepest_ahead), steepest_ahead)
    left = min(max(left, -steepest_left), steepest_left)
    height = np.float32((z0 + z1 + z2 + z3) / np.float32(_FEET))
    lowest = height - cells.farthest[heading, 0] * abs(ahead) - cells.farthest[heading, 1] * abs(left)
    if ground.near_tops[a, b] - lowest < cells.farthest[heading, 2] - _ROUNDING:
        return False
    for i in range(cells.body_counts[heading]):
        x, y = a + cells.body[heading, i, 0], b + cells.body[heading, i, 1]
        if 0 <= x < nx and 0 <= y < ny:
            plane = height + cells.places[heading, i, 0] * ahead + cells.places[heading, i, 1] * left
            if ground.tops[x, y] - plane > cells.places[heading, i, 2]:
                return True
    return False
