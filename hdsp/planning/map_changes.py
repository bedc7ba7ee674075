"""Changes between two height maps."""

import numpy as np

from hdsp.abstract.abstract_costs import Region
from hdsp.base.errors import InputError
from hdsp.base.messages import shown
from hdsp.base.scalars import integers
from hdsp.terrain.height_map import HeightMap


def changed_cells(before: HeightMap, after: HeightMap, region: Region | None = None) -> np.ndarray | None:
    """Returns the cells, bool [nx, ny], in which two height maps differ; None if they do not cover the same ground.

    Args:
        before, after: the maps.
        region: rectangle (first ix, first iy, end ix, end iy) to compare; None: everything.

    Raises:
        InputError: the region does not lie within the map.
    """
    first_x, first_y, end_x, end_y = region_of(after, region)
    if before.shape != after.shape or before.origin != after.origin:
        return None
    changed = np.zeros(after.shape, bool)
    part = slice(first_x, end_x), slice(first_y, end_y)
    old, new = before.heights[part], after.heights[part]
    changed[part] = (old != new) & ~(np.isnan(old) & np.isnan(new))
    return changed


def region_of(terrain: HeightMap, region: Region | None) -> Region:
    """Returns a rectangle (first ix, first iy, end ix, end iy) of a map; None: the whole map.

    Raises:
        InputError: no four whole numbers, or a rectangle that does not lie within the map.
    """
    nx, ny = terrain.shape
    first_x, first_y, end_x, end_y = (0, 0, nx, ny) if region is None else integers(region, 4) or (0, 0, -1, -1)
    if not (0 <= first_x <= end_x <= nx and 0 <= first_y <= end_y <= ny):
        raise InputError(f"region {shown(region)}: need (first ix, first iy, end ix, end iy) within {nx} x {ny} cells")
    return first_x, first_y, end_x, end_y
