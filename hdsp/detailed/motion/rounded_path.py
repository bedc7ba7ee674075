"""Straight lines through given points, with corners rounded by parabolas.

Source: Kunz and Stilman, "Time-Optimal Trajectory Generation for Path Following with Bounded Acceleration and
Velocity", RSS 2012; parabolas stand in for their circles, so that a quantity's second derivative is constant in each.
"""

from __future__ import annotations

import numpy as np


class RoundedPath:
    """Smooth path near points.

    Attributes:
        at: float64 [m], path parameter s at each point, from 0 on.
        radius: float64 [m], s before and after each point in which the path leaves its lines.
    """

    def __init__(self, points: np.ndarray, length: np.ndarray, radius: np.ndarray):
        """Joins points.

        Args:
            points: float64 [m, d].
            length: float64 [m - 1], positive line lengths, in s.
            radius: float64 [m], as in the attributes, 0 at both ends; two neighbours together are no longer than their
                line.
        """
        self.at = np.concatenate([[0.0], np.cumsum(length)])
        self.radius = radius
        self._points = points
        self._slopes = np.diff(points, axis=0) / length[:, None] if len(length) else np.zeros((1, points.shape[1]))

    def pieces(self) -> tuple[np.ndarray, np.ndarray]:
        """Lengths (s): straight lines [m - 1], and the parabolas [m - 2] between them."""
        return np.diff(self.at) - self.radius[:-1] - self.radius[1:], 2 * self.radius[1:-1]

    def __call__(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns points and their derivatives by s, float64 [k, d] each, at path parameters [k]."""
        line = np.clip(np.searchsorted(self.at, s, side="right") - 1, 0, len(self._slopes) - 1)
        end = np.minimum(line + 1, len(self._points) - 1)
        point = self._points[line] + (s - self.at[line])[:, None] * self._slopes[line]
        slope = self._slopes[line].copy()
        for corner, into in ((line, 1.0), (end, -1.0)):
            radius = self.radius[corner]
            inside = np.maximum(radius - np.abs(s - self.at[corner]), 0.0)  # s from the end of the parabola
            bent = self._slopes[np.minimum(corner, len(self._slopes) - 1)] - self._slopes[np.maximum(corner - 1, 0)]
            share = np.divide(inside, 4 * radius, out=np.zeros_like(inside), where=radius > 0)[:, None]
            point += share * inside[:, None] * bent
            slope -= into * 2 * share * bent
        return point, slope
