"""Maps rotated to a robot heading, so that the patches for all states are windows into one array.

`hdsp.terrain.patches.crop_patches` cuts each patch at its own base and rounds each cell separately, so overlapping
patches share no cells. Here the whole map is rotated on one grid, and every base moves to the centre of its grid cell.
Both methods are equal at multiples of 90 degrees. At other headings the base moves by up to half a cell along each
axis, an eighth of an abstract cell. In return, a network can be evaluated once per cell instead of once per patch.
"""

import numpy as np

from hdsp.base.jit import njit
from hdsp.robot import lattice
from hdsp.robot.lattice import ABSTRACT_HEADINGS
from hdsp.terrain.patches import TIE


class RotatedMap:
    """Heights on a grid whose first axis points along a heading.

    Convention: grid cell (u, v) takes the height of the map cell nearest to ``R @ (u, v)``, where R is the rotation by
    the heading; halves round away from zero. Grid cell (0, 0) is map cell (0, 0). Grid cells may be negative.

    Args:
        heights: float32 [nx, ny], metres, NaN = unknown.
        heading: abstract heading, index in [0, 16).
    """

    def __init__(self, heights: np.ndarray, heading: int):
        self.rotation = _rotation(heading)
        nx, ny = heights.shape
        corners = self.cells(np.array([(0, 0), (nx - 1, 0), (0, ny - 1), (nx - 1, ny - 1)]))
        self.first = corners.min(axis=0) - 1
        self.heights = np.empty(corners.max(axis=0) + 2 - self.first, np.float32)
        u, v = self.first
        _rotate(np.ascontiguousarray(heights, np.float32), u, v, self.rotation, TIE, self.heights)

    def cells(self, bases: np.ndarray) -> np.ndarray:
        """Returns the grid cells, int64 [..., 2], that hold the centres of map cells ``bases`` [..., 2]."""
        return _cells(bases, self.rotation)

    def window(self, first: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        """Returns heights, float32 [shape], from grid cell ``first`` = (u, v) on; NaN outside the map."""
        window = np.full(shape, np.nan, np.float32)
        low = np.asarray(first) - self.first
        begin = np.clip(low, 0, self.heights.shape)
        end = np.clip(low + shape, begin, self.heights.shape)
        inside = tuple(slice(b - at, e - at) for b, e, at in zip(begin, end, low, strict=True))
        if (end > begin).all():
            window[inside] = self.heights[begin[0] : end[0], begin[1] : end[1]]
        return window

    def patches(self, bases: np.ndarray) -> np.ndarray:
        """Returns patches, float32 [n, 72, 72], for bases on map cells ``bases`` [n, 2]."""
        cells = lattice.PATCH_CELLS
        starts = self.cells(bases) - lattice.PATCH_CENTER
        patches = np.empty((len(starts), cells, cells), np.float32)
        for patch, start in zip(patches, starts, strict=True):
            patch[:] = self.window(start, (cells, cells))
        return patches


def rotated_cells(bases: np.ndarray, heading: int) -> np.ndarray:
    """Returns the cells of ``RotatedMap.cells`` without the map."""
    return _cells(bases, _rotation(heading))


def rotated_window(heights: np.ndarray, heading: int, first: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Returns ``RotatedMap.window`` without the rest of the map; ``heights`` is C-contiguous float32."""
    window = np.empty(shape, np.float32)
    u, v = first
    _rotate(heights, u, v, _rotation(heading), TIE, window)
    return window


def _rotation(heading: int) -> np.ndarray:
    return lattice.rotation(float(lattice.heading_angle(heading, ABSTRACT_HEADINGS)))


def _cells(bases: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    return np.rint(np.asarray(bases) @ rotation).astype(np.int64)


@njit()
def _rotate(heights, first_u, first_v, rotation, tie, rotated):
    nx, ny = heights.shape
    for i in range(rotated.shape[0]):
        u = np.float64(first_u + i)
        for j in range(rotated.shape[1]):
            v = np.float64(first_v + j)
            x = _nearest(rotation[0, 0] * u + rotation[0, 1] * v, tie)
            y = _nearest(rotation[1, 0] * u + rotation[1, 1] * v, tie)
            inside = 0 <= x < nx and 0 <= y < ny
            rotated[i, j] = heights[x, y] if inside else np.float32(np.nan)


@njit(inline="always")
def _nearest(value, tie):
    """Nearest integer; halves round away from zero."""
    return np.int64(np.floor(value + 0.5 + tie)) if value >= 0 else -np.int64(np.floor(-value + 0.5 + tie))
