"""Causes for which a detailed state is invalid, each at its place."""

from __future__ import annotations

import math

import numpy as np

from hdsp.detailed.actions.state_costs import foot_row
from hdsp.detailed.causes.cause import Cause, Kind, Place
from hdsp.detailed.relaxed.proofs import body_hits
from hdsp.detailed.world.body import is_steep
from hdsp.detailed.world.world import World, cell_index
from hdsp.robot.lattice import Grid, cells, metres
from hdsp.robot.robot import FEET, Robot
from hdsp.terrain.cost_maps import disc_mask
from hdsp.terrain.inclination import inclination_at_cell
from hdsp.terrain.rounding import height_tolerance


def faults_of(world: World, grid: Grid, robot: Robot, state: np.ndarray) -> tuple[Cause, ...]:
    """Returns the causes for which a state is invalid; none for a valid state.

    Args:
        world: terrain and robot, compiled.
        grid: place of the terrain in the world.
        robot: its limits.
        state: int64 [7], lattice units; the base is on the map.
    """
    pose = tuple(float(value) for value in grid.to_world(state))
    found = [*_foot_faults(world, grid, robot, state, pose), *_separation_faults(robot, state, pose)]
    if world.height[int(cell_index(world, state[0], state[1]))] == -np.inf:
        found.append(Cause(Kind.UNKNOWN, (pose[0], pose[1]), pose=pose))
    if all(cause.kind != Kind.REACH for cause in found) and len(hits := body_hits(world, state)):
        height = float(world.height[cell_index(world, *hits[0])])
        found.append(Cause(Kind.BODY, place_of(grid, hits[0]), height, pose=pose))
    return tuple(found)


def _foot_faults(world: World, grid: Grid, robot: Robot, state: np.ndarray, pose: tuple[float, ...]) -> list[Cause]:
    found: list[Cause] = []
    low, high = robot.offset_range()
    for foot, name in enumerate(FEET):
        offset = int(state[3 + foot])
        if not low <= offset <= high:
            limit = robot.feet.offset_min if offset < low else robot.feet.offset_max
            found.append(Cause(Kind.REACH, (pose[0], pose[1]), metres(offset), limit, name, pose=pose))
            continue
        cell = cell_under(world, state, foot)
        fault = ground_fault(world, grid, robot, cell, name)
        if fault is None and is_steep(world, int(state[2]), *(4 * (flat_index(world, cell),))):
            fault = _slope(world, grid, robot, cell, name)
        if fault is not None:
            found.append(_at(fault, place_of(grid, cell), pose))
    return found


def _at(cause: Cause, foot_place: Place | None, pose: tuple[float, ...] | None) -> Cause:
    return Cause(cause.kind, cause.place, cause.amount, cause.limit, cause.foot, foot_place, pose)


def _separation_faults(robot: Robot, state: np.ndarray, pose: tuple[float, ...]) -> list[Cause]:
    found, least = [], robot.feet.min_separation
    for front, rear in ((0, 1), (3, 2)):
        apart = 2 * robot.feet.neutral_x + metres(int(state[3 + front] - state[3 + rear]))
        if apart < least - 1e-9:
            found.append(Cause(Kind.SEPARATION, (pose[0], pose[1]), apart, least, FEET[front], pose=pose))
    return found


def cell_under(world: World, state: np.ndarray, foot: int) -> tuple[int, int]:
    """Map cell (ix, iy) under a foot, also off the map."""
    row = foot_row(world.tables, int(state[2]), foot, int(state[3 + foot]) - world.tables.lowest)
    flat = int(cell_index(world, state[0], state[1])) + int(world.tables.feet[row])
    return flat // world.stride - world.pad, flat % world.stride - world.pad


def flat_index(world: World, cell: tuple[int, int]) -> int:
    """Index of a map cell in the arrays of ``World``."""
    return int(cell_index(world, *cell))


def place_of(grid: Grid, cell) -> Place:
    """World position (x, y) of a cell's centre, m."""
    x, y = grid.center(cell)
    return float(x), float(y)


def ground_fault(world: World, grid: Grid, robot: Robot, cell: tuple[int, int], foot: str | None) -> Cause | None:
    """Returns the cause for which no foot can stand in a cell (ix, iy) at any heading; None for a foothold.

    The cause is the unknown cell or the edge that is nearest within the foot's clearance; without one, it is the slope.
    """
    if not (0 <= cell[0] < world.nx and 0 <= cell[1] < world.ny):
        return Cause(Kind.BORDER, place_of(grid, cell), foot=foot)
    if world.standable[flat_index(world, cell)]:
        return None
    mask = disc_mask(cells(robot.feet.clearance))
    around = np.argwhere(mask) - len(mask) // 2
    for near in (np.array(cell) + around[np.argsort((around**2).sum(axis=1), kind="stable")]).tolist():
        if (barrier := _barrier(world, grid, robot, (near[0], near[1]), foot)) is not None:
            return barrier
    return _slope(world, grid, robot, cell, foot)


def _barrier(world: World, grid: Grid, robot: Robot, cell: tuple[int, int], foot: str | None) -> Cause | None:
    """The cell as a cause: unknown, or an edge that no wheel passes."""
    if not (0 <= cell[0] < world.nx and 0 <= cell[1] < world.ny) or not world.edge[flat_index(world, cell)]:
        return None
    height = float(world.height[flat_index(world, cell)])
    if height == -math.inf:
        return Cause(Kind.UNKNOWN, place_of(grid, cell), foot=foot)
    difference = height_difference(world, cell)
    if difference <= robot.drive.highest_edge + height_tolerance(height):
        return None  # too steep, but no edge
    return Cause(Kind.EDGE, place_of(grid, cell), difference, robot.drive.highest_edge, foot)


def height_difference(world: World, cell: tuple[int, int]) -> float:
    """Largest height difference (m) between a known cell and its known neighbours."""
    at = flat_index(world, cell)
    around = world.height[[at + i * world.stride + j for i in (-1, 0, 1) for j in (-1, 0, 1)]]
    return float(abs(around[np.isfinite(around)] - world.height[at]).max())


def _slope(world: World, grid: Grid, robot: Robot, cell: tuple[int, int], foot: str | None) -> Cause:
    heights = world.height.reshape(-1, world.stride)[world.pad :, world.pad :][: world.nx, : world.ny]
    angle = inclination_at_cell(heights, cell, robot)
    limits = sorted([robot.slope.max_pitch, robot.slope.max_roll])
    # Ground that is too steep at every heading is usually beyond the larger limit.
    limit = limits[1] if angle > limits[1] else limits[0]
    return Cause(Kind.SLOPE, place_of(grid, cell), angle, limit, foot)
