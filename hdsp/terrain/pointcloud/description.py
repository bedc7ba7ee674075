"""Words on a cloud: its extents, all that looks wrong, and the map that would be made of it."""

from __future__ import annotations

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.settings import load_settings
from hdsp.robot.lattice import RESOLUTION
from hdsp.terrain.pointcloud.alignment import FloorSettings, Plane, fit_floor
from hdsp.terrain.pointcloud.cloud_mapping import MapSettings, about_gravity, about_tilt, cleaned
from hdsp.terrain.pointcloud.faults import check_extent, check_steps, millimetres
from hdsp.terrain.pointcloud.gravity import check_up, judge
from hdsp.terrain.pointcloud.point_arrays import finite_points

_SPACING_SAMPLE = 2000  # points


def describe_points(points: np.ndarray, settings: FloorSettings | None = None, level: bool = False) -> str:
    """Describes a cloud in one line: extents, faults, inclination, and the conversion to a map.

    Args:
        points: float [n, 3], m, finite.
        settings: settings for floor detection.
        level: whether the floor is levelled in any case.

    Returns:
        phrases, separated by semicolons.

    Raises:
        InputError: points or settings are invalid.
    """
    points = finite_points(points)
    settings = FloorSettings() if settings is None else load_settings(FloorSettings, settings, "settings")
    phrases = [f"{len(points)} points, {_spans(points)} m"]
    try:
        rest, notes = cleaned(points)
        phrases += notes
        if notes:
            phrases.append(f"without them {_spans(rest)} m")
        if suspicion := millimetres(rest):
            phrases.append(suspicion)
            return "; ".join(phrases)
        check_extent(rest, RESOLUTION)
        check_steps(rest, RESOLUTION)
        phrases += _ground(rest, settings, level)
    except InputError as error:
        phrases.append(str(error))
    return "; ".join(phrases)


def _spans(points: np.ndarray) -> str:
    low, high = points.min(axis=0), points.max(axis=0)
    ends = [[f"{value:.2f}" if abs(value) < 1e7 else f"{value:g}" for value in row] for row in (low, high)]
    return ", ".join(f"{name} {a} to {b}" for name, a, b in zip("xyz", *ends, strict=True))


def _ground(points: np.ndarray, settings: FloorSettings, level: bool) -> list[str]:
    from scipy.spatial import cKDTree

    few = points[np.random.default_rng(0).permutation(len(points))[:_SPACING_SAMPLE]]
    phrases = [f"{1000 * np.median(cKDTree(points).query(few, 2)[0][:, 1]):.0f} mm between neighbours"]
    if level:
        floor = fit_floor(points, settings)
        said = about_tilt(floor)
    else:
        try:
            doubt = check_up(points, settings)
        except InputError as error:  # `hdsp map` refuses this cloud
            return [*phrases, f"refused without axes: {error}"]
        found = judge(points, settings)
        floor, said = found.floor, about_gravity(found)
        if doubt:
            phrases.append(f"warning: {doubt}")
    middle = points[:, :2].mean(axis=0)
    height = (floor.offset - floor.normal[:2] @ middle) / floor.normal[2]
    phrases.append(f"floor at z = {height:.2f} m in the middle, {said.removeprefix('floor ')}")
    if under := _under(points, floor):
        phrases.append(under)
    return phrases


def _under(points: np.ndarray, floor: Plane) -> str:
    """A phrase on points far below the floor: reflections, or lower ground."""
    lowest = MapSettings().lowest
    heights = floor.heights(points)
    count = int((heights < lowest).sum())
    if count == 0:
        return ""
    return f"{count:,} points more than {-lowest:g} m below the floor, down to {heights.min():.2f} m"
