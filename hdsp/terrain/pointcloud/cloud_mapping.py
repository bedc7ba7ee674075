"""From a cloud to a height map: levelled if the sensor was tilted, no overhangs, small holes filled, noise smoothed.

Order: no-data values, cut around the box, lone points far away, extent, direction of gravity, levelling, box, heights.
The report names every step that dropped points or moved the cloud. Cells without points stay unknown.
"""

from __future__ import annotations

from dataclasses import field
from typing import Annotated, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from hdsp.base.errors import InputError
from hdsp.base.messages import shown, spans
from hdsp.base.scalars import real
from hdsp.base.settings import Natural, NotNegative, Positive, checked, fault, load_settings
from hdsp.robot.lattice import RESOLUTION
from hdsp.terrain.filling import filled, smoothed
from hdsp.terrain.pointcloud.alignment import FloorSettings, Plane, fit_floor, level, thinned, unlevelled
from hdsp.terrain.pointcloud.faults import Cleaned, check_extent, check_steps, without_far_points, without_no_data
from hdsp.terrain.pointcloud.gravity import Gravity, check_up, judge
from hdsp.terrain.pointcloud.ground import ground_below
from hdsp.terrain.pointcloud.point_arrays import point_array

_SMALLEST, _LARGEST = 1e-4, 1e4  # m, side of a cell, as in files
_MOST_UNDER = 0.1  # of the points, that may lie under a floor


@checked
class MapSettings:
    """Settings for the conversion from points to heights.

    Attributes:
        level: whether the cloud is levelled on its floor. True: always, so that the floor is the plane z = 0. False: z
            stays as it is. None: only a tilt of the sensor is removed, slopes stay (`hdsp.terrain.pointcloud.gravity`),
            and the floor below the middle of the cloud becomes z = 0.
        floor: settings for floor detection.
        check_up: whether a cloud whose x or y seems to point up is refused; for ``level`` None only.
        box: (x_min, y_min, x_max, y_max) in m after levelling; points outside are dropped. None = all points are kept.
        lowest, highest: m above the floor; points outside are dropped: reflections below the floor, ceilings above it.
            With ``level`` None, above the ground nearby, so that hills and stairs stay; with False, above z = 0.
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

    level: bool | None = None
    floor: FloorSettings = field(default_factory=FloorSettings)
    check_up: bool = True
    box: tuple[float, float, float, float] | None = None
    lowest: float = -0.5
    highest: float = 1.9
    headroom: Positive = 1.2
    surface: Positive = 0.05
    neighbours: Natural = 3
    near: NotNegative = 0.1
    fill: Annotated[int, Field(ge=0, le=1000)] = 3
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
        notes: what was left out, cut, levelled or kept, one phrase each.
        doubts: what a user should check, as an axis that may be up; also in the notes.
    """

    points: int
    kept: int
    floor: Plane | None
    filled: float
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    def __str__(self) -> str:
        notes = [note for note in self.notes if note not in self.doubts]
        parts = [f"{self.kept:,} of {self.points:,} points", *notes]
        return f"{'; '.join(parts)}; {100 * self.filled:.0f}% of the known cells filled"


class MappedCloud(NamedTuple):
    """A height map made from a cloud, as arrays.

    Attributes:
        heights: float32 [nx, ny], m, NaN = unknown; the smallest rectangle with all known cells. The floor is at 0 if
            the cloud was levelled.
        origin: lower corner (x, y) of cell (0, 0) in the frame of the levelled cloud, m; a multiple of the resolution.
        resolution: cell size, m.
        report: report on the conversion.
        to_source: float64 [4, 4], rigid motion from the frame of the map to the frame of the cloud, m.
    """

    heights: np.ndarray
    origin: tuple[float, float]
    resolution: float
    report: MappingReport
    to_source: np.ndarray


def map_points(points: np.ndarray, settings: MapSettings | None = None, resolution: float = RESOLUTION) -> MappedCloud:
    """Converts a cloud to heights; `hdsp.HeightMap.from_points` makes a map from them.

    Args:
        points: float [n, 3], m, z up; points that are not finite are dropped.
        settings: settings for the conversion.
        resolution: cell size, m.

    Raises:
        InputError: if points or settings are invalid, no point is left, the extent is implausible for metres,
            coordinates lost their decimals as float32, no floor is found, z is not up, or the resolution is no number
            from 0.0001 to 10,000.
    """
    side = real(resolution)
    if not _SMALLEST <= side <= _LARGEST:
        raise InputError(f"resolution is {shown(resolution)}; need {_SMALLEST:g} to {_LARGEST:g} metres per cell")
    resolution = side
    settings = MapSettings() if settings is None else load_settings(MapSettings, settings, "settings")
    points = _finite(points)
    given = len(points)
    points, notes = cleaned(points, settings.box)
    check_extent(points, resolution)
    check_steps(points, resolution)
    points, floor, to_source, more, doubts = _levelled(points, settings)
    before = len(points)
    points, cuts, under = _cut(points, settings)
    if settings.level is None and settings.check_up and under > _MOST_UNDER * before:
        doubts = (*doubts, f"{under / before:.0%} of the points lie under the floor: is z up? see the option axes")
    if len(points) == 0:
        raise InputError("height map of points: none is left in the box, between lowest and highest; check the axes")
    check_extent(points, resolution)
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
    report = MappingReport(given, len(points), floor, share, (*notes, *more, *cuts, *doubts), doubts)
    return MappedCloud(heights.astype(np.float32), (x, y), resolution, report, to_source)


def cleaned(points: np.ndarray, box: tuple[float, float, float, float] | None = None) -> Cleaned:
    """Leaves out no-data values, points far outside the box, and lone points far away.

    The margin around the box is its diagonal, at least 2 m, because the box is meant after levelling.

    Args:
        points: float64 [n, 3], m, finite.
        box: (x_min, y_min, x_max, y_max), m.

    Raises:
        InputError: if no point is left.
    """
    points, no_data = without_no_data(points)
    if box is not None and len(points):
        low, high = np.array(box[:2]), np.array(box[2:])
        margin = max(2.0, float(np.hypot(*(high - low))))
        near = ((points[:, :2] > low - margin) & (points[:, :2] < high + margin)).all(axis=1)
        if not near.any():
            extent = spans(points[:, :2].min(axis=0), points[:, :2].max(axis=0))
            raise InputError(f"height map of points: none is left in the box {box}; they span {extent} m")
        points = points[near]
    points, far = without_far_points(points)
    if len(points) == 0:
        raise InputError(f"height map of points: no point is left: {'; '.join((*no_data, *far))}")
    return Cleaned(points, (*no_data, *far))


class _Levelled(NamedTuple):
    points: np.ndarray
    floor: Plane | None
    to_source: np.ndarray
    notes: tuple[str, ...]
    doubts: tuple[str, ...] = ()


def _levelled(points: np.ndarray, settings: MapSettings) -> _Levelled:
    if settings.level is False:
        return _Levelled(points, None, np.eye(4), ())
    if settings.level:
        floor = fit_floor(points, settings.floor)
        return _Levelled(level(points, floor), floor, unlevelled(points, floor), (about_tilt(floor),))
    doubt = check_up(points, settings.floor) if settings.check_up else ""
    found = judge(points, settings.floor)
    notes, doubts = (about_gravity(found),), (doubt,) if doubt else ()
    if found.tilted:
        floor = found.floor
        return _Levelled(level(points, floor), floor, unlevelled(points, floor), notes, doubts)
    x, y = points[:, :2].mean(axis=0)
    floor = found.floor
    to_source = np.eye(4)
    to_source[2, 3] = (floor.offset - floor.normal[:2] @ (x, y)) / floor.normal[2]
    return _Levelled(points - to_source[:3, 3], None, to_source, notes, doubts)


def about_tilt(floor: Plane) -> str:
    """A phrase on a floor that was levelled."""
    return f"floor tilted by {np.rad2deg(floor.tilt):.1f} degrees, levelled"


def about_gravity(found: Gravity) -> str:
    """A phrase on the inclination of a cloud's floor, and what is done about it."""
    if found.tilted:
        return about_tilt(found.floor) + (f": {found.why}" if found.why else "")
    degrees = np.rad2deg(found.ground.tilt)
    return (
        f"ground inclined by {degrees:.1f} degrees, kept: {found.why} (--max-tilt {np.ceil(degrees) + 1:.0f} levels it)"
    )


def _finite(points: np.ndarray) -> np.ndarray:
    points = point_array(points)
    finite = points[np.isfinite(points).all(axis=1)]
    if len(finite) == 0:
        raise InputError(f"height map of points: none of {len(points)} points is finite")
    return finite


def _cut(points: np.ndarray, settings: MapSettings) -> tuple[np.ndarray, tuple[str, ...], int]:
    """Points in the box between the lowest and the highest height, phrases on the others, and the number below."""
    if settings.box:
        inside = (points[:, :2] >= settings.box[:2]).all(axis=1) & (points[:, :2] <= settings.box[2:]).all(axis=1)
        points = points[inside]
    if len(points) == 0:
        return points, (), 0
    above = points[:, 2] - (ground_below(points, settings.floor.thickness) if settings.level is None else 0.0)
    low, high = above < settings.lowest, above > settings.highest
    notes = []
    if low.any():
        notes.append(f"{low.sum():,} points lower than {-settings.lowest:g} m under the ground dropped")
    if high.any():
        notes.append(f"{high.sum():,} higher than {settings.highest:g} m dropped")
    return points[~(low | high)], tuple(notes), int(low.sum())


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
