"""Surface reconstruction: one height for each cell from ranges measured at known sensor positions.

A single range has an error of several centimetres, more than the height of an edge that stops a wheel. Noise also puts
points in front of a wall and would make the wall wider. Two facts help. A point shows that its column reaches up to the
point. A ray that crosses a column shows that the column ends below the ray. The surface is the height with the fewest
contradictions: a median that also uses free space. It moves walls neither forward nor back. If all rays come straight
from above, no ray crosses a neighbouring column, and the surface is too high by up to the noise's standard deviation.

Convention: world coordinates, m; cells as in `hdsp.terrain.height_map`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.robot.lattice import RESOLUTION

_LAYER = 0.01  # m, layer height in the search for the surface
_LOOK_BACK = 0.12  # m; a ray counts only this close to its end, where it separates a surface from noise in front of it
_WINDOW = 0.06  # m; points this close to the surface are averaged
_LEAST = 3  # a cell with fewer points stays unknown
_ALIKE = 0.02  # m; heights with a larger difference are never averaged
_RADIUS = 3  # cells; radius for averaging heights
_ROUNDS = 3
_AS_MANY = 200  # points; more points do not reduce a height's error further


class Surface(NamedTuple):
    """Heights float32 [nx, ny], NaN = not seen, and the number of points behind each height, int32 [nx, ny]."""

    heights: np.ndarray
    points: np.ndarray


def fuse(points: np.ndarray, origins: np.ndarray, shape: tuple[int, int], resolution: float = RESOLUTION) -> Surface:
    """Computes the surface that agrees best with the points and their rays.

    Args:
        points: float32 [n, 3], m.
        origins: float32 [n, 3], sensor position for each point.
        shape: size of the result in cells; its lower corner is at (0, 0). Points outside are ignored.
        resolution: cell size, m.
    """
    points, origins = (np.ascontiguousarray(array, np.float32) for array in (points, origins))
    inside = (points[:, :2] >= 0).all(axis=1) & (points[:, :2] < np.asarray(shape) * resolution).all(axis=1)
    lowest = float(np.quantile(points[inside, 2], 1e-3)) - 0.1 if inside.any() else 0.0
    highest = float(points[inside, 2].max()) if inside.any() else 0.0
    layers = max(math.ceil((highest - lowest) / _LAYER), 1)
    ends = np.zeros((*shape, layers), np.uint16)
    crossings = np.zeros((*shape, layers), np.uint16)
    _count(points, origins, resolution, lowest, ends, crossings)
    levels = _levels(ends, crossings)
    total, count = _average(points, resolution, (lowest + levels * _LAYER).astype(np.float32))
    with np.errstate(invalid="ignore", divide="ignore"):
        heights = np.where(count >= _LEAST, total / count, np.nan).astype(np.float32)
    return Surface(heights, count)


def smooth(surface: Surface, noise: float) -> np.ndarray:
    """Smooths heights and keeps edges: it averages neighbours whose difference their errors explain.

    Args:
        surface: result of `fuse`.
        noise: standard deviation of a range, m.

    Returns:
        float32 [nx, ny], m, NaN where the surface is unknown.
    """
    heights, points = _without_lone_cells(surface.heights), surface.points.astype(np.float32)
    for _ in range(_ROUNDS):
        heights, points = _averaged(heights, points, np.float32(noise))
    return heights


@njit()
def _without_lone_cells(heights):
    """Replaces a cell that differs from almost all neighbours by the neighbours' median."""
    nx, ny = heights.shape
    result = heights.copy()
    around = np.empty(8, np.float32)
    for x in range(nx):
        for y in range(ny):
            h = heights[x, y]
            n, alike = 0, 0
            for i in range(max(x - 1, 0), min(x + 2, nx)):
                for j in range(max(y - 1, 0), min(y + 2, ny)):
                    if (i != x or j != y) and not math.isnan(heights[i, j]):
                        around[n] = heights[i, j]
                        n += 1
                        alike += abs(heights[i, j] - h) <= _ALIKE
            if n >= 5 and alike <= 1 and not math.isnan(h):
                result[x, y] = np.median(around[:n])
    return result


@njit()
def _averaged(heights, points, noise):
    """Fits a plane to the similar cells around each cell; on ramps, a mean would produce terraces."""
    nx, ny = heights.shape
    result, support = np.full((nx, ny), np.nan, np.float32), np.zeros((nx, ny), np.float32)
    for x in range(nx):
        for y in range(ny):
            h, n = heights[x, y], max(points[x, y], np.float32(1))
            if math.isnan(h):
                continue
            # Weighted sums of the offsets u, v in cells, and of the differences d to this cell.
            w = wu = wv = wd = wuu = wuv = wvv = wud = wvd = 0.0
            for i in range(max(x - _RADIUS, 0), min(x + _RADIUS + 1, nx)):
                for j in range(max(y - _RADIUS, 0), min(y + _RADIUS + 1, ny)):
                    m = max(points[i, j], np.float32(1))
                    d = heights[i, j] - h  # comparisons with NaN are false
                    if abs(d) < _ALIKE and abs(d) < 3 * noise * math.sqrt(1 / n + 1 / m) + 0.002:
                        u, v = float(i - x), float(j - y)
                        w += m
                        wu += m * u
                        wv += m * v
                        wd += m * d
                        wuu += m * u * u
                        wuv += m * u * v
                        wvv += m * v * v
                        wud += m * u * d
                        wvd += m * v * d
            u, v = wu / w, wv / w
            uu, uv, vv = wuu / w - u * u, wuv / w - u * v, wvv / w - v * v
            ud, vd = wud / w - u * wd / w, wvd / w - v * wd / w
            determinant = uu * vv - uv * uv
            offset = wd / w
            if determinant > 0.1:  # otherwise the cells are collinear and define no plane
                offset -= ((vv * ud - uv * vd) * u + (uu * vd - uv * ud) * v) / determinant
            result[x, y] = h + max(-_ALIKE, min(offset, _ALIKE))
            support[x, y] = min(w, _AS_MANY)
    return result, support


@njit()
def _count(points, origins, resolution, lowest, ends, crossings):
    nx, ny, layers = ends.shape
    most = np.uint16(65535)
    step = 0.5 * resolution
    for i in range(len(points)):
        x, y, z = points[i]
        ix, iy = math.floor(x / resolution), math.floor(y / resolution)
        if ix < 0 or iy < 0 or ix >= nx or iy >= ny:
            continue
        k = min(max(int((z - lowest) / _LAYER), 0), layers - 1)
        if ends[ix, iy, k] < most:
            ends[ix, iy, k] += np.uint16(1)
        dx, dy, dz = origins[i, 0] - x, origins[i, 1] - y, origins[i, 2] - z
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        level = math.sqrt(dx * dx + dy * dy)
        if level < 1e-6 or dz < 0:
            continue
        # The loop goes back along the ray in horizontal steps of half a cell. Each column counts once, at the ray's
        # lowest point.
        last = ix, iy
        reach = min(_LOOK_BACK * level / length, level)
        n = int(reach / step)
        for j in range(1, n + 1):
            t = j * step / level
            u, v = math.floor((x + dx * t) / resolution), math.floor((y + dy * t) / resolution)
            if (u, v) == last:
                continue
            last = u, v
            if u < 0 or v < 0 or u >= nx or v >= ny:
                break
            k = int((z + dz * t - lowest) / _LAYER)
            if k >= layers:
                break
            k = max(k, 0)
            if crossings[u, v, k] < most:
                crossings[u, v, k] += np.uint16(1)


@njit()
def _levels(ends, crossings):
    """Boundary between layers with the fewest points above and rays below, for each column; float32 [nx, ny]."""
    nx, ny, layers = ends.shape
    levels = np.zeros((nx, ny), np.float32)
    for x in range(nx):
        for y in range(ny):
            above = 0
            for k in range(layers):
                above += ends[x, y, k]
            least, first, last = above, 0, 0
            below = 0
            for k in range(layers):
                above -= ends[x, y, k]
                below += crossings[x, y, k]
                if above + below < least:
                    least, first, last = above + below, k + 1, k + 1
                elif above + below == least and last == k:
                    last = k + 1
            # All levels from first to last contradict equally few measurements. Above the highest point, the lowest
            # level is chosen. Otherwise the highest one is chosen, because rays that graze the ground and end in it
            # contradict all lower levels.
            levels[x, y] = first if last == layers else last
    return levels


@njit()
def _average(points, resolution, levels):
    nx, ny = levels.shape
    total, count = np.zeros((nx, ny)), np.zeros((nx, ny), np.int32)
    for i in range(len(points)):
        ix, iy = math.floor(points[i, 0] / resolution), math.floor(points[i, 1] / resolution)
        if 0 <= ix < nx and 0 <= iy < ny and abs(points[i, 2] - levels[ix, iy]) <= _WINDOW:
            total[ix, iy] += points[i, 2]
            count[ix, iy] += 1
    return total, count
