"""Coordinates relative to a place near a map: physics and pictures lose precision at those of projected maps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from hdsp.detailed.motion.motion import Motion
from hdsp.terrain.height_map import HeightMap

_FAR = 100.0  # m

#: World position (x, y) of the origin of other coordinates, m.
Place = tuple[float, float]


def local_place(terrain: HeightMap) -> Place:
    """Returns the origin for local coordinates: the map's own if it is far from zero, else (0, 0)."""
    return terrain.origin if max(abs(value) for value in terrain.origin) > _FAR else (0.0, 0.0)


def relative_points(points: ArrayLike, place: Place) -> np.ndarray:
    """Returns points or poses, float64 [..., n] with x and y first, relative to a place."""
    moved = np.array(points, dtype=float)
    moved[..., :2] -= place
    return moved


def relative_map(terrain: HeightMap, place: Place) -> HeightMap:
    """Returns a map in coordinates relative to a place."""
    if place == (0.0, 0.0):
        return terrain
    return replace(terrain, origin=(terrain.origin[0] - place[0], terrain.origin[1] - place[1]))


def relative(motion: Motion, place: Place) -> Motion:
    """Returns a motion with its map in coordinates relative to a place."""
    if place == (0.0, 0.0):
        return motion
    return replace(
        motion,
        base=relative_points(motion.base, place),
        feet=relative_points(motion.feet, place),
        terrain=relative_map(motion.terrain, place),
    )
