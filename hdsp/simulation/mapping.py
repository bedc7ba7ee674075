"""An arena as a robot knows it: driven through, scanned, and made into a height map; and how true that map is."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import ndimage

from hdsp.arena import Arena
from hdsp.costs import cost_maps
from hdsp.errors import InputError
from hdsp.heightmap import HeightMap
from hdsp.robot import Robot
from hdsp.simulation.fusion import fuse, smooth
from hdsp.simulation.lidar import Lidar, scan
from hdsp.simulation.tour import tour
from hdsp.simulation.world import World

_HOLE = 3  # cells; holes that a disc of this radius closes are filled
_WRONG = 0.02  # m


def scanned_map(arena: Arena, start, lidar: Lidar | None = None, seed: int = 0) -> HeightMap:
    """The height map that a robot makes of an arena by driving through it; a function of its arguments alone.

    Args:
        arena: that is scanned.
        start: (x, y) or (x, y, theta) from where it drives, m.
        lidar: what it measures with.
        seed: of the noise.

    Returns:
        a map of the whole arena, NaN where it was not seen; lower corner at world (0, 0).

    Raises:
        InputError: if MuJoCo is missing, the start is not on free ground, or the seed is negative.
    """
    if seed < 0:
        raise InputError(f"scan seed {seed}; need a number of at least 0")
    lidar = lidar or Lidar()
    cloud = scan(World(arena), tour(arena, start), lidar, np.random.default_rng(seed))
    shape = arena.height_map().shape
    return HeightMap(_without_holes(smooth(fuse(cloud.points, cloud.origins, shape), lidar.noise)))


def _without_holes(heights: np.ndarray) -> np.ndarray:
    """Small holes take the height of the nearest known cell."""
    known = np.pad(np.isfinite(heights), _HOLE)
    x, y = np.indices((2 * _HOLE + 1,) * 2) - _HOLE
    closed = ndimage.binary_closing(known, x**2 + y**2 <= _HOLE**2)[_HOLE:-_HOLE, _HOLE:-_HOLE]
    nearest = ndimage.distance_transform_edt(np.isnan(heights), return_distances=False, return_indices=True)
    return np.where(closed, heights[tuple(nearest)], np.nan)


def accuracy(scanned: HeightMap, true: HeightMap, robot: Robot) -> dict[str, Any]:
    """How a scanned map differs from the true one, by name.

    `unknown_share` of the cells; of the known ones `wrong_share`, by more than 2 cm; `rms_flat`, m, on ground that is
    flat within 10 cm around; `false_edges`, cells per m2 that look like an edge no wheel passes and are two cells or
    more from any; `missed_edges`, the share of true edge cells without one beside them in the scan; and the share of
    cells on which a foot could stand but not by the scan (`standable_lost`), and the reverse (`standable_gained`).
    """
    known = np.isfinite(scanned.heights)
    error = np.where(known, scanned.heights - true.heights, 0.0)
    of_scan, of_truth = cost_maps(scanned, robot), cost_maps(true, robot)
    around = np.ones((3, 3))
    flat = known & (ndimage.maximum_filter(true.heights, 9) == ndimage.minimum_filter(true.heights, 9))
    false = of_scan.edge & known & ~ndimage.binary_dilation(of_truth.edge, around)
    missed = of_truth.edge & ~ndimage.binary_dilation(of_scan.edge, around)
    area = scanned.heights.size * scanned.resolution**2
    return {
        "unknown_share": float(1 - known.mean()),
        "wrong_share": float((np.abs(error[known]) > _WRONG).mean()),
        "rms_flat": float(np.sqrt((error[flat] ** 2).mean())),
        "false_edges": float(false.sum() / area),
        "missed_edges": float(missed.sum() / max(of_truth.edge.sum(), 1)),
        "standable_lost": float((of_truth.standable & ~of_scan.standable).mean()),
        "standable_gained": float((of_scan.standable & ~of_truth.standable).mean()),
    }
