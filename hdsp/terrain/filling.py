"""Filling of small holes in a height map and smoothing of its noise.

Convention: heights are arrays [nx, ny] in m, NaN = unknown.
"""

from typing import Literal

import numpy as np


def filled(heights: np.ndarray, radius: int) -> np.ndarray:
    """Fills holes from the nearest known cells.

    A binary closing with a disc whose radius is ``radius`` cells selects the holes. Radius 0 fills no hole.
    """
    if radius == 0:
        return heights
    return np.where(closed(np.isfinite(heights), radius), _everywhere(heights), np.nan)


def closed(known: np.ndarray, radius: int, beyond: Literal["constant", "edge"] = "constant") -> np.ndarray:
    """Known cells and the holes that a disc closes, bool [nx, ny].

    Args:
        known: bool [nx, ny].
        radius: of the disc, cells, at least 1.
        beyond: mode of ``numpy.pad`` for cells beyond the border; ``constant``: unknown.
    """
    from scipy.ndimage import distance_transform_edt

    # Distances take the same time for all radii, other than a closing with the disc itself.
    reached = distance_transform_edt(~np.pad(known, radius, mode=beyond)) <= radius
    inner = distance_transform_edt(reached) > radius if not reached.all() else reached
    return inner[radius:-radius, radius:-radius]


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
