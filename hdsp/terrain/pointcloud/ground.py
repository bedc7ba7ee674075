"""Height of the ground below each point of a cloud, along hills and stairs and not up walls and shelves.

Coarse cells in plan get a low height; the floor is z = 0 within a few centimetres. Cells are connected where the height
changes by less than a step and a slope, and the ground is everything connected with the floor. Elsewhere the nearest
ground counts.
"""

from __future__ import annotations

import numpy as np

_CELL = 0.4  # m
_LOW = 0.05  # quantile; fewer points of a cell lie below its ground, e.g. reflections
_REACH = 2  # cells, over which cells are connected
_STEP, _SLOPE = 0.2, 0.5  # m, and m per m
_LEAST_FLOOR = 0.02  # of the cells on the floor, that a part of the ground needs


def ground_below(points: np.ndarray, thickness: float) -> np.ndarray:
    """Height of the ground below or beside each point.

    Args:
        points: float64 [n, 3], m; the floor is near z = 0 somewhere.
        thickness: m, of the floor.

    Returns:
        float64 [n], m.
    """
    from scipy.ndimage import distance_transform_edt

    cells = np.floor(points[:, :2] / _CELL).astype(np.int64)
    cells -= cells.min(axis=0)
    shape = tuple(cells.max(axis=0) + 1)
    flat = np.asarray(np.ravel_multi_index(cells.T, shape))
    low, floor = _low(flat, points[:, 2], shape, 3 * thickness)
    ground = np.where(_connected(low, floor), low, np.nan)
    if np.isnan(ground).all():
        return np.zeros(len(points))
    nearest = distance_transform_edt(np.isnan(ground), return_distances=False, return_indices=True)
    return ground[tuple(nearest)].ravel()[flat]


def _low(flat: np.ndarray, z: np.ndarray, shape: tuple[int, ...], thickness: float) -> tuple[np.ndarray, np.ndarray]:
    """Low heights [nx, ny], NaN without points, and the cells on the floor, bool [nx, ny]."""
    order = np.lexsort((z, flat))
    flat, z = flat[order], z[order]
    used, first, count = np.unique(flat, return_index=True, return_counts=True)
    low = np.full(shape, np.nan)
    low.ravel()[used] = z[first + (_LOW * (count - 1)).astype(int)]
    # A cell is floor if few of its points are lower, as reflections are.
    on, under = (np.bincount(flat[part], minlength=low.size) for part in (np.abs(z) < thickness, z < -thickness))
    floor = ((on > 0) & (on >= under)).reshape(shape)
    low[floor] = 0.0
    return low, floor


def _connected(low: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """Cells [nx, ny] connected with the floor."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    number = np.arange(low.size).reshape(low.shape)
    pairs = []
    for dx in range(_REACH + 1):
        for dy in range(-_REACH, _REACH + 1):
            if (dx, dy) <= (0, 0) or dx >= low.shape[0] or abs(dy) >= low.shape[1]:
                continue
            here = np.s_[: low.shape[0] - dx, max(0, -dy) : low.shape[1] - max(0, dy)]
            there = np.s_[dx:, max(0, dy) : low.shape[1] + min(0, dy)]
            near = np.abs(low[there] - low[here]) <= _STEP + _SLOPE * _CELL * np.hypot(dx, dy)
            pairs.append(np.stack([number[here][near], number[there][near]]))
    one, other = np.concatenate(pairs, axis=1) if pairs else np.zeros((2, 0), int)
    graph = coo_array((np.ones(len(one)), (one, other)), shape=(low.size, low.size))
    part = connected_components(graph, directed=False)[1].reshape(low.shape)
    share = np.bincount(part[floor], minlength=low.size) / max(1, floor.sum())
    return np.isfinite(low) & (share[part] >= _LEAST_FLOOR)
