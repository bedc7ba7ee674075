"""Triangle pictures from a camera without perspective, by a depth buffer.

A scene rarely changes but for the robot in it: `Canvas.copy` keeps the ground for the next picture.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Self

import numpy as np


class ParallelCamera:
    """Camera without perspective.

    Convention: pixel (column, row) from the upper left corner; depth grows away from the camera, m.

    Attributes:
        axes: float64 [3, 3], rows are the directions right, up and away, world frame.
        scale: pixels per metre.
        size: width and height, pixels.
    """

    def __init__(self, azimuth: float, elevation: float, points: np.ndarray, width: int, border: float = 0.04):
        """Looks at points; all fit into the picture.

        Args:
            azimuth: view direction, rad against the x axis.
            elevation: camera angle over the horizon, rad.
            points: float64 [n, 3], m.
            width: picture width, pixels.
            border: free share at each side.
        """
        cos, sin, up, flat = math.cos(azimuth), math.sin(azimuth), math.sin(elevation), math.cos(elevation)
        self.axes = np.array([(sin, -cos, 0.0), (up * cos, up * sin, flat), (flat * cos, flat * sin, -up)])
        seen = points @ self.axes.T
        low, high = seen.min(axis=0), seen.max(axis=0)
        self.scale = width * (1 - 2 * border) / (high[0] - low[0])
        height = math.ceil((high[1] - low[1]) * self.scale + 2 * border * width)
        self.size = width, height + height % 2
        middle = (low + high) / 2
        self._shift = np.array([self.size[0] / 2 - middle[0] * self.scale, self.size[1] / 2 + middle[1] * self.scale])

    def see(self, points: np.ndarray) -> np.ndarray:
        """Returns column, row and depth, float64 [..., 3], for points [..., 3]."""
        seen = points @ self.axes.T
        return np.stack([seen[..., 0] * self.scale, -seen[..., 1] * self.scale, seen[..., 2]], axis=-1) + (
            *self._shift, 0.0,
        )  # fmt: skip

    def world(self, depth: np.ndarray) -> np.ndarray:
        """Returns the point behind each pixel centre at a depth [rows, columns], float64 [rows, columns, 3]."""
        rows, columns = np.indices(depth.shape)
        right = (columns + 0.5 - self._shift[0]) / self.scale
        up = (self._shift[1] - rows - 0.5) / self.scale
        return np.stack([right, up, np.where(np.isfinite(depth), depth, 0.0)], axis=-1) @ self.axes


class Triangles(NamedTuple):
    """Triangles with a colour each.

    Attributes:
        corners: float64 [n, 3, 3], m, counter-clockwise from outside.
        colors: float64 [n, 3], red, green, blue in [0, 1].
    """

    corners: np.ndarray
    colors: np.ndarray

    def normals(self) -> np.ndarray:
        """Unit vectors to the outside, float64 [n, 3]; zero for a triangle without area."""
        across = np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0])
        return across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)


class Canvas:
    """Picture in the making.

    Attributes:
        pixels: float32 [rows, columns, 3] in [0, 1].
        depth: float64 [rows, columns], inf where nothing is.
    """

    def __init__(self, camera: ParallelCamera, background: tuple[float, float, float] = (1.0, 1.0, 1.0)):
        columns, rows = camera.size
        self.camera = camera
        self.pixels = np.full((rows, columns, 3), background, np.float32)
        self.depth = np.full((rows, columns), np.inf)

    def copy(self) -> Self:
        """Returns a canvas with the same picture."""
        other = object.__new__(type(self))
        other.camera, other.pixels, other.depth = self.camera, self.pixels.copy(), self.depth.copy()
        return other

    def draw(self, triangles: Triangles, light: np.ndarray, ambient: float = 0.55) -> None:
        """Draws triangles that face the camera, lit from the direction ``light`` [3]."""
        normals = triangles.normals()
        facing = normals @ self.camera.axes[2] < 0
        shade = ambient + (1 - ambient) * np.maximum(normals @ (light / np.linalg.norm(light)), 0.0)
        colors = (triangles.colors * shade[:, None]).astype(np.float32)
        seen = self.camera.see(triangles.corners)
        for k in np.flatnonzero(facing).tolist():
            self._fill(seen[k], colors[k])

    def _fill(self, corners: np.ndarray, color: np.ndarray) -> None:
        (x0, y0, z0), (x1, y1, z1), (x2, y2, z2) = corners.tolist()
        left, right = max(math.floor(min(x0, x1, x2)), 0), min(math.ceil(max(x0, x1, x2)), self.depth.shape[1])
        top, bottom = max(math.floor(min(y0, y1, y2)), 0), min(math.ceil(max(y0, y1, y2)), self.depth.shape[0])
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if left >= right or top >= bottom or abs(area) < 1e-9:
            return
        x, y = np.arange(left, right) + 0.5, np.arange(top, bottom)[:, None] + 0.5
        first = ((x1 - x) * (y2 - y) - (x2 - x) * (y1 - y)) / area
        second = ((x2 - x) * (y0 - y) - (x0 - x) * (y2 - y)) / area
        third = 1.0 - first - second
        depth = first * z0 + second * z1 + third * z2
        window = self.depth[top:bottom, left:right]
        # A slack of rounding, so that no seam opens between neighbours.
        shown = (first >= -1e-9) & (second >= -1e-9) & (third >= -1e-9) & (depth < window)
        window[shown] = depth[shown]
        self.pixels[top:bottom, left:right][shown] = color
