"""Values that stand for "no height" without saying so, and heights in other units than metres."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

#: Usual no-data values: of geographic rasters, of 16 bit integers.
_NEGATIVE = (-999.0, -9999.0, -9999.9, -9999.99, -10000.0, -32767.0, -32768.0, -99999.0, -1e5, -999999.0, -1e6)
_USUAL = (*_NEGATIVE, 9999.0, 65535.0, 99999.0, 999999.0, 1e6)

_LEAST = min(abs(value) for value in _USUAL)

#: No ground is as far from 0, in any unit down to millimetres.
_LIMIT = 1e7

#: A usual value counts as no-data if the other heights are farther from it than this share of it.
_APART = 0.5

_FREQUENT, _MOST = 0.001, 0.5  # shares of cells with one height far from all others
_FAR, _TALL = 5.0, 20.0  # m between this height and all others; above the ground, simulated walls have one height
_LOWEST = 0.02  # share of the known cells that may lie under the ground
_UNDER = 1.0  # m under the ground

_COARSE = 0.01  # m; coarser steps of heights look like kerbs

_FINE = 0.25  # m; cells up to this size show steps
_RISE, _SHARE = 0.5, 0.2  # m; in ground in metres fewer steps between neighbours are so high
_HIGH = 8.0  # m; in ground in metres some step is lower


def unmasked(values: Any) -> Any:
    """Values with NaN in the masked cells of a masked array; others as they are."""
    if not isinstance(values, np.ma.MaskedArray):
        return values
    return np.ma.filled(values.astype(float), np.nan)


def no_data_values(heights: np.ndarray) -> list[float]:
    """Values in heights that are obviously no heights: usual no-data values far from all others, and huge values.

    Args:
        heights: floats in any unit; NaN = unknown.

    Returns:
        the values, ascending; infinite ones among them.
    """
    if not (np.abs(heights) >= _LEAST).any():
        return []
    finite = np.isfinite(heights)
    huge = np.unique(heights[np.abs(heights) >= _LIMIT]).tolist()
    ordinary = finite & (np.abs(heights) < _LIMIT)
    found = [value for value in _USUAL if (ordinary & _equal(heights, value)).any()]
    rest = ordinary.copy()
    for value in found:
        rest &= ~_equal(heights, value)
    values = heights[rest]
    apart = [value for value in found if not values.size or np.abs(values - value).min() > _APART * abs(value)]
    return sorted([*apart, *huge])


def coarse_steps(heights: Any) -> str:
    """A phrase on half-precision heights whose steps are too coarse; "" for others."""
    if getattr(heights, "dtype", None) != np.float16 or not np.isfinite(heights).any():
        return ""
    highest = np.abs(np.ma.getdata(heights)[np.isfinite(np.ma.getdata(heights))]).max()
    if np.spacing(highest) <= _COARSE:
        return ""
    return f"heights are float16, with steps of {float(np.spacing(highest)):g} m at {float(highest):g} m; need float32"


def without_no_data(heights: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Heights with NaN in place of obvious no-data values, and a note for each value that was found."""
    values = no_data_values(heights)
    if not values:
        return heights, ()
    heights = heights.copy()
    notes = []
    for value in values[:3]:
        cells = _equal(heights, value)
        heights[cells] = np.nan
        notes.append(f"taken as unknown: the no-data value {value:g} of {_cells(cells)}")
    if len(values) > 3:
        cells = np.isin(heights, values[3:])
        heights[cells] = np.nan
        notes.append(f"taken as unknown: other impossible heights of {_cells(cells)}")
    return heights, tuple(notes)


def _equal(heights: np.ndarray, value: float) -> np.ndarray:
    return (heights == value) | (heights == np.float32(value))


def _cells(mask: np.ndarray) -> str:
    count = int(mask.sum())
    return "1 cell" if count == 1 else f"{count:,} cells"


def implausible_heights(heights: np.ndarray, resolution: float) -> tuple[str, ...]:
    """Signs of no-data values amid heights, or of heights in other units than metres.

    Args:
        heights: float [nx, ny], NaN = unknown.
        resolution: cell size, m.
    """
    found = no_data_values(heights)
    signs = [f"{_cells(_equal(heights, value))} with the no-data value {value:g}; make it NaN" for value in found[:3]]
    if not found and _seem_millimetres(heights, resolution):
        known = heights[np.isfinite(heights)]
        span = f"{known.min():g} to {known.max():g}"
        signs.append(f"heights from {span} m in cells of {resolution:g} m: millimetres or centimetres?")
    return tuple(signs)


def outlying_heights(heights: np.ndarray) -> tuple[str, ...]:
    """Signs of single values amid heights that may be no measurements: one frequent height far from all others, and few
    cells deep under the ground.

    Args:
        heights: float [n], m, all known.
    """
    return (*_extremes(heights), *_depths(heights)) if heights.size else ()


def _extremes(heights: np.ndarray) -> Iterator[str]:
    low, high = heights.min(), heights.max()
    for value, far in ((low, _FAR), (high, _TALL if high > 0 else _FAR)):
        there = heights == value
        if there.all():
            return
        distance = np.abs(heights[~there] - value).min()
        if _FREQUENT <= there.mean() <= _MOST and np.count_nonzero(there) > 2 and distance > far:
            yield (
                f"{there.mean():.1%} of the known cells have the height {value:g} m, {distance:.1f} m from all others: "
                "a no-data value?"
            )


def _depths(heights: np.ndarray) -> Iterator[str]:
    count = int(len(heights) * _LOWEST)
    lowest = np.partition(heights, count)[: count + 1]
    lowest.sort()
    gaps = np.flatnonzero(np.diff(lowest) > _UNDER)
    if len(gaps):
        under = int(gaps[-1]) + 1
        cells = "1 cell lies" if under == 1 else f"{under:,} cells lie"
        yield f"{cells} under the ground, the lowest by {lowest[under] - lowest[0]:.1f} m"


def _seem_millimetres(heights: np.ndarray, resolution: float) -> bool:
    """Whether steps between neighbours are too high for ground in metres."""
    if resolution > _FINE:
        return False
    steps = np.concatenate([np.abs(np.diff(heights, axis=axis)).ravel() for axis in (0, 1)])
    steps = steps[np.isfinite(steps)]
    if not steps.size:
        return False
    rises = steps[steps > 0]
    return bool((steps >= _RISE).mean() > _SHARE or (rises.size and np.quantile(rises, 0.05) > _HIGH))
