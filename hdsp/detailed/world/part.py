"""Rectangular part of a compiled terrain: the base stays inside, feet and body still see the ground around it."""

from typing import Any, NamedTuple

import numpy as np

from hdsp.detailed.world.body import BLOCKED
from hdsp.detailed.world.world import World, robot_tables
from hdsp.robot.lattice import HEADINGS
from hdsp.robot.robot import Robot

_MAPS = ("standable", "uneven", "height", "swing", "window_height", "edge", "steep", "steps", "base", "level_ground")


class Part(NamedTuple):
    """Rectangle of map cells: first cell (ix, iy), and numbers of cells (nx, ny)."""

    first: tuple[int, int]
    shape: tuple[int, int]


def part_of_world(world: World, robot: Robot, part: Part) -> World:
    """Cuts out a part with a border of the terrain around it.

    A search on the part finds the plans of the whole map whose bases stay inside, with memory for the part alone.
    Feet stand in the border too, so foothold regions come from the whole map (``part_of_map``).

    Args:
        world: terrain and robot.
        robot: the robot.
        part: rectangle inside the map.
    """
    nx, ny = part.shape
    maps: dict[str, Any] = {name: part_of_map(getattr(world, name), world, part) for name in _MAPS}
    around = np.ones((nx + 2 * world.pad, ny + 2 * world.pad), bool)
    around[world.pad : world.pad + nx, world.pad : world.pad + ny] = False
    border = np.flatnonzero(around)
    # No ground is high enough for a base in the border.
    maps["base"].reshape(HEADINGS, -1)[:, border] = BLOCKED
    maps["level_ground"].reshape(HEADINGS, -1)[:, border] = np.inf
    stride = around.shape[1]
    return world._replace(
        nx=nx,
        ny=ny,
        stride=stride,
        banned=_banned(world, part, around.shape),
        tables=robot_tables(robot, stride, around.size),
        **maps,
    )


def _banned(world: World, part: Part, shape: tuple[int, int]) -> np.ndarray:
    """Rows of ``World.banned`` whose feet stand in a part or its border of together ``shape`` cells."""
    flat = world.banned[:, 1]
    cell = np.stack([flat // world.stride, flat % world.stride], axis=1) - part.first
    inside = ((cell >= 0) & (cell < shape)).all(axis=1)
    banned = world.banned[inside]
    banned[:, 1] = cell[inside] @ (shape[1], 1)
    return banned


def part_of_map(values: np.ndarray, world: World, part: Part) -> np.ndarray:
    """Cuts a flat array [layers * cells of ``world``] to the cells of a part and its border; returns a copy."""
    first, last = (np.array(corner) for corner in (part.first, np.add(part.first, part.shape) + 2 * world.pad))
    layers = values.reshape(-1, len(world.standable) // world.stride, world.stride)
    return layers[:, first[0] : last[0], first[1] : last[1]].ravel()
