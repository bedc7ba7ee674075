"""A compiled world after a change of the map: compiled anew where the change reaches, copied elsewhere.

What a cell of ``World`` says depends on the heights within a certain distance alone. A part of the map, with that
distance around the change and again around that, is compiled as a map of its own; what lies within the first distance
is then the same as in the whole, to the last bit.
"""

import math

import numpy as np

from hdsp.detailed.world.world import World, build_world
from hdsp.robot.lattice import cells
from hdsp.robot.robot import Robot
from hdsp.terrain.cost_maps import disc_mask
from hdsp.terrain.height_map import HeightMap

#: A part that holds more than this share of the map's cells is not worth the copying.
LARGEST_SHARE = 0.5
_MAPS = ("standable", "uneven", "height", "swing", "window_height", "edge", "steps", "base")


def updated_world(world: World, terrain: HeightMap, robot: Robot, changed: np.ndarray) -> World:
    """The world of a map that differs in some cells from that of another world; the other one is not touched.

    Args:
        world: the other world, of the same robot and of a map of the same shape.
        terrain: the map.
        robot: the robot.
        changed: bool [nx, ny], the cells in which the maps differ.

    Returns:
        As ``build_world`` gives it, with ``base`` filled in where nothing near has changed. ``banned`` is kept.
    """
    if not changed.any():
        return world
    reach = influence(robot)
    part, pasted = _rectangle(changed, 2 * reach), _rectangle(changed, reach)
    if terrain.heights[part].size > LARGEST_SHARE * terrain.heights.size:
        return build_world(terrain, robot)._replace(banned=world.banned)
    new = build_world(HeightMap(terrain.heights[part], resolution=terrain.resolution), robot)
    source, target = [], []
    for cut, whole in zip(pasted, part, strict=True):
        source.append(slice(cut.start - whole.start + new.pad, cut.stop - whole.start + new.pad))
        target.append(slice(cut.start + world.pad, cut.stop + world.pad))
    maps = {name: getattr(world, name).copy() for name in _MAPS}
    for name, values in maps.items():
        _layers(values, world)[:, *target] = _layers(getattr(new, name), new)[:, *source]
    return world._replace(**maps)


def influence(robot: Robot) -> int:
    """Cells beyond which a height has no influence on what a ``World`` says of a cell."""
    clearance = len(disc_mask(cells(robot.feet.clearance))) // 2
    contact = math.hypot(robot.feet.contact_inward, robot.feet.contact_inward) + robot.feet.contact_half_width
    under_feet = cells(robot.drive.unevenness_radius + contact)
    stepping = cells(robot.step.max_length) + clearance
    corners = [math.hypot(max(abs(box.x_min), abs(box.x_max)), box.half_width) for box in robot.body.boxes]
    body = cells(max(corners, default=0.0))
    neutral_feet = cells(math.hypot(robot.feet.neutral_x, robot.feet.neutral_y))
    # One cell for the differences of heights, two for roundings on the way.
    return math.ceil(max(under_feet, stepping, body, neutral_feet)) + 3


def _rectangle(changed: np.ndarray, margin: int) -> tuple[slice, slice]:
    """The cells around all changed ones, with a margin that ends at the border of the map."""
    bounds = []
    for axis in (1, 0):
        at = np.flatnonzero(changed.any(axis=axis))
        bounds.append(slice(max(int(at[0]) - margin, 0), min(int(at[-1]) + 1 + margin, changed.shape[1 - axis])))
    return tuple(bounds)


def _layers(values: np.ndarray, world: World) -> np.ndarray:
    """A flat array of a world as view [layers, padded nx, padded ny]."""
    return values.reshape(-1, len(world.standable) // world.stride, world.stride)
