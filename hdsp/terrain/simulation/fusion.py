"""Points measured from known places -> the surface they lie on, one point for each cell.

A single range is off by centimetres, more than an edge that stops a wheel is high; and points in front of a wall, where
noise puts them, would widen it. Two facts help: a point says that its column reaches up to it, and a ray that crosses a
column says that it ends below the ray. The surface is what contradicts the fewest of both, a median that knows about
free space: it moves walls neither forward nor back. Where all rays come from straight above, none crosses a column
next to its own, and the surface lies up to a standard deviation of the noise too high.

Convention: world coordinates, m; cells as in `hdsp.terrain.height_map`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.robot.lattice import RESOLUTION

_LAYER = 0.01  # m, height of the layers in which the surface is looked for
_LOOK_BACK = 0.12  # m before its end within which a ray counts: there it tells noise before a surface from the surface
_WINDOW = 0.06  # m around the surface within which points are averaged
_LEAST = 3  # points without which a cell stays unknown
_ALIKE = 0.02  # m; heights that differ by more are not averaged, whatever their errors are
_RADIUS = 3  # cells over which heights are averaged
_ROUNDS = 3
_AS_MANY = 200  # points after which the error of a height is no longer that of its ranges


class Surface(NamedTuple):
    """Heights float32 [nx, ny], NaN = not seen; and how many points each rests on, int32 [nx, ny]."""

    heights: np.ndarray
    points: np.ndarray


def fuse(points: np.ndarray, origins: np.ndarray, shape: tuple[int, int], resolution: float = RESOLUTION) -> Surface:
    """The surface that points and the rays to them agree on best.

    Args:
        points: float32 [n, 3], m.
        origins: float32 [n, 3], from where each was measured.
        shape: cells of the result; its lower corner is at (0, 0). Points elsewhere do not count.
        resolution: side of a cell, m.
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
    """Heights averaged over cells around that do not differ by more than their errors explain, so that edges stay.

    Args:
        surface: what `fuse` gives.
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
    """Cells that hardly any neighbour resembles take the median of their neighbours."""
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
    """Each cell on the plane that fits the cells around which are like it; on ramps a mean would make terraces."""
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
                    d = heights[i, j] - h  # NaN is never less
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
            if determinant > 0.1:  # else the cells lie in a line, and there is no plane to fit
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
        # Back along the ray, half a cell at a time over the ground; each column counts once, where the ray is lowest.
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
    """For each column, the boundary between layers with the fewest points above and rays below it, float32 [nx, ny]."""
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
            # Levels with nothing between them are alike. Of those beyond the highest point the lowest counts; else the
            # highest, since rays that graze the ground and end in it speak against all of what lies below it.
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
