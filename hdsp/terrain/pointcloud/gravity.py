"""The direction of gravity in a cloud: which axis is up, and whether an inclined floor is a tilted sensor or a slope.

A tilted sensor tilts everything: walls stay perpendicular to the floor, and other horizontal surfaces (a ceiling, a
landing, table tops) stay parallel to it. On a slope, walls stay vertical and other surfaces level. Without such
evidence nothing tells the two apart, so only a small tilt is removed then.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hdsp.base.errors import InputError
from hdsp.terrain.pointcloud.alignment import FloorSettings, Plane, best_plane, lowest_plane, normals, thinned

#: rad; a floor tilted by less is levelled unless the cloud shows that it is a slope: ramps for people begin at 1:12.
SMALL_TILT = math.radians(4)
#: rad; below this, the angle between two planes does not tell a slope from a tilt.
_BLUNT = math.radians(1.5)
_STEEPEST = math.radians(20)  # rad, of other surfaces that are evidence
_HILL = math.radians(35)  # rad, of ground that is kept
_SURFACES = 5
_EVIDENCE = 0.08  # of the floor's support, that other surfaces need
_WALL_EVIDENCE, _WALL_VOXELS = 0.03, 60
_COVERAGE = 0.3  # of the cells in plan, that a floor covers
_CELL = 0.25  # m, in plan
_MOST_VOXELS = 60_000
_STOREY = 2.0, 3.6  # m, height of rooms
#: Axes for `read_points` after which this axis of the file is up.
_AXES_FOR_UP = {"y": "z,x,y", "-y": "z,-x,-y", "x": "y,z,x", "-x": "-y,z,-x", "-z": "x,-y,-z"}


class Gravity(NamedTuple):
    """Judgement on a cloud's floor.

    Attributes:
        floor: the plane that becomes z = 0.
        ground: the lowest large plane, which may be a slope; the floor if it is level.
        tilted: whether the floor's tilt comes from the sensor and is to be removed.
        why: the evidence, a phrase.
    """

    floor: Plane
    ground: Plane
    tilted: bool
    why: str


def judge(points: np.ndarray, settings: FloorSettings) -> Gravity:
    """Finds a cloud's floor, and whether its inclination is a tilt of the sensor or a slope.

    Args:
        points: float64 [n, 3], m, z roughly up.
        settings: settings for floor detection; steeper ground is no floor.

    Raises:
        InputError: if no nearly horizontal plane has enough points.
    """
    voxels = _some(thinned(points, settings.voxel))
    ground = _ground(voxels, settings, len(points))
    if ground.tilt < _BLUNT:
        return Gravity(ground, ground, True, "")
    level, parallel, flattest = _surfaces(voxels, ground, settings)
    walls = _walls(voxels, ground)
    covers = _coverage(voxels, ground, settings) >= _COVERAGE
    if ground.tilt > settings.max_tilt:
        return Gravity(ground, ground, False, f"more than {math.degrees(settings.max_tilt):.0f} degrees are no tilt")
    if walls == "vertical" or (level and walls != "perpendicular"):
        why = "walls are vertical" if walls == "vertical" else "other ground is level"
        return Gravity(flattest or ground, ground, False, why)
    if walls == "perpendicular" or (parallel and covers):
        why = "walls are perpendicular to it" if walls == "perpendicular" else "other surfaces are parallel to it"
        return Gravity(ground, ground, True, why)
    if ground.tilt <= SMALL_TILT and covers:
        return Gravity(ground, ground, True, "")
    why = "nothing shows that the sensor was tilted" if covers else "it is a small part of the view"
    return Gravity(ground, ground, False, why)


def _ground(voxels: np.ndarray, settings: FloorSettings, points: int) -> Plane:
    """The lowest large plane within the largest tilt, or a steeper one if that covers much more."""
    steep = replace(settings, max_tilt=max(settings.max_tilt, _HILL))
    try:
        ground = lowest_plane(voxels, settings, points)
    except InputError:
        hill = best_plane(voxels, steep, steep.max_tilt)
        if hill is None or _coverage(voxels, hill, settings) < _COVERAGE:
            raise
        return hill
    covered = _coverage(voxels, ground, settings)
    if covered < _COVERAGE:
        hill = best_plane(voxels, steep, steep.max_tilt)
        if hill is not None and _coverage(voxels, hill, settings) > max(_COVERAGE, 2 * covered):
            return hill
    return ground


def _some(voxels: np.ndarray) -> np.ndarray:
    if len(voxels) <= _MOST_VOXELS:
        return voxels
    return voxels[np.random.default_rng(0).choice(len(voxels), _MOST_VOXELS, replace=False)]


def _surfaces(voxels: np.ndarray, ground: Plane, settings: FloorSettings) -> tuple[bool, bool, Plane | None]:
    """Whether other surfaces are level, whether others are parallel to the ground, and the largest level one."""
    near = 0.3 * ground.tilt
    rest = voxels[np.abs(ground.heights(voxels)) > 2 * settings.thickness]
    level = parallel = 0
    flattest = None
    for _ in range(_SURFACES):
        plane = best_plane(rest, settings, _STEEPEST)
        if plane is None or plane.support < _EVIDENCE * ground.support:
            break
        if plane.tilt < near:
            level += plane.support
            flattest = flattest or plane
        elif math.acos(min(1.0, float(plane.normal @ ground.normal))) < near:
            parallel += plane.support
        rest = rest[np.abs(plane.heights(rest)) > 2 * settings.thickness]
    return level > parallel, parallel > level, flattest


def _walls(voxels: np.ndarray, ground: Plane) -> str:
    """ "vertical", "perpendicular" (to the ground), or "" if walls do not tell."""
    from scipy.spatial import cKDTree

    if len(voxels) < 30:
        return ""
    directions, flat = normals(voxels, cKDTree(voxels), 25)
    down = ground.normal[:2] / np.linalg.norm(ground.normal[:2])
    along = directions[:, :2] @ down
    upright = flat & (np.abs(directions[:, 2]) < 0.42) & (np.abs(along) > 0.4)
    count = int(upright.sum())
    if count < max(_WALL_VOXELS, _WALL_EVIDENCE * ground.support):
        return ""
    tilts = np.arctan(-directions[upright, 2] / along[upright])
    tilt = float(np.median(tilts))
    spread = 1.48 * float(np.median(np.abs(tilts - tilt)))
    share = tilt / ground.tilt
    if spread > max(0.06, 0.7 * ground.tilt):
        return ""
    return "vertical" if abs(share) < 0.35 else "perpendicular" if 0.65 < share < 1.35 else ""


def _coverage(voxels: np.ndarray, plane: Plane, settings: FloorSettings) -> float:
    """Share of the occupied cells in plan that the plane covers."""
    flat = _cells(voxels)
    on = np.abs(plane.heights(voxels)) < 2 * settings.thickness
    return len(np.unique(flat[on])) / len(np.unique(flat))


def _cells(voxels: np.ndarray) -> np.ndarray:
    """Number of the cell in plan for each voxel."""
    cells = np.floor(voxels[:, :2] / _CELL).astype(np.int64)
    cells -= cells.min(axis=0)
    return np.asarray(np.ravel_multi_index(cells.T, cells.max(axis=0) + 1))


def _camera(points: np.ndarray) -> str:
    """A phrase if the points fill the view of a camera at the origin that looks along z, as clouds of one image do."""
    for sign, axes in ((1, "z,-x,-y"), (-1, "-z,-x,y")):
        depth = sign * points[:, 2]
        near, third, far = np.quantile(depth, [0.02, 0.33, 0.67])
        if near < 0.1:
            continue
        aside = np.quantile(np.abs(points[:, :2]) / np.maximum(depth, near)[:, None], 0.99, axis=0)
        if aside.max() > 1.5 or aside.min() < 0.1:
            continue
        close, distant = depth <= third, depth >= far
        longer = float(np.median(depth[distant]) / np.median(depth[close]))
        wider = float(np.ptp(points[distant, 0]) / max(np.ptp(points[close, 0]), 1e-9))
        if longer > 1.4 and wider > 0.8 * longer:
            return (
                f"this looks like the view of a camera along {'-' if sign < 0 else ''}z; --axes={axes} makes its y up"
            )
    return ""


class _Slab(NamedTuple):
    """Largest plane across an axis.

    Attributes:
        support: its number of voxels.
        above: share of the other points on its upper side; with two opposite planes, beyond the middle between them.
        paired: whether another large plane is opposite, as a ceiling or a second wall.
    """

    support: int
    above: float
    paired: bool


def check_up(points: np.ndarray, settings: FloorSettings) -> str:
    """Checks that z is up.

    Returns:
        a phrase if another axis may be up; "" else.

    Raises:
        InputError: if another axis is up.
    """
    if camera := _camera(points):
        return camera
    voxels = _some(thinned(points, settings.voxel))
    extent = np.diff(np.quantile(voxels, [0.005, 0.995], axis=0), axis=0)[0]
    if extent[2] <= extent[:2].min():
        return _downward(voxels, settings)
    here = _slab(voxels, settings)
    found = []
    for axis, name in enumerate("xy"):
        if extent[axis] >= extent[2]:
            continue
        slab = _slab(np.roll(voxels, 2 - axis, axis=1), settings)
        if slab.support > 1.1 * here.support:
            storey = _STOREY[0] < extent[axis] < _STOREY[1]
            found.append((storey, slab.support, name if slab.above >= 0.5 else f"-{name}", slab))
    if not found:
        return ""
    largest = max(support for _, support, _, _ in found)
    storey, _, name, slab = max(one for one in found if one[1] > 0.3 * largest)
    times = slab.support / max(here.support, 1)
    hint = f"--axes={_AXES_FOR_UP[name]} makes it up, --axes=x,y,z keeps z"
    text = f"{name} may be up: the largest plane lies across {name[-1]}, {times:.1f} times as large as the one across z"
    alley = slab.paired and not here.paired
    # Between walls and under a ceiling, a storey's height tells a room from a hallway.
    room = storey and (extent[2] > _STOREY[1] if slab.paired else here.paired)
    lonely = slab.support > 0.3 * len(voxels) and here.support < 0.1 * len(voxels)
    if not alley and (lonely or room or (storey and times > 3)):
        raise InputError(f"{text}; {hint}")
    return f"{text}; {hint}"


def _slab(voxels: np.ndarray, settings: FloorSettings) -> _Slab:
    """Largest plane across the third axis."""
    plane = best_plane(voxels, settings, _STEEPEST)
    if plane is None:
        return _Slab(0, 0.5, False)
    heights = plane.heights(voxels)
    opposite = best_plane(voxels[np.abs(heights) > 1.0], settings, _STEEPEST)
    if opposite is None or opposite.support < 0.4 * plane.support:
        others = heights[np.abs(heights) > 0.1]
        return _Slab(plane.support, float((others > 0).mean()) if len(others) else 0.5, False)
    # Furniture is nearer to the floor than to the ceiling.
    between = voxels[(np.abs(heights) > 0.1) & (np.abs(opposite.heights(voxels)) > 0.1)]
    lower = between[:, 2] < (plane.offset + opposite.offset) / 2
    return _Slab(plane.support, float(lower.mean()) if len(lower) else 0.5, True)


def _downward(voxels: np.ndarray, settings: FloorSettings) -> str:
    """A phrase if everything lies below the lowest large plane, as with z down."""
    try:
        plane = lowest_plane(voxels, settings, len(voxels))
    except InputError:
        return ""
    heights = plane.heights(voxels)
    off = np.abs(heights) > 0.1
    if off.mean() < 0.02 or (heights[off] < 0).mean() < 0.98:
        return ""
    # Nobody sees under a floor: points below it in the same cells are walls and furniture of a cloud upside down.
    flat = _cells(voxels)
    if np.isin(flat[off], flat[~off]).mean() < 0.5:
        return ""
    return f"-z may be up: all other points lie below the floor; --axes={_AXES_FOR_UP['-z']} makes it up"
