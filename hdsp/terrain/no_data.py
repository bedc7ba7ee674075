"""Values that stand for "no height" in files without saying so."""

from __future__ import annotations

import numpy as np

#: Usual no-data values: of geographic rasters, of 16 bit integers.
_USUAL = (-9999.0, -99999.0, -999999.0, -32768.0, -32767.0, -10000.0, -999.0, -9999.9, 9999.0, 99999.0, 999999.0)

#: No ground is as far from 0, in any unit down to millimetres.
_LIMIT = 1e7

#: A usual value counts as no-data if the other heights are farther from it than this share of it.
_APART = 0.5


def no_data_values(heights: np.ndarray) -> list[float]:
    """Values in heights that are obviously no heights: usual no-data values far from all others, and huge values.

    Args:
        heights: floats in any unit; NaN = unknown.

    Returns:
        the values, ascending; infinite ones among them.
    """
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
