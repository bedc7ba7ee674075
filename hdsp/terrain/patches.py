"""Patches: squares of a height map in the robot frame, the input of networks.

Convention: patch cell ``(i, j)`` has the height at ``base + R(theta) * (i - c, j - c) * resolution``, where ``c`` is
half the patch size in cells. The x axis is the base heading, and the base stands at the centre of patch cell
``(c, c)``. Sampling takes the nearest cell; heights outside the map are NaN.
"""

import functools

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.jit import njit
from hdsp.base.messages import shown
from hdsp.base.scalars import integer
from hdsp.robot import lattice
from hdsp.robot.lattice import PATCH_CELLS
from hdsp.terrain.no_data import unmasked

#: Positions this close (in cells) to the border between two cells count as on the border, despite rounding errors.
TIE = 1e-6
#: Side of a map, in cells, that contains the patch around its middle cell at every heading.
ROTATED_MAP_CELLS = 104
_LARGEST_SIDE = 10_000  # cells


def crop_patches(
    heights: np.ndarray, bases: np.ndarray, headings, cells: int = PATCH_CELLS, out: np.ndarray | None = None
) -> np.ndarray:
    """Crops many patches at once, each equal to `HeightMap.crop_cells` at its base.

    Args:
        heights: float32 [nx, ny], metres; NaN or masked = unknown.
        bases: int [n, 2], cells (ix, iy) with the bases at their centres; they may lie outside the map.
        headings: int [n], or one heading for all: index of the detailed heading in [0, 64).
        cells: side length of the patches in cells.
        out: float32 [n, cells, cells], output array; reused memory is several times faster than new memory.

    Returns:
        float32 [n, cells, cells], NaN outside the map; ``out`` if given.
    """
    heights = np.ascontiguousarray(unmasked(heights), dtype=np.float32)
    bases = np.ascontiguousarray(bases, dtype=np.int64)
    if heights.ndim != 2 or bases.ndim != 2 or bases.shape[1] != 2:
        raise InputError(f"crop_patches: heights {heights.shape} and bases {bases.shape}; need [nx, ny] and [n, 2]")
    headings = np.broadcast_to(np.mod(np.asarray(headings, np.int64), lattice.HEADINGS), len(bases))
    cells = checked_side(cells)
    shape = (len(bases), cells, cells)
    patches = np.empty(shape, np.float32) if out is None else out
    if patches.shape != shape or patches.dtype != np.float32 or not patches.flags.c_contiguous:
        raise InputError(f"crop_patches: out is {patches.dtype} {patches.shape}; need contiguous float32 {shape}")
    offsets = _read_only(_offsets_of_headings(cells))
    _crop_kernel(_read_only(heights), _read_only(bases), _read_only(headings.copy()), offsets, patches)
    return patches


def patch_offsets(theta: float, cells: int = PATCH_CELLS, shift_x: float = 0.0, shift_y: float = 0.0):
    """Offsets (dx, dy) from the base's cell to each patch cell, in map cells: whole numbers, float64 [cells, cells].

    ``shift_x, shift_y`` (in cells) is the position of the base relative to the centre of its cell. Halves are rounded
    away from zero, so without a shift, a quarter turn of the patch rotates the offsets exactly.
    """
    steps = np.arange(cells) - cells // 2
    rotation = lattice.rotation(theta)
    return tuple(
        nearest_cell(row[0] * steps[:, None] + row[1] * steps[None, :] + shift)
        for row, shift in zip(rotation, (shift_x, shift_y), strict=True)
    )


@functools.lru_cache(maxsize=8)
def _offsets_of_headings(cells: int) -> np.ndarray:
    """Offsets from `patch_offsets` for every detailed heading, int32 [64, 2, cells, cells]."""
    angles = lattice.heading_angle(np.arange(lattice.HEADINGS))
    return np.array([patch_offsets(float(angle), cells) for angle in angles]).astype(np.int32)


@njit(nogil=True)
def _crop_kernel(heights, bases, headings, offsets, patches):
    nx, ny = heights.shape
    n, side, _ = patches.shape
    flat = heights.reshape(-1)
    # For a patch completely on the map, one flat offset per cell is enough.
    flat_offsets = offsets[:, 0] * np.int32(ny) + offsets[:, 1]
    # Largest distance between the base and a rotated patch cell in x or in y.
    reach = np.int64(side * 0.7072 + 2)
    for p in range(n):
        x, y = bases[p]
        heading = headings[p]
        if reach <= x < nx - reach and reach <= y < ny - reach:
            around = flat[(x - reach) * ny : (x + reach + 1) * ny]
            base = np.int32(reach * ny + y)
            for i in range(side):
                row, taken = flat_offsets[heading, i], patches[p, i]
                for j in range(side):
                    taken[j] = around[np.uint32(base + row[j])]
        else:
            dx, dy = offsets[heading, 0], offsets[heading, 1]
            for i in range(side):
                for j in range(side):
                    u, v = x + dx[i, j], y + dy[i, j]
                    inside = 0 <= u < nx and 0 <= v < ny
                    patches[p, i, j] = heights[u, v] if inside else np.nan


def nearest_cell(values):
    """Nearest whole numbers, as floats; halves (up to `TIE`) are rounded away from zero."""
    values = np.asarray(values, dtype=float)
    return np.copysign(np.floor(np.abs(values) + (0.5 + TIE)), values)


def gather(heights: np.ndarray, ix, iy) -> np.ndarray:
    """Heights at cells with whole-numbered float indices; NaN outside the map and for NaN indices."""
    ix, iy = np.broadcast_arrays(ix, iy)
    inside = (ix >= 0) & (ix < heights.shape[0]) & (iy >= 0) & (iy < heights.shape[1])
    taken = np.full(inside.shape, np.nan, np.float32)
    taken[inside] = heights[ix[inside].astype(np.int64), iy[inside].astype(np.int64)]
    return taken


def _read_only(array: np.ndarray) -> np.ndarray:
    """Read-only view of an array.

    Numba compiles separate code for writable and read-only arrays, so kernels always get read-only arrays.
    """
    view = array.view()
    view.flags.writeable = False
    return view


def checked_side(cells: int) -> int:
    """The patch side in cells; raises InputError for no whole number, or one out of range."""
    found = integer(cells)
    if found is None or not 1 <= found <= _LARGEST_SIDE:
        raise InputError(f"patch of {shown(cells)} cells; need a whole number from 1 to {_LARGEST_SIDE:,}")
    return found
