"""Height maps: crop in the robot frame, rotate, save and load.

Convention: ``heights[ix, iy]``, axis 0 is x, axis 1 is y. Cell ``(ix, iy)`` covers
``origin + [ix, ix + 1) * resolution`` (the same in y), its centre is at ``+ 0.5``. Heights are float32 metres, NaN is
unknown.

Convention (patches): cell ``(i, j)`` of a patch is the height at ``base + R(theta) * (i - c, j - c) * resolution``,
where ``c`` is half the number of patch cells: the x axis of the patch is the heading of the base, which stands at the
centre of patch cell ``(c, c)``. Sampling takes the nearest cell; outside the map heights are NaN.
"""

import functools
import importlib
import math
import os
from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np

from hdsp.base.errors import InputError
from hdsp.robot import lattice
from hdsp.robot.lattice import PATCH_CELLS, RESOLUTION
from hdsp.terrain.map_files import is_map, read_map, write_map

#: Positions this close (in cells) to the border between two cells count as on the border, whatever rounding error says.
TIE = 1e-6


@dataclass(frozen=True, eq=False)
class HeightMap:
    """A rectangle of heights.

    Attributes:
        heights: float32 [nx, ny], metres, NaN = unknown; a read-only copy of what is passed.
        origin: world (x, y) in metres of the lower corner of cell (0, 0).
        resolution: side of a cell in metres.

    Raises:
        InputError: if the heights are not a 2D array of finite or NaN numbers, or the resolution is not positive.
    """

    heights: np.ndarray
    origin: tuple[float, float] = (0.0, 0.0)
    resolution: float = RESOLUTION

    def __post_init__(self):
        try:
            with np.errstate(over="ignore"):  # a float64 too large for float32 becomes inf and is rejected below
                heights = np.array(self.heights, dtype=np.float32, order="C")
            origin = tuple(float(value) for value in self.origin)
            resolution = float(self.resolution)
        except (TypeError, ValueError) as error:
            raise InputError(f"height map: {error}; need a 2D array, an origin (x, y) and a resolution") from None
        if heights.ndim != 2 or heights.size == 0:
            raise InputError(f"height map: heights have shape {heights.shape}; need two axes, both at least 1 long")
        if np.isinf(heights).any():
            cell = tuple(int(index) for index in np.argwhere(np.isinf(heights))[0])
            raise InputError(f"height map: height of cell {cell} is infinite; need finite heights, or NaN for unknown")
        if len(origin) != 2 or not np.isfinite(origin).all():
            raise InputError(f"height map: origin is {origin}; need two finite numbers (x, y) in metres")
        if not (math.isfinite(resolution) and resolution > 0):
            raise InputError(f"height map: resolution is {resolution}; need a positive number of metres per cell")
        heights.flags.writeable = False
        for name, value in (("heights", heights), ("origin", origin), ("resolution", resolution)):
            object.__setattr__(self, name, value)

    @classmethod
    def flat(cls, shape: tuple[int, int], origin=(0.0, 0.0), resolution: float = RESOLUTION) -> "HeightMap":
        """A map of ``shape`` (nx, ny) cells whose heights are all 0."""
        return cls(np.zeros(shape, np.float32), origin, resolution)

    @classmethod
    def load(cls, path: str | os.PathLike) -> "HeightMap":
        """Reads a map written by `save` (.npz, .h5, .hdf5), or makes one from a file of points in metres, z up.

        Files of points (.pcd, .ply, .las, ...: `hdsp.terrain.pointcloud.FORMATS`) are levelled on their floor; where units,
        axes or what is cut differ, use `hdsp.terrain.pointcloud.read_points` and `from_points`.

        Raises:
            InputError: if the file is missing, damaged, of another kind, or holds no valid map.
        """
        if not is_map(path):
            return cls.from_points(_pointcloud().read_points(path))
        fields = read_map(path)
        try:
            return cls(*fields)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None

    @classmethod
    def from_points(cls, points, settings=None, resolution: float = RESOLUTION) -> "HeightMap":
        """The map of a point cloud: levelled on its floor, ceilings and overhangs removed, small holes filled.

        Args:
            points: float [n, 3], m, z roughly up.
            settings: `hdsp.terrain.pointcloud.MapSettings`; None = its defaults.
            resolution: side of a cell, m.

        Raises:
            InputError: if no floor is found, no point is left, or the extent is not one of metres.
        """
        return _pointcloud().height_map(points, settings, resolution)

    def save(self, path: str | os.PathLike) -> Path:
        """Writes the map; the suffix chooses the format: .npz, or .h5 / .hdf5.

        Raises:
            InputError: if the suffix is another one or the place cannot be written to.
        """
        write_map(path, self.heights, self.origin, self.resolution)
        return Path(path)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of cells (nx, ny)."""
        return self.heights.shape

    @property
    def size(self) -> tuple[float, float]:
        """Extent in metres (x, y)."""
        return self.shape[0] * self.resolution, self.shape[1] * self.resolution

    @property
    def center(self) -> tuple[float, float]:
        """World position in metres of the middle of the map."""
        return self.origin[0] + self.size[0] / 2, self.origin[1] + self.size[1] / 2

    def height_at(self, x, y) -> np.ndarray | float:
        """Height of the cell that contains world position(s) (x, y) in metres; NaN outside the map or where unknown."""
        ix, iy = (
            np.floor((np.asarray(value, float) - low) / self.resolution + TIE)
            for value, low in zip((x, y), self.origin, strict=True)
        )
        return _gather(self.heights, ix, iy)[()]

    def crop(self, pose, cells: int = PATCH_CELLS) -> "HeightMap":
        """The square of ``cells`` x ``cells`` around a pose, in the robot frame (see the convention on patches above).

        At headings that are multiples of 90 degrees this is an exact permutation of cells.

        Args:
            pose: world (x, y, theta) of the base: metres, metres, radians.
            cells: side of the patch in cells of this map.

        Returns:
            a map whose frame is the robot's: the base, centre of cell ``cells // 2``, is at (0, 0).

        Raises:
            InputError: if the pose is not three finite numbers or ``cells`` is not positive.
        """
        x, y, theta = _pose(pose)
        # Relative to cell centres, so that a base at the centre of its cell has whole-numbered coordinates.
        base = [(value - low) / self.resolution - 0.5 for value, low in zip((x, y), self.origin, strict=True)]
        cell = [float(_round(value)) for value in base]
        shift = [value - whole if abs(value - whole) > TIE else 0.0 for value, whole in zip(base, cell, strict=True)]
        dx, dy = patch_offsets(theta, _positive(cells), *shift)
        return self._patch(_gather(self.heights, cell[0] + dx, cell[1] + dy))

    def crop_cells(self, ix: int, iy: int, heading: int, cells: int = PATCH_CELLS) -> "HeightMap":
        """`crop` for a base at the centre of cell (ix, iy) with one of the 64 detailed headings."""
        dx, dy = patch_offsets(float(lattice.heading_angle(heading)), _positive(cells))
        return self._patch(_gather(self.heights, ix + dx, iy + dy))

    def rotate(self, angle: float) -> "HeightMap":
        """The map turned counter-clockwise by ``angle`` radians about its centre, which stays where it is.

        The result is large enough to hold the whole map; cells that nothing was turned into are NaN. At multiples of 90
        degrees this is an exact permutation of cells, at other angles each cell takes the height of the nearest one.
        """
        quarters = angle / (math.pi / 2)
        if abs(quarters - round(quarters)) < 1e-12:
            heights = np.rot90(self.heights, round(quarters))
        else:
            (x, y), c, s = self.shape, abs(math.cos(angle)), abs(math.sin(angle))
            shape = math.ceil(x * c + y * s - TIE), math.ceil(x * s + y * c - TIE)
            target = np.indices(shape) + 0.5 - np.reshape(shape, (2, 1, 1)) / 2
            source = np.tensordot(lattice.rotation(-angle), target, 1) + np.reshape(self.shape, (2, 1, 1)) / 2
            heights = _gather(self.heights, *np.floor(source + TIE))
        origin = np.asarray(self.center) - np.asarray(heights.shape) / 2 * self.resolution
        return HeightMap(heights, tuple(origin), self.resolution)

    def _patch(self, heights: np.ndarray) -> "HeightMap":
        corner = -(len(heights) // 2 + 0.5) * self.resolution
        return HeightMap(heights, (corner, corner), self.resolution)


def crop_patches(
    heights: np.ndarray, bases: np.ndarray, headings, cells: int = PATCH_CELLS, out: np.ndarray | None = None
) -> np.ndarray:
    """Many patches at once, each equal to `HeightMap.crop_cells` at its base.

    Args:
        heights: float32 [nx, ny], metres.
        bases: int [n, 2], cells (ix, iy) at whose centres the bases stand; they may lie outside the map.
        headings: int [n], or one for all: detailed headings, index in [0, 64).
        cells: side of the patches.
        out: float32 [n, cells, cells] to write to; memory used again is several times faster than new memory.

    Returns:
        float32 [n, cells, cells], NaN outside the map; ``out`` if given.
    """
    heights = np.ascontiguousarray(heights, dtype=np.float32)
    bases = np.ascontiguousarray(bases, dtype=np.int64)
    if heights.ndim != 2 or bases.ndim != 2 or bases.shape[1] != 2:
        raise InputError(f"crop_patches: heights {heights.shape} and bases {bases.shape}; need [nx, ny] and [n, 2]")
    headings = np.broadcast_to(np.mod(np.asarray(headings, np.int64), lattice.HEADINGS), len(bases))
    shape = (len(bases), _positive(cells), cells)
    patches = np.empty(shape, np.float32) if out is None else out
    if patches.shape != shape or patches.dtype != np.float32 or not patches.flags.c_contiguous:
        raise InputError(f"crop_patches: out is {patches.dtype} {patches.shape}; need contiguous float32 {shape}")
    _crop_kernel(*map(_read_only, (heights, bases, headings.copy(), _offsets_of_headings(cells))), patches)
    return patches


def patch_offsets(theta: float, cells: int = PATCH_CELLS, shift_x: float = 0.0, shift_y: float = 0.0):
    """Offsets (dx, dy) in map cells, float64 [cells, cells] of whole numbers, from the base's cell to each patch cell.

    ``shift_x, shift_y`` (in cells) is where the base stands relative to the centre of its cell. Halves are rounded away
    from zero, so that without a shift a quarter turn of the patch turns the offsets exactly.
    """
    steps = np.arange(cells) - cells // 2
    rotation = lattice.rotation(theta)
    return tuple(
        _round(row[0] * steps[:, None] + row[1] * steps[None, :] + shift)
        for row, shift in zip(rotation, (shift_x, shift_y), strict=True)
    )


@functools.lru_cache(maxsize=8)
def _offsets_of_headings(cells: int) -> np.ndarray:
    """int32 [64, 2, cells, cells]: `patch_offsets` of every detailed heading."""
    angles = lattice.heading_angle(np.arange(lattice.HEADINGS))
    return np.array([patch_offsets(float(angle), cells) for angle in angles]).astype(np.int32)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _crop_kernel(heights, bases, headings, offsets, patches):
    nx, ny = heights.shape
    n, side, _ = patches.shape
    flat = heights.reshape(-1)
    # Where all of a patch lies on the map, one flat offset per cell is enough.
    flat_offsets = offsets[:, 0] * np.int32(ny) + offsets[:, 1]
    # No rotated patch cell is further than this from the base in x or in y.
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


def _pointcloud():
    # By name and not by an import statement: labels depend on all that this module imports (`hdsp.base.provenance`), and no
    # label depends on how points become maps.
    return importlib.import_module("hdsp.terrain.pointcloud")


def _round(values):
    """Nearest whole numbers, as floats; halves (up to `TIE`) go away from zero."""
    values = np.asarray(values, dtype=float)
    return np.copysign(np.floor(np.abs(values) + (0.5 + TIE)), values)


def _gather(heights: np.ndarray, ix, iy) -> np.ndarray:
    """Heights of cells given as whole-numbered floats; NaN outside, and where a coordinate is NaN."""
    ix, iy = np.broadcast_arrays(ix, iy)
    inside = (ix >= 0) & (ix < heights.shape[0]) & (iy >= 0) & (iy < heights.shape[1])
    taken = np.full(inside.shape, np.nan, np.float32)
    taken[inside] = heights[ix[inside].astype(np.int64), iy[inside].astype(np.int64)]
    return taken


def _pose(pose) -> tuple[float, float, float]:
    try:
        x, y, theta = (float(value) for value in pose)
    except (TypeError, ValueError):
        raise InputError(f"pose {pose!r}; need three numbers (x, y, theta): metres, metres, radians") from None
    if not all(math.isfinite(value) for value in (x, y, theta)):
        raise InputError(f"pose {(x, y, theta)}; need finite x, y and theta")
    return x, y, theta


def _read_only(array: np.ndarray) -> np.ndarray:
    """The same array, not to be written to: numba compiles once per mutability, so one kind is passed always."""
    view = array.view()
    view.flags.writeable = False
    return view


def _positive(cells: int) -> int:
    if cells < 1:
        raise InputError(f"patch of {cells} cells; need at least 1")
    return cells
