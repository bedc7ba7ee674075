"""Detailed states as single integers.

A state (ix, iy, heading, f0, f1, f2, f3) in lattice units is packed into one int64: 16 bits each for x and y, 6 for the
heading, 5 for each foot offset counted from its lowest value.
"""

import math

import numpy as np

from hdsp.base.jit import njit
from hdsp.robot.lattice import HEADINGS

_FOOT_BITS, _HEADING_BITS, _CELL_BITS = 5, 6, 16
_FOOT_MASK = (1 << _FOOT_BITS) - 1
_HEADING_MASK = HEADINGS - 1
_CELL_MASK = (1 << _CELL_BITS) - 1
HEADING_SHIFT = 4 * _FOOT_BITS
_Y_SHIFT = HEADING_SHIFT + _HEADING_BITS
_X_SHIFT = _Y_SHIFT + _CELL_BITS
_FOOT_SHIFTS = _FOOT_BITS * np.arange(3, -1, -1)

#: Most cells along x or y.
MAX_CELLS = 1 << _CELL_BITS
#: Feet bits in a packed state.
FEET_MASK = (1 << HEADING_SHIFT) - 1


@njit(inline="always")
def foot_shift(foot):
    """Position of a foot's lowest bit in a packed state."""
    return _FOOT_BITS * (3 - foot)


@njit(inline="always")
def foot_offset(key, shift):
    """Foot offset at a ``foot_shift``, counted from the lowest."""
    return (key >> shift) & _FOOT_MASK


@njit(inline="always")
def pack(ix, iy, heading, o0, o1, o2, o3):
    """Packed state, int64; ``o`` are foot offsets counted from the lowest."""
    base = (np.int64(ix) << _X_SHIFT) | (np.int64(iy) << _Y_SHIFT) | (np.int64(heading) << HEADING_SHIFT)
    front = (np.int64(o0) << 3 * _FOOT_BITS) | (np.int64(o1) << 2 * _FOOT_BITS)
    return base | front | (np.int64(o2) << _FOOT_BITS) | np.int64(o3)


@njit(inline="always")
def neutral_feet(lowest):
    """Feet bits for neutral feet."""
    return -lowest * (1 << 3 * _FOOT_BITS | 1 << 2 * _FOOT_BITS | 1 << _FOOT_BITS | 1)


@njit(inline="always")
def unpack(key):
    """Splits a packed state into (ix, iy, heading, o0, o1, o2, o3)."""
    return (
        key >> _X_SHIFT, (key >> _Y_SHIFT) & _CELL_MASK, (key >> HEADING_SHIFT) & _HEADING_MASK,
        (key >> 3 * _FOOT_BITS) & _FOOT_MASK, (key >> 2 * _FOOT_BITS) & _FOOT_MASK,
        (key >> _FOOT_BITS) & _FOOT_MASK, key & _FOOT_MASK,
    )  # fmt: skip


def pack_steps(steps: np.ndarray) -> np.ndarray:
    """Changes in packed states, int64 [n], for steps (dx, dy), int64 [n, 2]."""
    return (steps[:, 0] << _X_SHIFT) + (steps[:, 1] << _Y_SHIFT)


def pack_states(states, lowest: int) -> np.ndarray:
    """Packs detailed states [n, 7] in lattice units into int64 [n]; ``lowest`` is the smallest foot offset."""
    s = np.atleast_2d(np.asarray(states, dtype=np.int64))
    base = s[:, 0] << _X_SHIFT | s[:, 1] << _Y_SHIFT | s[:, 2] << HEADING_SHIFT
    return base | np.bitwise_or.reduce(s[:, 3:] - lowest << _FOOT_SHIFTS, axis=1)


def distinct_rows(values: np.ndarray) -> np.ndarray:
    """Returns the index, int64 [m], of the first of equal rows of integers, in the lexicographic order of the rows.

    Rows are compared as single numbers, which is ten times as fast as ``np.unique`` along an axis.
    """
    low = values.min(axis=0)
    spans = (values.max(axis=0) - low + 1).tolist()
    if math.prod(spans) >= 1 << 63:
        return np.unique(values, axis=0, return_index=True)[1]
    keys = np.zeros(len(values), np.int64)
    for column, span in enumerate(spans):
        keys = keys * span + (values[:, column] - low[column])
    return np.unique(keys, return_index=True)[1]


def unpack_states(keys, lowest: int) -> np.ndarray:
    """Unpacks states [n] into detailed states, int64 [n, 7], lattice units."""
    k = np.asarray(keys, dtype=np.int64)[..., None]
    base = [k >> _X_SHIFT, k >> _Y_SHIFT & _CELL_MASK, k >> HEADING_SHIFT & _HEADING_MASK]
    return np.concatenate([*base, (k >> _FOOT_SHIFTS & _FOOT_MASK) + lowest], axis=-1)
