"""Points that are no measurements: no-data values and lone points far away; and extents that are no metres.

Convention: points are float64 [n, 3] in metres.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.messages import coordinates, spans

#: A no-data value is at least so many m, and so many times the range of the other values, away from the other values:
#: for x and y, where walls are far away, and for z.
_NO_DATA_APART = (100.0, 10.0), (100.0, 10.0), (8.0, 3.0)
_MOST_NO_DATA = 3  # values in a file
_NO_DATA_POINTS = 3  # points with the same value; fewer may be measurements
#: m; points are far away beyond this distance, and the extent of the middle 96 % of the points, from these.
_FAR = 20.0
_FAR_SHARE, _FAR_POINTS = 0.001, 10  # more points than this are a part of the place
_SMALLEST_EXTENT = 0.2  # m
_GREATEST_RELIEF = 10_000.0  # m
_LARGEST_MAP = 100_000_000  # cells; a larger scan is probably not in metres
_MOST_STEP = 0.25  # cells; coarser steps of coordinates leave cells without points
_MILLIMETRES = 1000.0  # m; larger extents in all three axes are millimetres


class Cleaned(NamedTuple):
    """Points without the faulty ones, and a phrase on each kind of fault."""

    points: np.ndarray
    notes: tuple[str, ...]


def without_no_data(points: np.ndarray) -> Cleaned:
    """Leaves out points whose x, y or z is a no-data value.

    A no-data value (-9999, -32768, 1e30, 0 in coordinates of a survey) is one value shared by three or more points, and
    far from all other values: for a height 8 m and three times their range, for x or y 100 m and ten times their range.
    """
    notes = []
    for axis, name in enumerate("xyz"):
        for value in _no_data_values(points[:, axis], *_NO_DATA_APART[axis]):
            hit = points[:, axis] == value
            notes.append(f"{hit.sum():,} points with the no-data value {name} = {value:g} left out")
            points = points[~hit]
    return Cleaned(points, tuple(notes))


def _no_data_values(values: np.ndarray, least: float, ranges: float) -> list[float]:
    if len(values) == 0 or np.ptp(values) < least:
        return []
    distinct, counts = np.unique(values, return_counts=True)
    parts = np.split(np.arange(len(distinct)), np.flatnonzero(np.diff(distinct) > least) + 1)
    # Measured values differ from each other; of two single values, a no-data value is the larger one.
    main = max(parts, key=lambda part: (len(part), -abs(distinct[part[0]])))
    low, high = distinct[main[0]], distinct[main[-1]]
    gap = max(least, ranges * (high - low))
    single = [part[0] for part in parts if len(part) == 1 and part[0] != main[0] and counts[part[0]] >= _NO_DATA_POINTS]
    found = [float(distinct[k]) for k in single if max(low - distinct[k], distinct[k] - high) > gap]
    return found if len(found) <= _MOST_NO_DATA else []  # more are the rows of a grid in smaller units


def without_far_points(points: np.ndarray) -> Cleaned:
    """Leaves out a few points (at most 0.1 %, or ten) far away from all others: farther than 20 m and their extent."""
    if len(points) == 0 or np.ptp(points, axis=0).max() < _FAR:
        return Cleaned(points, ())
    far = _far(points)
    count = int(far.sum())
    if not 0 < count <= max(_FAR_SHARE * len(points), min(_FAR_POINTS, len(points) / 20)):
        return Cleaned(points, ())
    example = coordinates(points[far][0], 2)
    kind = "lone point" if count == 1 else "lone points"
    return Cleaned(points[~far], (f"{count:,} {kind} far away left out, e.g. ({example})",))


def _far(points: np.ndarray) -> np.ndarray:
    low, high = np.quantile(points, [0.02, 0.98], axis=0)
    beyond = np.maximum(_FAR, high - low)
    return ((points < low - beyond) | (points > high + beyond)).any(axis=1)


def check_extent(points: np.ndarray, resolution: float) -> None:
    """Raises an InputError if the extents are implausible for metres, or too large for a map."""
    extent = np.ptp(points, axis=0)
    text = f"points span {extent[0]:.4g} x {extent[1]:.4g} x {extent[2]:.4g} m"
    if extent[:2].max() < _SMALLEST_EXTENT:
        raise InputError(f"{text}: are they in metres? see the option units")
    unit = millimetres(points)
    if extent[2] > _GREATEST_RELIEF:
        raise InputError(f"{text}, much in height: are they in metres? {unit or 'see the option units'}")
    if np.prod(extent[:2] / resolution) > _LARGEST_MAP:
        text = f"{text}, more than {_LARGEST_MAP:,} cells of {resolution} m: are they in metres?"
        if unit:
            raise InputError(f"{text} {unit}")
        low, high = np.quantile(points, [0.02, 0.98], axis=0)
        raise InputError(
            f"{text} see the option units; or cut a box out of them: most lie in {spans(low[:2], high[:2])}"
        )


def check_steps(points: np.ndarray, resolution: float) -> None:
    """Raises an InputError if x or y went through float32 and lost the decimals that a map needs."""
    for values, name in zip(points.T[:2], "xy", strict=True):
        place = float(np.median(np.abs(values)))
        step = float(np.spacing(np.float32(place)))
        if step > _MOST_STEP * resolution and (values == values.astype(np.float32)).all():
            raise InputError(
                f"{name} has steps of {step:g} m, as float32 has at {place:,.0f} m; need float64, or subtract an "
                "offset from the coordinates before they become float32"
            )


def millimetres(points: np.ndarray) -> str:
    """A phrase if the extents look like millimetres or centimetres; "" else."""
    low, high = np.quantile(points, [0.01, 0.99], axis=0)
    extent = high - low
    if extent[2] > _MILLIMETRES and extent[:2].max() > _MILLIMETRES:
        return "extents of thousands look like millimetres: units 0.001"
    if extent[2] > _MILLIMETRES / 10 and extent[:2].max() < 100 * extent[2] and extent[:2].max() > _MILLIMETRES / 10:
        return "a relief of hundreds of metres looks like centimetres (units 0.01) or millimetres (0.001)"
    return ""
