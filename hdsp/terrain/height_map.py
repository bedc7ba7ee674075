"""Height maps: cropping in the robot frame, rotation, loading and saving.

Convention: ``heights[ix, iy]``, axis 0 is x, axis 1 is y. Cell ``(ix, iy)`` covers ``origin + [ix, ix + 1) *
resolution`` (the same in y), and its centre is at ``+ 0.5``. Heights are float32 metres, NaN = unknown.
`hdsp.terrain.patches` defines the convention for patches, squares of a map in the robot frame.
"""

import math
import os
import warnings
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, overload

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.messages import shown
from hdsp.base.notebook import html_of, png_of
from hdsp.base.scalars import integers, real
from hdsp.base.short_repr import short_repr
from hdsp.robot import lattice
from hdsp.robot.lattice import PATCH_CELLS, RESOLUTION
from hdsp.terrain.conditioning import ConditioningReport, Stages, is_conditioned
from hdsp.terrain.map_filters import UNCHANGED, ConditioningSettings
from hdsp.terrain.map_formats import MAP_SUFFIXES, MapFields, ReadOptions, is_map, read_map, write_map
from hdsp.terrain.map_frame import MapFrame
from hdsp.terrain.no_data import coarse_steps, implausible_heights, outlying_heights, unmasked
from hdsp.terrain.patches import TIE, checked_side, gather, nearest_cell, patch_offsets
from hdsp.terrain.pointcloud.cloud_files import FORMATS, read_points
from hdsp.terrain.pointcloud.cloud_mapping import MapSettings, map_points

_LONGEST = 100_000_000  # cells along one axis


@dataclass(frozen=True, eq=False)
class HeightMap:
    """A rectangular grid of heights.

    Attributes:
        heights: float32 [nx, ny], metres, NaN = unknown; a read-only copy of the argument. The masked cells of a masked
            array are unknown.
        origin: world position (x, y) of the lower corner of cell (0, 0), metres.
        resolution: cell size, metres.
        frame: relation between the map and the file or cloud from which it was made.

    Raises:
        InputError: if the heights are not a 2D array of finite or NaN numbers, or the resolution is not positive.

    Warns:
        UserWarning: heights are float16 with steps of more than 1 cm.

    Example:
        >>> import numpy as np
        >>> terrain = HeightMap(np.zeros((80, 40)), origin=(1.0, 2.0), resolution=0.05)
        >>> terrain.size
        (4.0, 2.0)
    """

    heights: np.ndarray
    origin: tuple[float, float] = (0.0, 0.0)
    resolution: float = RESOLUTION
    frame: MapFrame = field(default_factory=MapFrame)

    def __post_init__(self):
        try:
            if coarse := coarse_steps(self.heights):
                warnings.warn(f"height map: {coarse}", stacklevel=3)
            given = np.asarray(unmasked(self.heights))
            if given.dtype.kind not in "iufO":
                raise InputError(f"height map: heights have the type {given.dtype}; need numbers in metres")
            with np.errstate(over="ignore"):  # a float64 too large for float32 becomes inf and is rejected below
                heights = np.array(given, dtype=np.float32, order="C")
            origin = tuple(real(value) for value in self.origin)
        except (TypeError, ValueError, OverflowError) as error:
            raise InputError(f"height map: {error}; need a 2D array, an origin (x, y) and a resolution") from None
        if heights.ndim != 2 or heights.size == 0:
            raise InputError(f"height map: heights have shape {heights.shape}; need two axes, both at least 1 long")
        if np.isinf(heights).any():
            cell = tuple(int(index) for index in np.argwhere(np.isinf(heights))[0])
            raise InputError(f"height map: height of cell {cell} is infinite; need finite heights, or NaN for unknown")
        if len(origin) != 2 or not np.isfinite(origin).all():
            raise InputError(f"height map: origin is {shown(self.origin)}; need two finite numbers (x, y) in metres")
        if not 0 < (resolution := real(self.resolution)) < math.inf:
            given = shown(self.resolution)
            raise InputError(f"height map: resolution is {given}; need a positive number of metres per cell")
        heights.flags.writeable = False
        for name, value in (("heights", heights), ("origin", origin), ("resolution", resolution)):
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        (nx, ny), (length, width) = self.shape, self.size
        text = f"{nx} x {ny} cells of {self.resolution:g} m, {length:.2f} x {width:.2f} m from "
        text += f"({self.origin[0]:.2f}, {self.origin[1]:.2f})"
        known = np.isfinite(self.heights)
        if not known.all():
            text += f", {100 * (1 - known.mean()):.3g}% unknown"
        if known.any():
            heights = self.heights[known]
            text += f", heights {heights.min():z.2f} to {heights.max():z.2f} m"
        return f"HeightMap({text})"

    def _repr_html_(self) -> str | None:
        return html_of(self)

    def _repr_png_(self) -> bytes | None:
        return png_of(self)

    @classmethod
    def flat(cls, shape: tuple[int, int], origin=(0.0, 0.0), resolution: float = RESOLUTION) -> "HeightMap":
        """Makes a map of ``shape`` (nx, ny) cells with all heights 0."""
        sides = integers(shape, 2)
        if sides is None or min(sides) < 1 or max(sides) > _LONGEST:
            need = f"two whole numbers of cells, from 1 to {_LONGEST:,}"
            raise InputError(f"height map: shape is {shown(shape)}; need {need}")
        return cls(np.zeros(sides, np.float32), origin, resolution)

    @classmethod
    def load(cls, path: str | os.PathLike, **options: Any) -> "HeightMap":
        """Loads a height map file, or makes a map from a point file in metres, z up. The suffix selects the format.

        - .npz, .h5, .hdf5 (from `save`, or other arrays [nx, ny]), .npy: numpy and h5py
        - .tif, .tiff, .asc, .dem, .img: rasters by rasterio; CRS, masks and no-data values count
        - .png, .pgm: grey values as heights; the first row is the upper edge (largest y)
        - .bag, .db3, .mcap, the folder of a ROS 2 bag: messages of grid_map_msgs/GridMap
        - point files (`hdsp.terrain.pointcloud.FORMATS`): see `from_points`. For other units, other axes or a
          cut, use `hdsp.terrain.pointcloud.read_points` and `from_points`.

        Infinite heights and obvious no-data values become unknown; ``frame.notes`` says so.

        Args:
            path: a file, or the folder of a ROS 2 bag.
            options: facts that the file lacks, and choices (`hdsp.terrain.map_formats.ReadOptions`): ``resolution`` (m)
                and ``origin`` (x, y) for arrays and images; ``scale`` (m per unit or grey step), ``offset`` (m) and
                ``nodata`` for all; ``layer`` (layer, band or entry), ``topic``, ``message`` (index, default the last).

        Raises:
            InputError: if the file is missing or damaged, has another format, needs an option or a library, or contains
                no valid map.
        """
        chosen = ReadOptions.of(options)
        if not is_map(path):
            return cls._of_points(path, chosen)
        fields = read_map(path, chosen)
        try:
            return cls(fields.heights, fields.origin, fields.resolution, fields.frame)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None

    @classmethod
    def _of_points(cls, path: str | os.PathLike, options: ReadOptions) -> "HeightMap":
        check_readable(path)
        for name in options.given:
            if name != "resolution":
                raise InputError(f"point cloud {path}: option {name} does not apply; need resolution or none")
        resolution = RESOLUTION if options.resolution is None else options.resolution
        return cls.from_points(read_points(path), resolution=resolution)

    @classmethod
    def from_points(
        cls, points: np.ndarray, settings: MapSettings | None = None, resolution: float = RESOLUTION
    ) -> "HeightMap":
        """Makes a map from a point cloud: levelled if the sensor was tilted, without ceilings, small holes filled.

        The frame of the map keeps the way back to the cloud, and notes on everything that was left out or levelled.

        Args:
            points: float [n, 3], m, z roughly up; points that are not finite are dropped.
            settings: settings for the conversion; None = defaults.
            resolution: cell size, m.

        Returns:
            the smallest map with all known cells, see `hdsp.terrain.pointcloud.MappedCloud`.

        Raises:
            InputError: if no floor is found, no point is left, x or y seems to be up, or the extent is implausible for
                metres.

        Warns:
            UserWarning: if another axis than z may be up.
        """
        mapped = map_points(points, settings, resolution)
        for doubt in mapped.report.doubts:
            warnings.warn(f"height map of points: {doubt}", stacklevel=2)
        frame = MapFrame(to_source=mapped.to_source, notes=mapped.report.notes)
        return cls(mapped.heights, mapped.origin, mapped.resolution, frame)

    def save(self, path: str | os.PathLike) -> Path:
        """Saves the map; the suffix selects the format: .npz, .h5 / .hdf5, or .tif / .tiff (GeoTIFF).

        Raises:
            InputError: if no writer has the suffix, a library is missing, or the path is not writable.
        """
        write_map(path, MapFields(self.heights, self.origin, self.resolution, self.frame))
        return Path(path)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of cells (nx, ny)."""
        return self.heights.shape

    @property
    def size(self) -> tuple[float, float]:
        """Extent (x, y) in metres."""
        return self.shape[0] * self.resolution, self.shape[1] * self.resolution

    @property
    def center(self) -> tuple[float, float]:
        """World position of the map's middle in metres."""
        return self.origin[0] + self.size[0] / 2, self.origin[1] + self.size[1] / 2

    @overload
    def height_at(self, x: float, y: float) -> float: ...

    @overload
    def height_at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray: ...

    def height_at(self, x, y):
        """Height at world position(s) (x, y) in metres; NaN outside the map and where unknown.

        Example:
            >>> terrain = HeightMap([[0.0, 0.1], [0.2, 0.3]], resolution=1.0)
            >>> float(terrain.height_at(1.5, 0.5)), float(terrain.height_at(5.0, 0.5))
            (0.20000000298023224, nan)
        """
        ix, iy = (
            np.floor((np.asarray(value, float) - low) / self.resolution + TIE)
            for value, low in zip((x, y), self.origin, strict=True)
        )
        return gather(self.heights, ix, iy)[()]

    def crop(self, pose, cells: int = PATCH_CELLS) -> "HeightMap":
        """Crops a square of ``cells`` x ``cells`` around a pose, in the robot frame (convention:
        `hdsp.terrain.patches`).

        At headings that are multiples of 90 degrees, cropping permutes cells exactly.

        Args:
            pose: world pose (x, y, theta) of the base: metres, metres, radians.
            cells: side length in cells.

        Returns:
            a map in the robot frame: the base, at the centre of cell ``cells // 2``, is at (0, 0).

        Raises:
            InputError: if the pose is not three finite numbers, or ``cells`` is not positive.
        """
        x, y, theta = _pose(pose)
        # Relative to cell centres: a base at the centre of its cell has integer coordinates.
        base = [(value - low) / self.resolution - 0.5 for value, low in zip((x, y), self.origin, strict=True)]
        cell = [float(nearest_cell(value)) for value in base]
        shift = [value - whole if abs(value - whole) > TIE else 0.0 for value, whole in zip(base, cell, strict=True)]
        dx, dy = patch_offsets(theta, checked_side(cells), *shift)
        return self._patch(gather(self.heights, cell[0] + dx, cell[1] + dy), (x, y), theta)

    def crop_cells(self, ix: int, iy: int, heading: int, cells: int = PATCH_CELLS) -> "HeightMap":
        """Crops as `crop`, for a base at the centre of cell (ix, iy) with one of the 64 detailed headings."""
        theta = float(lattice.heading_angle(heading))
        dx, dy = patch_offsets(theta, checked_side(cells))
        base = np.asarray(self.origin) + (np.array((ix, iy)) + 0.5) * self.resolution
        return self._patch(gather(self.heights, ix + dx, iy + dy), base, theta)

    def rotate(self, angle: float) -> "HeightMap":
        """Rotates the map counter-clockwise by ``angle`` radians about its centre, which keeps its position.

        The result contains the whole map; cells without a source are NaN. Multiples of 90 degrees permute cells
        exactly; at other angles, each cell takes the nearest cell's height. The frame leads to the same source.

        Raises:
            InputError: if the angle is no finite number.
        """
        (angle,) = _finite("angle", angle, "a finite number of radians", 1)
        quarters = angle / (math.pi / 2)
        if abs(quarters - round(quarters)) < 1e-12:
            heights = np.rot90(self.heights, round(quarters))
        else:
            (x, y), c, s = self.shape, abs(math.cos(angle)), abs(math.sin(angle))
            shape = math.ceil(x * c + y * s - TIE), math.ceil(x * s + y * c - TIE)
            target = np.indices(shape) + 0.5 - np.reshape(shape, (2, 1, 1)) / 2
            source = np.tensordot(lattice.rotation(-angle), target, 1) + np.reshape(self.shape, (2, 1, 1)) / 2
            heights = gather(self.heights, *np.floor(source + TIE))
        center, back = np.asarray(self.center), lattice.rotation(-angle)
        origin = center - np.asarray(heights.shape) / 2 * self.resolution
        frame = self.frame.on_axes(back, center - back @ center)
        return HeightMap(heights, tuple(origin), self.resolution, frame)

    def conditioned(self, settings: ConditioningSettings | None = None) -> "Conditioned":
        """Conditions the map for planning: cells of 0.025 m without noise, spikes, and small holes.

        `hdsp.terrain.conditioning` describes the stages. A map without any of these faults keeps its heights to the
        last bit, and a conditioned map is returned as it is.

        Args:
            settings: settings of the conditioning; None = defaults.

        Returns:
            The map with the same origin, and a report. ``frame.notes`` of the map says what was done.

        Raises:
            InputError: if the cells are too coarse or too fine for planning.

        Example:
            >>> import numpy as np
            >>> heights = np.zeros((80, 80))
            >>> heights[40, 40] = np.nan
            >>> terrain, report = HeightMap(heights, resolution=0.05).conditioned()
            >>> terrain.shape, report.filled
            ((160, 160), 1)
        """
        stages = self.stages(settings)
        return Conditioned(self.with_heights(stages.result, RESOLUTION, stages.report.notes), stages.report)

    def stages(self, settings: ConditioningSettings | None = None) -> Stages:
        """Stages of the conditioning, for a map that changes; see `conditioned`."""
        return Stages(self.heights, self.resolution, UNCHANGED if is_conditioned(self.frame.notes) else settings)

    def with_heights(
        self, heights: np.ndarray, resolution: float | None = None, notes: tuple[str, ...] = ()
    ) -> "HeightMap":
        """Map with the same origin and frame, but other heights, and further notes in its frame.

        Args:
            heights: float32 [nx, ny], m, NaN = unknown.
            resolution: cell size, m; None = as before.
            notes: notes to add.
        """
        frame = replace(self.frame, notes=(*self.frame.notes, *notes)) if notes else self.frame
        return HeightMap(heights, self.origin, self.resolution if resolution is None else resolution, frame)

    def _patch(self, heights: np.ndarray, base, theta: float) -> "HeightMap":
        """Map in the frame of a robot at a base position."""
        corner = -(len(heights) // 2 + 0.5) * self.resolution
        frame = self.frame.on_axes(lattice.rotation(theta), np.asarray(base))
        return HeightMap(heights, (corner, corner), self.resolution, frame)


def as_height_map(terrain: "HeightMap | np.ndarray | str | os.PathLike", resolution: float | None = None) -> HeightMap:
    """Returns terrain in any form as a height map.

    Args:
        terrain: a height map, an array [nx, ny] of heights in m (NaN or masked = unknown), or the path of a file for
            `HeightMap.load`.
        resolution: cell size, m. An array needs it, and a file without a cell size of its own.

    Raises:
        InputError: an array without a resolution, a resolution beside a map that has one, or an invalid map.

    Warns:
        UserWarning: heights seem to be millimetres, or no-data values or other single values are amid them.
    """
    found = _converted(terrain, resolution)
    known = found.heights[np.isfinite(found.heights)].astype(float)
    for sign in implausible_heights(found.heights, found.resolution) or outlying_heights(known):
        warnings.warn(f"terrain: {sign}", stacklevel=3)
    return found


def check_readable(path: str | os.PathLike) -> None:
    """Refuses a path whose format is neither one of height maps nor one of point clouds.

    Raises:
        InputError: with the suffixes of both.
    """
    if is_map(path):
        return
    path = Path(path)
    if os.path.isdir(path):
        raise InputError(f"{path}: a folder without the metadata.yaml of a ROS 2 bag; need such a folder, or a file")
    if not {suffix.lower() for suffix in path.suffixes[-2:]} & {*FORMATS}:
        raise InputError(
            f"{path}: suffix {path.suffix!r}; need one of {', '.join(MAP_SUFFIXES)} (height maps) or "
            f"{', '.join(FORMATS)} (point clouds)"
        )


def _converted(terrain: "HeightMap | np.ndarray | str | os.PathLike", resolution: float | None) -> HeightMap:
    if isinstance(terrain, HeightMap):
        if resolution is not None and resolution != terrain.resolution:
            raise InputError(f"resolution is {resolution}, but the height map has cells of {terrain.resolution:g} m")
        return terrain
    if isinstance(terrain, str | os.PathLike):
        return HeightMap.load(terrain, **({} if resolution is None else {"resolution": resolution}))
    if not isinstance(terrain, np.ndarray | list | tuple):
        raise InputError(f"terrain is a {type(terrain).__name__}; need a HeightMap, an array of heights, or a path")
    if resolution is None:
        raise InputError("terrain is an array, which has no cell size; need resolution=, the side of a cell in metres")
    return HeightMap(terrain, resolution=resolution)


class Conditioned(NamedTuple):
    """A conditioned map, and the report on its conditioning."""

    terrain: HeightMap
    report: ConditioningReport

    def __repr__(self) -> str:
        return short_repr(self)


def conditioned(terrain: HeightMap, settings: ConditioningSettings | None = None) -> Conditioned:
    """Conditions a map for planning; the same as `HeightMap.conditioned`."""
    return terrain.conditioned(settings)


def _pose(pose) -> tuple[float, float, float]:
    x, y, theta = _finite("pose", pose, "three finite numbers (x, y, theta): metres, metres, radians", 3)
    return x, y, theta


def _finite(name: str, given, need: str, count: int) -> list[float]:
    """Returns finite numbers; an error with name and need for anything else."""
    try:
        found = [real(value) for value in (given if count > 1 else [given])]
    except TypeError:
        found = []
    if len(found) != count or not np.isfinite(found).all():
        raise InputError(f"{name} is {shown(given)}; need {need}")
    return found
