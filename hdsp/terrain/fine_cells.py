"""Filters for cells much finer than the planner's: a window holds so many that a median over it takes long.

Convention: heights are float32 arrays [nx, ny] in m, NaN = unknown.
"""

from __future__ import annotations

import numpy as np

_FINE = 0.005  # m; cells that join stay at most this large
_VALUES = 4_000_000  # heights in windows that are sorted at once


def joins(resolution: float) -> int:
    """Number of cells along each axis that join to one before a conditioning; 1: cells stay as they are."""
    return max(int(_FINE / resolution + 1e-9), 1)


def joined(heights: np.ndarray, factor: int, edge: float, spike_cells: int) -> np.ndarray:
    """Joins ``factor`` x ``factor`` cells to one, with the median of their known heights.

    Where more cells than in a spike rise above the median by more than an edge, they are a thin structure, and the
    highest of them counts. A row of ``factor`` cells is no spike.

    Args:
        heights: float32 [nx, ny], m.
        factor: number of cells along each axis; the last cells may have fewer.
        edge: m.
        spike_cells: most cells in a spike.

    Returns:
        float32, unknown where all cells are unknown.
    """
    if factor == 1:
        return heights
    shape = [-(-count // factor) for count in heights.shape]
    whole = np.full([factor * count for count in shape], np.nan, np.float32)
    whole[: heights.shape[0], : heights.shape[1]] = heights
    blocks = whole.reshape(shape[0], factor, shape[1], factor).swapaxes(1, 2).reshape(*shape, factor**2)
    blocks = np.sort(blocks, axis=2)  # unknown heights last
    known = np.isfinite(blocks).sum(axis=2)
    middle = np.take_along_axis(blocks, np.minimum(known // 2, known - 1)[..., None], axis=2)
    high = (blocks > middle + edge).sum(axis=2)
    highest = np.take_along_axis(blocks, np.maximum(known - 1, 0)[..., None], axis=2)
    return np.where(high > min(spike_cells, factor - 1), highest[..., 0], middle[..., 0])


def medians_at(heights: np.ndarray, window: int, cells: tuple[np.ndarray, ...]) -> np.ndarray:
    """Medians over windows around some cells, the same as those of a median filter over the whole map.

    Args:
        heights: float32 [nx, ny], m, all known.
        window: side of the windows in cells, odd. Beyond the border, the nearest height counts.
        cells: indices along both axes, int64 [n] each.
    """
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(heights, window // 2, mode="edge"), (window, window))
    count, middle, found = len(cells[0]), window**2 // 2, np.empty(len(cells[0]), heights.dtype)
    step = max(_VALUES // window**2, 1)
    for first in range(0, count, step):
        part = tuple(axis[first : first + step] for axis in cells)
        values = windows[part].reshape(-1, window**2)
        found[first : first + step] = np.partition(values, middle, axis=1)[:, middle]
    return found
