"""Changes between two height maps."""

from numbers import Integral

import numpy as np

from hdsp.abstract.abstract_costs import Region
from hdsp.base.errors import InputError
from hdsp.base.messages import shown
from hdsp.terrain.height_map import HeightMap


def changed_cells(before: HeightMap, after: HeightMap, region: Region | None = None) -> np.ndarray | None:
    """Returns the cells, bool [nx, ny], in which two height maps differ; None if they do not cover the same ground.

    Args:
        before, after: the maps.
        region: rectangle (first ix, first iy, end ix, end iy) to compare; None: everything.

    Raises:
        InputError: the region does not lie within the map.
    """
    if before.shape != after.shape or before.origin != after.origin:
        return None
    nx, ny = after.shape
    four = (0, 0, nx, ny) if region is None else _whole_numbers(region)
    first_x, first_y, end_x, end_y = four if four is not None else (0, 0, -1, -1)
    if not (0 <= first_x <= end_x <= nx and 0 <= first_y <= end_y <= ny):
        raise InputError(f"region {shown(region)}: need (first ix, first iy, end ix, end iy) within {nx} x {ny} cells")
    changed = np.zeros(after.shape, bool)
    part = slice(first_x, end_x), slice(first_y, end_y)
    old, new = before.heights[part], after.heights[part]
    changed[part] = (old != new) & ~(np.isnan(old) & np.isnan(new))
    return changed


def _whole_numbers(region) -> tuple[int, int, int, int] | None:
    """Four whole numbers; None for anything else."""
    values = np.asarray(region, dtype=object).ravel().tolist() if np.size(region) == 4 else []
    if len(values) != 4 or not all(isinstance(value, Integral) and not isinstance(value, bool) for value in values):
        return None
    first_x, first_y, end_x, end_y = (int(value) for value in values)
    return first_x, first_y, end_x, end_y
