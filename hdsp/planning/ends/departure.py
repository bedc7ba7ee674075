"""The start of a plan: the ground under a robot that stands there is known, and free of the robot itself.

A map often shows the robot: unknown cells that its sensors do not see, or its own body. A start that is invalid for
this reason is examined again on a map that is changed within the footprint alone:

- Unknown cells become ground, interpolated from the known ground around the footprint.
- If this does not suffice, objects that end within body and feet, and rise to the body height, are the robot
  itself, and become ground as well. An object that continues beyond the robot, or lies beside it, is none: the start
  stays invalid.

The footprint is the least rectangle around the body and the feet with their clearance, two cells wider because sensors
blur edges.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hdsp.base.gradual import Steps
from hdsp.detailed.causes import Cause
from hdsp.detailed.world.geometry import rectangle_cells
from hdsp.detailed.world.world import World
from hdsp.detailed.world.world_update import updated_world
from hdsp.planning.arguments import pose_values
from hdsp.planning.ends.location import locate
from hdsp.planning.ends.nearby import can_leave
from hdsp.planning.ends.way_out import WayOut, find_way_out
from hdsp.robot.lattice import Grid, metres
from hdsp.robot.robot import Robot
from hdsp.robot.shape import Rectangle
from hdsp.terrain.cost_maps import disc_mask
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.rounding import height_tolerance

_BLUR = 2  # cells around the footprint
_RIM = 4  # cells around these, in which the ground is looked for
_ROUNDS = 8  # of the fit of a plane to the ground


@dataclass(frozen=True, eq=False)
class Departure:
    """The start of a query.

    Attributes:
        state: int64 [7], lattice units.
        faults: causes for which it is invalid; empty for a valid state.
        terrain, world: the map with the ground under the start, and its compiled form.
        assumed: changes in the map, in words; empty if the map is as it was.
        way: the way out of the clearance of obstacles to ``state``; None if the plan begins there.
    """

    state: np.ndarray
    faults: list[Cause]
    terrain: HeightMap
    world: World
    assumed: tuple[str, ...] = ()
    way: WayOut | None = None


def departure_steps(
    terrain: HeightMap, world: World, grid: Grid, robot: Robot, wider: Robot, pose, free: bool, way_out: bool
) -> Steps[Departure]:
    """Finds the start at a pose, on the map as it is wherever the robot can leave it there, in steps.

    Args:
        terrain: the map.
        world: terrain and robot, compiled.
        grid: place of the terrain in the world.
        robot: the robot.
        wider: the robot with its margin.
        pose: as for ``locate``.
        free: whether the ground under the robot is known and free of itself.
        way_out: whether the robot may drive out of the clearance of obstacles first.

    Raises:
        InputError: as from ``locate``.
    """
    state, faults = locate(world, grid, wider, pose, "start")
    values = pose_values(pose, "start", wider)
    # T_a->d chooses displaced feet where neutral ones have no foothold, and the robot may not get away from there.
    chosen = len(values) == 3 and not faults and bool(state[3:].any())
    if not (free or way_out) or not (faults or (chosen and not can_leave(world, wider, state))):
        return Departure(state, faults, terrain, world)
    footed = state if len(values) == 7 else np.concatenate([state[:3], np.zeros(4, dtype=np.int64)])
    assumed = tuple[str, ...]()
    grounds = [(terrain, world, assumed)]
    for changed in _grounds(terrain, world, robot, wider, footed) if free else ():
        heights = terrain.heights.copy()
        heights[changed.cells] = changed.heights
        ground = replace(terrain, heights=heights)
        stood = updated_world(world, ground, wider, changed.cells)
        there, left = locate(stood, grid, wider, values, "start")
        if not left and (faults or can_leave(stood, wider, there)):
            return Departure(there, [], ground, stood, changed.words)
        grounds.append((ground, stood, changed.words))
        yield
    for ground, stood, assumed in grounds if way_out else ():
        way = find_way_out(ground, stood, robot, wider, footed)
        if way is not None:
            return Departure(way.states[-1], [], ground, stood, assumed, way)
        yield
    # Causes hold on the map as it is: on the changed ground, an edge may lie between the filled cells and others.
    return Departure(state, faults, terrain, world)


class _Ground(NamedTuple):
    """Changed ground under the robot: cells, bool [nx, ny], their heights, float32 [n], and the change in words."""

    cells: np.ndarray
    heights: np.ndarray
    words: tuple[str, ...]


def _grounds(terrain: HeightMap, world: World, robot: Robot, wider: Robot, state: np.ndarray) -> Iterator[_Ground]:
    """Yields changes of the ground under the robot, the smallest first."""
    from scipy.ndimage import binary_dilation

    own = _footprint(world, wider, state, wider.feet.clearance)
    rows, columns = (np.flatnonzero(own.any(axis=axis)) for axis in (1, 0))
    margin = _BLUR + _RIM + 1
    part = tuple(slice(max(int(at[0]) - margin, 0), int(at[-1]) + margin + 1) for at in (rows, columns))
    heights = terrain.heights[part].astype(float)
    body = _footprint(world, robot, state, 0.0)[part]
    own = binary_dilation(own[part], disc_mask(_BLUR))
    around = binary_dilation(own, disc_mask(_RIM))
    rim = around & ~own & np.isfinite(heights)
    plane = _plane(heights, rim if rim.any() else around, robot.drive.highest_edge)
    if plane is None:
        known = np.argwhere(np.isfinite(terrain.heights))
        if len(known) == 0:
            return
        x, y = known[np.argmin(np.hypot(*(known - state[:2]).T))]
        plane = np.full(heights.shape, float(terrain.heights[x, y]))
    with np.errstate(invalid="ignore"):
        objects = around & (heights - plane > robot.drive.highest_edge + height_tolerance(heights))
    itself = _own_parts(objects, heights - plane, body, min(box.above for box in robot.body.boxes))
    unknown = own & np.isnan(heights)
    for parts in (np.zeros_like(own), itself):
        missing = unknown | parts
        if not missing.any() or (parts is itself and not itself.any()):
            continue
        words = []
        if unknown.any():
            words.append(f"{_area(unknown)} m2 of unknown ground under the robot at the start are taken as ground")
        if parts.any():
            highest = float((heights - plane)[parts].max())
            words.append(
                f"{_area(parts)} m2 of the map under the start, up to {highest:.2f} m high, are taken as the robot"
            )
        changed = np.zeros(terrain.shape, dtype=bool)
        changed[part] = missing
        ground = around & ~missing & ~objects & np.isfinite(heights)
        filled = plane + _interpolated(heights - plane, ground)
        yield _Ground(changed, filled[missing].astype(np.float32), tuple(words))


def _own_parts(objects: np.ndarray, rise: np.ndarray, body: np.ndarray, belly: float) -> np.ndarray:
    """Cells of the objects that are parts of the robot: they end within its body, and are as high as its belly.

    Args:
        objects: bool [nx, ny], cells above the ground by more than a wheel passes.
        rise: float64 [nx, ny], height above the ground, m.
        body: bool [nx, ny], cells under body and feet.
        belly: least body height above the ground, m.
    """
    from scipy.ndimage import binary_dilation, label

    near = binary_dilation(body, disc_mask(_BLUR))
    regions, count = label(objects, np.ones((3, 3), int))
    found = np.zeros_like(objects)
    for k in range(1, count + 1):
        region = regions == k
        if not (region & ~near).any() and 2 * (region & body).sum() >= region.sum() and rise[region].max() >= belly:
            found |= region
    return found


def _area(cells_of: np.ndarray) -> str:
    return f"{np.count_nonzero(cells_of) * metres(1.0) ** 2:.2g}"


def _footprint(world: World, robot: Robot, state: np.ndarray, clear: float) -> np.ndarray:
    """Cells of the map in the least rectangle around the body and the feet with some clearance (m), bool [nx, ny]."""
    body = robot.body.boxes
    offsets = np.clip(metres(state[3:].astype(float)), robot.feet.offset_min, robot.feet.offset_max)
    ahead = robot.neutral_feet()[:, 0] + offsets
    rectangle = Rectangle(
        x_min=min([float(ahead.min()) - clear, *(box.x_min for box in body)]),
        x_max=max([float(ahead.max()) + clear, *(box.x_max for box in body)]),
        half_width=max([robot.feet.neutral_y + clear, *(box.half_width for box in body)]),
    )
    at = state[:2] + rectangle_cells(rectangle, int(state[2]))
    at = at[((at >= 0) & (at < (world.nx, world.ny))).all(axis=1)]
    own = np.zeros((world.nx, world.ny), dtype=bool)
    own[at[:, 0], at[:, 1]] = True
    return own


def _plane(heights: np.ndarray, around: np.ndarray, edge: float) -> np.ndarray | None:
    """Plane through the ground: most known cells lie on it, at most an edge away; None without known cells."""
    at = np.argwhere(around & np.isfinite(heights))
    if len(at) == 0:
        return None
    known = heights[at[:, 0], at[:, 1]]
    middle = at.mean(axis=0)
    terms = np.column_stack([np.ones(len(at)), at - middle])
    on = known <= np.median(known) + edge
    for _ in range(_ROUNDS):
        plane = np.linalg.lstsq(terms[on], known[on], rcond=1e-6)[0]
        near = abs(known - terms @ plane) <= edge
        if not near.any() or (near == on).all():
            break
        on = near
    x, y = np.indices(heights.shape)
    return plane[0] + plane[1] * (x - middle[0]) + plane[2] * (y - middle[1])


def _interpolated(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Values of known cells, linear between them, and those of the nearest known cell beyond; 0 without known cells."""
    from scipy.interpolate import LinearNDInterpolator
    from scipy.ndimage import distance_transform_edt
    from scipy.spatial import QhullError

    if not known.any():
        return np.zeros_like(values)
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    result = values[tuple(nearest)]
    at = np.argwhere(known)
    try:
        between = LinearNDInterpolator(at, values[known])(*np.indices(values.shape))
    except QhullError:  # all known cells lie in a line
        return result
    return np.where(np.isfinite(between), between, result)
