"""Signs that a height map is not as intended: other units, no-data values, another axis up, an unfit size."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hdsp.robot.lattice import RESOLUTION, cells
from hdsp.terrain.conditioning import COARSEST
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.no_data import implausible_heights, outlying_heights

_FINEST = 0.01  # m, side of a cell
_SMALLEST = 1.0  # m, side of a map; robots are about as long
_MOST_CELLS = 16_000_000  # of the planner, 100 x 100 m
_LEVEL = 3.0  # m, height of the ground over zero that is worth a word
_STEEP = 3.0  # step between neighbours, in cells
_UNKNOWN = 0.8  # share


def suspicions(terrain: HeightMap) -> tuple[str, ...]:
    """Names all signs that a height map is not as intended; an empty tuple for an ordinary map.

    The signs are: likely millimetres, no-data values, one extreme height far from all others, cells under the ground,
    ground far from zero without a CRS, another axis up, no or few known cells, equal heights everywhere, and cells or a
    size that do not suit the planner.
    """
    heights = terrain.heights[np.isfinite(terrain.heights)].astype(float)
    if not heights.size:
        return ("no cell is known", *_about_size(terrain))
    impossible = implausible_heights(terrain.heights, terrain.resolution)
    about_heights = () if impossible else (*_about_heights(heights, terrain), *_about_axes(terrain))
    return (*impossible, *about_heights, *_about_knowledge(heights, terrain), *_about_size(terrain))


def _about_heights(heights: np.ndarray, terrain: HeightMap) -> Iterator[str]:
    low, high = heights.min(), heights.max()
    if low == high:
        if heights.size > 1:
            yield f"all known heights are {low:g} m"
    else:
        yield from outlying_heights(heights)
    level = float(np.median(heights))
    if abs(level) > _LEVEL and not terrain.frame.crs:
        yield f"the ground lies {abs(level):.2f} m {'above' if level > 0 else 'below'} zero"


def _about_axes(terrain: HeightMap) -> Iterator[str]:
    along, across = (np.abs(np.diff(terrain.heights, axis=axis)) for axis in (0, 1))
    steps = np.fmax(along[:, :-1], across[:-1])
    steps = steps[np.isfinite(steps)]
    if steps.size and (steps > _STEEP * terrain.resolution).mean() > 0.5:
        angle = np.rad2deg(np.arctan(_STEEP))
        yield f"most of the ground is steeper than {angle:.0f} degrees: other units, or another axis than z is up?"


def _about_knowledge(heights: np.ndarray, terrain: HeightMap) -> Iterator[str]:
    unknown = 1 - heights.size / terrain.heights.size
    if unknown > _UNKNOWN:
        yield f"{unknown:.0%} of the cells are unknown"


def _about_size(terrain: HeightMap) -> Iterator[str]:
    resolution, (length, width) = terrain.resolution, terrain.size
    if resolution > COARSEST:
        yield f"cells of {resolution:g} m are too coarse for steps and footholds; need up to {COARSEST:g} m"
    elif resolution > COARSEST / 2:
        yield f"cells of {resolution:g} m are coarse for steps and footholds; the planner works on {RESOLUTION:g} m"
    if resolution < _FINEST:
        yield f"cells of {resolution:g} m are far finer than the planner's {RESOLUTION:g} m"
    if min(length, width) < _SMALLEST:
        yield f"{length:.3g} x {width:.3g} m are smaller than a robot needs"
    count = cells(length) * cells(width)
    if count > _MOST_CELLS:
        yield (
            f"{length:.0f} x {width:.0f} m are {count:,.0f} cells of {RESOLUTION:g} m, too many for the planner; cut a "
            "part out"
        )
