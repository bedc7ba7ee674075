"""Place of a simulation in the world: physics and pictures lose precision at coordinates of projected maps."""

from __future__ import annotations

from dataclasses import replace

from hdsp.detailed.motion.motion import Motion
from hdsp.terrain.height_map import HeightMap

_FAR = 100.0  # m

#: World position (x, y) of a simulation's origin, m.
Place = tuple[float, float]


def local_place(terrain: HeightMap) -> Place:
    """Returns the origin of a simulation: that of the map if it is far from zero, else (0, 0)."""
    return terrain.origin if max(abs(value) for value in terrain.origin) > _FAR else (0.0, 0.0)


def relative(motion: Motion, place: Place) -> Motion:
    """Returns a motion with its map in coordinates relative to a place."""
    if place == (0.0, 0.0):
        return motion
    x, y = place
    terrain = motion.terrain
    return replace(
        motion,
        base=motion.base - (x, y, 0, 0, 0, 0),
        feet=motion.feet - (x, y, 0),
        terrain=replace(terrain, origin=(terrain.origin[0] - x, terrain.origin[1] - y)),
    )
