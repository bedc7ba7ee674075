"""Filling of small holes in a height map and smoothing of its noise.

Convention: heights are arrays [nx, ny] in m, NaN = unknown.
"""

import numpy as np


def filled(heights: np.ndarray, radius: int) -> np.ndarray:
    """Fills holes from the nearest known cells.

    A binary closing with a disc whose radius is ``radius`` cells selects the holes. Radius 0 fills no hole.
    """
    if radius == 0:
        return heights
    from scipy.ndimage import binary_closing

    known = np.pad(np.isfinite(heights), radius)
    x, y = np.indices((2 * radius + 1,) * 2) - radius
    closed = binary_closing(known, x**2 + y**2 <= radius**2)[radius:-radius, radius:-radius]
    return np.where(closed, _everywhere(heights), np.nan)


def _everywhere(heights: np.ndarray) -> np.ndarray:
    """Gives each unknown cell the nearest known cell's height."""
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(np.isnan(heights), return_distances=False, return_indices=True)
    return heights[tuple(nearest)]


def smoothed(heights: np.ndarray, limit: float) -> np.ndarray:
    """Averages noise and keeps edges.

    A 3 x 3 median comes first. Then each height becomes the mean over the heights within 5 x 5 cells that differ from
    it by less than ``limit`` m. Limit 0 smooths nothing.
    """
    if limit == 0:
        return heights
    from scipy.ndimage import median_filter

    known = np.isfinite(heights)
    calm = np.where(known, median_filter(_everywhere(heights), 3, mode="nearest"), np.nan)
    padded = np.pad(calm, 2, constant_values=np.nan)
    total, count = np.zeros_like(calm), np.zeros_like(calm)
    for i in range(5):
        for j in range(5):
            other = padded[i : i + calm.shape[0], j : j + calm.shape[1]]
            alike = np.abs(other - calm) < limit
            total += np.where(alike, other, 0)
            count += alike
    return np.where(known, total / np.maximum(count, 1), np.nan)
