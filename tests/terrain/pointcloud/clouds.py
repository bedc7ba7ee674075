"""Synthetic clouds: a sensor's view of boxes on a floor."""

import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation


def rectangle(x, y, z, spacing=0.02):
    """Points on a horizontal rectangle: x and y are (low, high), z is its height."""
    grid = np.meshgrid(np.arange(*x, spacing), np.arange(*y, spacing), indexing="ij")
    return np.stack([*grid, np.full_like(grid[0], z)], axis=-1).reshape(-1, 3)


def wall(x, y, z, spacing=0.02):
    """Points on a vertical rectangle along y at one x."""
    grid = np.meshgrid(np.arange(*y, spacing), np.arange(*z, spacing), indexing="ij")
    return np.stack([np.full_like(grid[0], x), *grid], axis=-1).reshape(-1, 3)


def box(x, y, height, spacing=0.02):
    """Points on a box on the floor: its top and its two sides across x."""
    sides = [wall(value, y, (0, height), spacing) for value in x]
    return np.concatenate([rectangle(x, y, height, spacing), *sides])


def room(noise=0.005, seed=0, ceiling=None):
    """A floor of 4 x 3 m with a box of 0.5 x 0.4 x 0.3 m and optionally a ceiling at ``ceiling`` m."""
    floor = rectangle((-2, 2), (-1.5, 1.5), 0.0)
    under = (np.abs(floor[:, 0] - 0.25) < 0.25) & (np.abs(floor[:, 1] - 0.2) < 0.2)
    parts = [floor[~under], box((0.0, 0.5), (0.0, 0.4), 0.3)]
    if ceiling is not None:
        parts.append(rectangle((-2, 2), (-1.5, 1.5), ceiling, 0.015))
    points = np.concatenate(parts)
    return points + np.random.default_rng(seed).normal(0, noise, points.shape)


def moved(points, roll=0.0, pitch=0.0, yaw=0.0, shift=(0.0, 0.0, 0.0)):
    """The cloud after a rotation by angles in degrees and a translation."""
    return Rotation.from_euler("xyz", [roll, pitch, yaw], degrees=True).apply(points) + shift


def las_with_crs(path, *records, extended=False, points=((10.0, 20.0, 30.0),)):
    """A LAS file of points with records on its CRS: WKT as text, or GeoTIFF keys."""
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [1e-3] * 3, [0.0] * 3
    las = laspy.LasData(header)
    las.x, las.y, las.z = np.array(points).T
    if extended:
        las.evlrs = laspy.vlrs.vlrlist.VLRList()
    for record in records:
        keys = isinstance(record, dict)
        words = [1, 1, 0, len(record), *(word for key in record for word in (key, 0, 1, record[key]))] if keys else []
        content = struct.pack(f"<{len(words)}H", *words) if keys else record.encode() + b"\0"
        places = las.evlrs if extended else las.header.vlrs
        places.append(laspy.VLR("LASF_Projection", 34735 if keys else 2112, "", content))
    las.write(path)
    return path
