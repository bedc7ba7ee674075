"""The mesh of a height map: level tops, vertical faces at edges, and slopes where the ground slopes.

Each cell has four corner heights. A corner is the mean over those cells around it whose heights differ from the cell's
own by at most ``STEP``. Neighbouring cells of a slope therefore share their corners, while the cells on both sides of
an edge keep their own heights, with a vertical face between them. Level cells are merged to rectangles.

Convention: metres, in the frame of the map; texture coordinates run along x and y over the map, the origin at the lower
corner of cell (0, 0).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hdsp.terrain.height_map import HeightMap

#: Largest height difference (m) of neighbouring cells that is drawn as a slope; larger ones are vertical faces.
STEP = 0.02
_SAME = 1e-4  # m; heights that differ by less are drawn as one

# Corners of a cell, counter-clockwise from above, as displacements in cells.
_CORNERS = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])


class Mesh(NamedTuple):
    """A triangle mesh with texture coordinates.

    Attributes:
        vertices: float32 [n, 3], m.
        faces: uint32 [m, 3], counter-clockwise from outside.
        uv: float32 [n, 2], in [0, 1].
    """

    vertices: np.ndarray
    faces: np.ndarray
    uv: np.ndarray


def ground_mesh(terrain: HeightMap, cells: np.ndarray | None = None, raised: float = 0.0, walls: bool = True) -> Mesh:
    """Makes the mesh of some cells of a map.

    Args:
        terrain: the map.
        cells: bool [nx, ny], the cells; None: all known cells. Unknown cells are filled as by `surface_of`; a map from
            there saves this work for each further mesh.
        raised: mesh height above the ground, m.
        walls: whether vertical faces at edges belong to the mesh.

    Returns:
        The mesh; empty without cells.
    """
    cells = np.isfinite(terrain.heights) if cells is None else cells
    if not cells.any():
        return Mesh(np.empty((0, 3), np.float32), np.empty((0, 3), np.uint32), np.empty((0, 2), np.float32))
    corners = corner_heights(_filled(terrain.heights))
    quads = [_tops(corners, cells)]
    if walls:
        quads += [_walls(corners, cells), _mirrored(_walls(corners.transpose(1, 0, 2)[:, :, [0, 3, 2, 1]], cells.T))]
    places, shades = (np.concatenate(parts) for parts in zip(*quads, strict=True))
    return _joined(places, shades, terrain, raised)


def surface_of(terrain: HeightMap) -> HeightMap:
    """Returns a map in which unknown cells have the nearest known cell's height, or 0 without any."""
    return replace(terrain, heights=_filled(terrain.heights))


def _filled(heights: np.ndarray) -> np.ndarray:
    from scipy.ndimage import distance_transform_edt

    unknown = np.isnan(heights)
    if unknown.all():
        return np.zeros(heights.shape)
    if not unknown.any():
        return heights.astype(float)
    nearest = distance_transform_edt(unknown, return_distances=False, return_indices=True)
    return heights[tuple(nearest)].astype(float)


def corner_heights(heights: np.ndarray) -> np.ndarray:
    """Returns the heights of the four corners of each cell, float64 [nx, ny, 4], counter-clockwise from the lowest."""
    nx, ny = heights.shape
    around = np.pad(heights, 1, mode="edge")
    corners = np.empty((nx, ny, 4))
    for k, (right, up) in enumerate(_CORNERS):
        total, count = np.zeros((nx, ny)), np.zeros((nx, ny))
        for dx in (right - 1, right):
            for dy in (up - 1, up):
                other = around[1 + dx : 1 + dx + nx, 1 + dy : 1 + dy + ny]
                near = abs(other - heights) <= STEP
                total += np.where(near, other, 0.0)
                count += near
        corners[..., k] = total / count
    return np.round(corners / _SAME) * _SAME


def _tops(corners: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Upper faces: corners in cells and height [n, 4, 3], and the places of their colours [n, 4, 2]."""
    level = cells & (np.ptp(corners, axis=2) == 0)
    merged = rectangles(np.where(level, corners[..., 0], np.nan))
    flat = np.array(merged, float).reshape(-1, 5)
    low_x, low_y, high_x, high_y, height = flat.T
    x = np.stack([low_x, high_x, high_x, low_x], axis=1)
    y = np.stack([low_y, low_y, high_y, high_y], axis=1)
    z = np.repeat(height[:, None], 4, axis=1)
    sloped = np.argwhere(cells & ~level)
    places = sloped[:, None] + _CORNERS
    slopes = np.concatenate([places, corners[tuple(sloped.T)][..., None]], axis=2)
    quads = np.concatenate([np.stack([x, y, z], axis=2), slopes])
    return quads, quads[..., :2]


def rectangles(heights: np.ndarray) -> list[tuple[int, int, int, int, float]]:
    """Merges level cells to rectangles: runs along y, and equal runs along x.

    Args:
        heights: float64 [nx, ny]; NaN = no cell.

    Returns:
        (first ix, first iy, end ix, end iy, height) for each rectangle; they cover each cell exactly once.
    """
    nx, ny = heights.shape
    breaks = np.ones((nx, ny + 1), bool)
    breaks[:, 1:-1] = heights[:, 1:] != heights[:, :-1]
    done: list[tuple[int, int, int, int, float]] = []
    open_runs: dict[tuple[int, int, float], int] = {}
    for ix in range(nx):
        ends = np.flatnonzero(breaks[ix])
        runs = {}
        for first, end in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
            height = float(heights[ix, first])
            if height == height:
                key = first, end, height
                runs[key] = open_runs.pop(key, ix)
        done += [(start, first, ix, end, height) for (first, end, height), start in open_runs.items()]
        open_runs = runs
    return done + [(start, first, nx, end, height) for (first, end, height), start in open_runs.items()]


def _walls(corners: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertical faces between neighbours along x, as in ``_tops``; each belongs to the higher of both cells.

    The border of the map has faces down to its lowest ground.
    """
    nx, ny = cells.shape
    # Heights on both sides of each line between cells, at the lower and the upper end of the line.
    behind, ahead = np.full((nx + 1, ny, 2), corners.min()), np.full((nx + 1, ny, 2), corners.min())
    behind[1:], ahead[:-1] = corners[..., [1, 2]], corners[..., [0, 3]]
    found = []
    for higher, lower, shift in ((behind, ahead, -1), (ahead, behind, 0)):
        owners = np.zeros((nx + 1, ny), bool)
        owners[-shift : nx - shift] = cells
        line, at = np.nonzero(owners & ((higher - lower).max(axis=2) > _SAME))
        # One face for all following pieces of a line with the same heights.
        heights = np.concatenate([higher[line, at], lower[line, at]], axis=1)
        level = (heights[:, 0] == heights[:, 1]) & (heights[:, 2] == heights[:, 3])
        same = (np.diff(line) == 0) & (np.diff(at) == 1) & level[1:] & level[:-1]
        same &= (heights[1:] == heights[:-1]).all(axis=1)
        firsts = np.flatnonzero(np.concatenate([[True], ~same])[: len(line)])
        lasts = np.concatenate([firsts[1:], [len(line)]])[: len(firsts)] - 1
        x, low, high = line[firsts].astype(float), at[firsts].astype(float), at[lasts] + 1.0
        top, foot = heights[firsts, :2], heights[firsts, 2:]
        top = np.maximum(top, foot)
        outline = (low, foot[:, 0]), (high, foot[:, 1]), (high, top[:, 1]), (low, top[:, 0])
        quad = np.stack([np.stack([x, y, z], axis=1) for y, z in outline], axis=1)
        shade = np.stack([np.full_like(x, shift + 0.5) + x, low + 0.5], axis=1)
        outward = quad if shift == -1 else quad[:, ::-1]
        found.append((outward, np.repeat(shade[:, None], 4, axis=1)))
    quads, shades = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return quads, shades


def _mirrored(walls: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Faces of the map with x and y swapped, swapped back; the mirror changes the direction of their corners."""
    quads, shades = walls
    return quads[:, ::-1][..., [1, 0, 2]], shades[:, ::-1][..., [1, 0]]


def _joined(places: np.ndarray, shades: np.ndarray, terrain: HeightMap, raised: float) -> Mesh:
    """Mesh of quads [n, 4, 3] in cells and metres; equal vertices with equal colours are one."""
    points = np.concatenate([places.reshape(-1, 3), shades.reshape(-1, 2)], axis=1).astype(np.float32)
    points, index = np.unique(points, axis=0, return_inverse=True)
    quads = index.reshape(-1, 4)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.uint32)
    # A wall that ends at the height of its foot is a triangle.
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    vertices = points[:, :3].copy()
    vertices[:, :2] = vertices[:, :2] * terrain.resolution + np.asarray(terrain.origin, np.float32)
    vertices[:, 2] += raised
    return Mesh(vertices, faces, points[:, 3:] / np.asarray(terrain.shape, np.float32))
