"""An arena as a robot knows it: driven through, scanned, and made into a height map; and how true that map is."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import ndimage

from hdsp.base.errors import InputError
from hdsp.robot.lattice import Grid
from hdsp.robot.robot import Robot
from hdsp.terrain.arenas import Arena
from hdsp.terrain.cost_maps import cost_maps
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.pointcloud import MapSettings, height_map
from hdsp.terrain.simulation.fusion import fuse, smooth
from hdsp.terrain.simulation.lidar import Lidar, scan
from hdsp.terrain.simulation.mujoco_world import World
from hdsp.terrain.simulation.tour import tour

#: The surface is levelled, free of noise and of what hangs in the air already.
_FUSED = MapSettings(level=False, lowest=-10.0, highest=10.0, neighbours=0, smooth=0.0, island=0)
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
    return _as_map(smooth(fuse(cloud.points, cloud.origins, shape), lidar.noise))


def _as_map(heights: np.ndarray) -> HeightMap:
    """A height map of the surface, small holes filled; it covers all cells, also where nothing was seen."""
    x, y = np.moveaxis(Grid((0.0, 0.0), heights.shape).center(np.stack(np.indices(heights.shape), -1)), -1, 0)
    known = np.isfinite(heights)
    seen = height_map(np.column_stack([x[known], y[known], heights[known]]), _FUSED)
    whole = np.full(heights.shape, np.nan, np.float32)
    low = Grid((0.0, 0.0), heights.shape).cell(seen.origin)
    whole[low[0] : low[0] + seen.shape[0], low[1] : low[1] + seen.shape[1]] = seen.heights
    return HeightMap(whole)


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
