"""Colours of map cells as images: heights, unknown ground, and layers of values."""

from __future__ import annotations

import numpy as np

from hdsp.terrain.height_map import HeightMap
from hdsp.viz.palette import GROUND_COLORS, PURPLE, SKY, UNKNOWN

#: Colours of values, from the lowest to the highest: dark blue over green to yellow, also for colour-blind readers.
VALUE_COLORS = "#2D1E5F", "#31688E", "#35B779", "#FDE725"
_HATCH = 6  # cells from one line of a hatching to the next
_LOW = 0.6  # below 1: low obstacles differ in colour, although walls are much higher
_STRONG = 200  # opacity of a layer, of 255


def rgb(color: str) -> tuple[int, int, int]:
    """Returns red, green and blue, 0 to 255, for a colour like ``#56B4E9``."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def shaded(values: np.ndarray, colors: tuple[str, ...], low: float, high: float) -> np.ndarray:
    """Returns colours, uint8 [..., 3], for values from ``low`` to ``high``; NaN counts as ``low``."""
    share = np.nan_to_num(np.clip((values - low) / max(high - low, 1e-9), 0.0, 1.0))
    knots = np.linspace(0.0, 1.0, len(colors))
    table = np.array([rgb(color) for color in colors], float)
    return np.stack([np.interp(share, knots, column) for column in table.T], axis=-1).round().astype(np.uint8)


def height_colors(terrain: HeightMap) -> np.ndarray:
    """Returns colours for the map heights, uint8 [nx, ny, 4], darker at edges; unknown cells are transparent."""
    known = np.isfinite(terrain.heights)
    heights = np.where(known, terrain.heights, 0.0)
    lowest = float(np.min(heights, where=known, initial=np.inf)) if known.any() else 0.0
    highest = max(float(np.max(heights, where=known, initial=-np.inf)) if known.any() else 0.0, lowest + 0.1)
    share = np.clip((heights - lowest) / (highest - lowest), 0.0, 1.0) ** _LOW
    colors = shaded(share, GROUND_COLORS, 0.0, 1.0).astype(float)
    if min(terrain.shape) > 1:
        rise = np.hypot(*np.gradient(np.where(known, heights, lowest)))
        colors *= 1 - 0.25 * (1 - np.exp(-rise / 0.03))[..., None]
    return _with_opacity(colors, np.where(known, 255, 0))


def unknown_colors(terrain: HeightMap) -> np.ndarray:
    """Returns a hatching of the unknown cells, uint8 [nx, ny, 4]; known cells are transparent."""
    ix, iy = np.indices(terrain.shape)
    line = (ix + iy) % _HATCH < _HATCH // 3
    colors = np.where(line[..., None], np.array(rgb(PURPLE)), np.array(rgb(UNKNOWN)))
    return _with_opacity(colors, np.where(np.isnan(terrain.heights), 255, 0))


def value_colors(values: np.ndarray, low: float | None = None, high: float | None = None) -> np.ndarray:
    """Returns colours of a layer of values, uint8 [nx, ny, 4].

    Args:
        values: float [nx, ny]; cells that are not finite are transparent.
        low, high: values of the first and of the last colour; None: the least value, and the 98th percentile.
    """
    finite = np.isfinite(values)
    if not finite.any():
        return np.zeros((*values.shape, 4), np.uint8)
    low = float(values[finite].min()) if low is None else low
    high = float(np.percentile(values[finite], 98)) if high is None else high
    colors = shaded(np.where(finite, values, low), VALUE_COLORS, low, high)
    return _with_opacity(colors, np.where(finite, _STRONG, 0))


def mark_colors(cells: np.ndarray, color: str = SKY, opacity: int = 140) -> np.ndarray:
    """Returns one colour for chosen cells, bool [nx, ny], as uint8 [nx, ny, 4]; other cells are transparent."""
    colors = np.broadcast_to(np.array(rgb(color)), (*cells.shape, 3))
    return _with_opacity(colors, np.where(cells, opacity, 0))


def _with_opacity(colors: np.ndarray, opacity: np.ndarray) -> np.ndarray:
    return np.concatenate([colors, opacity[..., None]], axis=-1).astype(np.uint8)
