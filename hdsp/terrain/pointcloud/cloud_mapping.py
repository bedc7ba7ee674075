"""From a levelled cloud to a height map: no overhangs, small holes filled, noise smoothed, all other cells unknown."""

from __future__ import annotations

from dataclasses import field
from typing import NamedTuple, Self

import numpy as np
from pydantic import model_validator

from hdsp.base.errors import InputError
from hdsp.base.settings import Natural, NotNegative, Positive, checked, fault
from hdsp.robot.lattice import RESOLUTION
from hdsp.terrain.filling import filled, smoothed
from hdsp.terrain.pointcloud.alignment import FloorSettings, Plane, fit_floor, level, thinned

_LARGEST_MAP = 100_000_000  # cells; a larger scan is probably not in metres
_SMALLEST_EXTENT = 0.2  # m
_GREATEST_RELIEF = 10_000.0  # m


@checked
class MapSettings:
    """Settings for the conversion from points to heights.

    Attributes:
        level: whether the cloud is first levelled on its floor.
        floor: settings for floor detection.
        box: (x_min, y_min, x_max, y_max) in m after levelling; points outside are dropped. None = all points are kept.
        lowest, highest: m above the floor; points outside are dropped: reflections below the floor, ceilings above it.
        headroom: m; points above a vertical gap this large are dropped: lintels, table tops.
        surface: m; a cell's height is the mean over its points at most this far below its highest point.
        neighbours, near: points with fewer than ``neighbours`` other points within ``near`` m are dropped. 0 = none.
        fill: cells; holes closed by a disc with this radius are filled from the nearest known cells. 0 = none.
        smooth: m; after a 3 x 3 median, each height becomes the mean over the heights within 5 x 5 cells that differ by
            less than this. Edges are kept. 0 = no smoothing.
        island: cells; smaller connected regions of known cells become unknown.

    Raises:
        InputError: if a value is out of range.
    """

    level: bool = True
    floor: FloorSettings = field(default_factory=FloorSettings)
    box: tuple[float, float, float, float] | None = None
    lowest: float = -0.5
    highest: float = 1.9
    headroom: Positive = 1.2
    surface: Positive = 0.05
    neighbours: Natural = 3
    near: NotNegative = 0.1
    fill: Natural = 3
    smooth: NotNegative = 0.03
    island: Natural = 40

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.lowest < self.highest:
            raise fault("lowest", self.lowest, f"less than highest, {self.highest:g} m")
        if self.box is not None and not (self.box[0] < self.box[2] and self.box[1] < self.box[3]):
            raise fault("box", self.box, "x_min, y_min, x_max, y_max")
        return self


class MappingReport(NamedTuple):
    """Report on the conversion of a cloud to a map.

    Attributes:
        points: number of finite points in the cloud.
        kept: number of points after cuts, thinning and removal of lone points.
        floor: plane used to level the cloud; None = no levelling.
        filled: share of known cells without own points.
    """

    points: int
    kept: int
    floor: Plane | None
    filled: float

    def __str__(self) -> str:
        floor = "" if self.floor is None else f"; floor tilted by {np.rad2deg(self.floor.tilt):.1f} degrees, levelled"
        return f"{self.kept:,} of {self.points:,} points{floor}; {100 * self.filled:.0f}% of the known cells filled"


class MappedCloud(NamedTuple):
    """A height map made from a cloud, as arrays.

    Attributes:
        heights: float32 [nx, ny], m, NaN = unknown; the smallest rectangle with all known cells. The floor is at 0 if
            the cloud was levelled.
        origin: lower corner (x, y) of cell (0, 0) in the frame of the levelled cloud, m; a multiple of the resolution.
        resolution: cell size, m.
        report: report on the conversion.
    """

    heights: np.ndarray
    origin: tuple[float, float]
    resolution: float
    report: MappingReport


def map_points(points: np.ndarray, settings: MapSettings | None = None, resolution: float = RESOLUTION) -> MappedCloud:
    """Converts a cloud to heights; `hdsp.HeightMap.from_points` makes a map from them.

    Args:
        points: float [n, 3], m, z up; points that are not finite are dropped.
        settings: settings for the conversion.
        resolution: cell size, m.

    Raises:
        InputError: if no point is left, or the extent is implausible for metres.
    """
    settings = settings or MapSettings()
    points = _finite(points)
    given, floor = len(points), None
    _check_extent(points, resolution)
    if settings.level:
        floor = fit_floor(points, settings.floor)
        points = level(points, floor)
    points = _cut(points, settings)
    if len(points) == 0:
        raise InputError("height map of points: none is left in the box, between lowest and highest; check the axes")
    _check_extent(points, resolution)
    points = thinned(points, resolution / 2)  # dense scans have many more points than the map needs
    points = _without_lone_points(points, settings)
    cells = np.floor(points[:, :2] / resolution + 1e-6).astype(np.int64)
    low = cells.min(axis=0)
    measured = _surface(cells - low, points[:, 2], settings)
    heights = smoothed(filled(measured, settings.fill), settings.smooth)
    heights = _without_islands(heights, settings.island)
    known = np.isfinite(heights)
    share = float((known & np.isnan(measured)).sum() / known.sum())
    heights, shift = _trimmed(heights)
    x, y = ((low + shift) * resolution).tolist()
    report = MappingReport(given, len(points), floor, share)
    return MappedCloud(heights.astype(np.float32), (x, y), resolution, report)


def _finite(points: np.ndarray) -> np.ndarray:
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"points have shape {points.shape}; need [n, 3]: x, y, z in metres")
    finite = points[np.isfinite(points).all(axis=1)]
    if len(finite) == 0:
        raise InputError(f"height map of points: none of {len(points)} points is finite")
    return finite


def _check_extent(points: np.ndarray, resolution: float) -> None:
    extent = np.ptp(points[:, :2], axis=0)
    if extent.max() < _SMALLEST_EXTENT:
        raise InputError(f"points span {extent[0]:.3g} x {extent[1]:.3g} m: are they in metres? see the option units")
    if np.ptp(points[:, 2]) > _GREATEST_RELIEF:
        raise InputError(
            f"points span {np.ptp(points[:, 2]):.3g} m in height: are they in metres? see the option units"
        )
    if np.prod(extent / resolution) > _LARGEST_MAP:
        raise InputError(
            f"points span {extent[0]:.4g} x {extent[1]:.4g} m, more than {_LARGEST_MAP:,} cells of {resolution} m: are "
            "they in metres (option units)? or cut a box out of them"
        )


def _cut(points: np.ndarray, settings: MapSettings) -> np.ndarray:
    keep = (points[:, 2] >= settings.lowest) & (points[:, 2] <= settings.highest)
    if settings.box:
        keep &= (points[:, :2] >= settings.box[:2]).all(axis=1) & (points[:, :2] <= settings.box[2:]).all(axis=1)
    return points[keep]


def _without_lone_points(points: np.ndarray, settings: MapSettings) -> np.ndarray:
    if settings.neighbours == 0:
        return points
    from scipy.spatial import cKDTree

    distance = cKDTree(points).query(points, settings.neighbours + 1, distance_upper_bound=settings.near)[0]
    company = np.isfinite(distance[:, -1])
    if not company.any():
        raise InputError(
            f"no point has {settings.neighbours} others within {settings.near} m: too sparse, or not in metres"
        )
    return points[company]


def _surface(cells: np.ndarray, z: np.ndarray, settings: MapSettings) -> np.ndarray:
    """Heights float64 [nx, ny] from cells int64 [n, 2] >= 0 and heights [n] of points; NaN for cells without points."""
    shape = tuple(cells.max(axis=0) + 1)
    flat = np.ravel_multi_index(cells.T, shape)
    order = np.lexsort((z, flat))
    flat, z = flat[order], z[order]
    # Points in a column are sorted by height; all points below the first gap with headroom are ground.
    first = np.diff(flat, prepend=-1) > 0
    gaps = np.cumsum((np.diff(z, prepend=z[0]) > settings.headroom) & ~first)
    ground = gaps == gaps[first][np.cumsum(first) - 1]
    flat, z = flat[ground], z[ground]
    top = np.full(shape[0] * shape[1], -np.inf)
    np.maximum.at(top, flat, z)
    upper = z >= top[flat] - settings.surface
    count = np.bincount(flat[upper], minlength=len(top))
    total = np.bincount(flat[upper], z[upper], minlength=len(top))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(shape)


def _without_islands(heights: np.ndarray, least: int) -> np.ndarray:
    from scipy.ndimage import label

    parts, count = label(np.isfinite(heights), np.ones((3, 3)))
    sizes = np.bincount(parts.ravel(), minlength=count + 1)
    large = sizes >= least
    if not large[1:].any():
        raise InputError(f"height map of points: no {least} known cells are connected; too sparse for these cells")
    return np.where(large[parts], heights, np.nan)


def _trimmed(heights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smallest rectangle with all known cells, and its lower corner."""
    known = np.argwhere(np.isfinite(heights))
    low, high = known.min(axis=0), known.max(axis=0) + 1
    return heights[low[0] : high[0], low[1] : high[1]], low
