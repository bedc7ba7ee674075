"""Height maps scanned by a robot that drives through an arena, and their accuracy."""

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
from hdsp.terrain.pointcloud import MapSettings
from hdsp.terrain.simulation.fusion import fuse, smooth
from hdsp.terrain.simulation.lidar import Lidar, scan
from hdsp.terrain.simulation.mujoco_world import MujocoWorld
from hdsp.terrain.simulation.tour import tour

#: The fused surface is already level, and free of noise and overhangs.
_FUSED = MapSettings(level=False, lowest=-10.0, highest=10.0, neighbours=0, smooth=0.0, island=0)
_WRONG = 0.02  # m


def scanned_map(arena: Arena, start, lidar: Lidar | None = None, seed: int = 0) -> HeightMap:
    """Scans an arena from a driving robot and makes a height map; the result depends on the arguments alone.

    Args:
        arena: the scanned arena.
        start: (x, y) or (x, y, theta) where the drive begins, m.
        lidar: the sensor.
        seed: seed for the noise.

    Returns:
        a map of the whole arena, NaN for unseen cells; lower corner at world (0, 0).

    Raises:
        InputError: if MuJoCo is missing, the start is not on free ground, or the seed is negative.
    """
    if seed < 0:
        raise InputError(f"scan seed {seed}; need a number of at least 0")
    lidar = lidar or Lidar()
    cloud = scan(MujocoWorld(arena), tour(arena, start), lidar, np.random.default_rng(seed))
    shape = arena.height_map().shape
    return _as_map(smooth(fuse(cloud.points, cloud.origins, shape), lidar.noise))


def _as_map(heights: np.ndarray) -> HeightMap:
    """Makes a height map from the surface and fills small holes; the map keeps all cells, including unseen ones."""
    cells = np.moveaxis(np.indices(heights.shape), 0, -1)
    x, y = np.moveaxis(Grid((0.0, 0.0), heights.shape).center(cells), -1, 0)
    known = np.isfinite(heights)
    seen = HeightMap.from_points(np.column_stack([x[known], y[known], heights[known]]), _FUSED)
    whole = np.full(heights.shape, np.nan, np.float32)
    low = Grid((0.0, 0.0), heights.shape).cell(seen.origin)
    whole[low[0] : low[0] + seen.shape[0], low[1] : low[1] + seen.shape[1]] = seen.heights
    return HeightMap(whole)


def accuracy(scanned: HeightMap, true: HeightMap, robot: Robot) -> dict[str, Any]:
    """Compares a scanned map with the true map; returns errors by name.

    - `unknown_share`: share of unknown cells.
    - `wrong_share`: share of known cells with an error above 2 cm.
    - `rms_flat`: root mean square error on ground that is flat within 10 cm, m.
    - `false_edges`: known cells per m2 with an edge in the scan and no true edge in their neighbourhood.
    - `missed_edges`: share of true edge cells without an edge in the scan in their neighbourhood.
    - `standable_lost`: share of cells where a foot can stand, but not according to the scan.
    - `standable_gained`: share of cells where a foot can stand only according to the scan.
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
