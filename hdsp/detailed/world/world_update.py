"""Update of a compiled world after a map change: the changed part is compiled again, the rest is copied.

A cell in ``World`` depends only on heights within a certain distance. The changed cells with a margin of twice this
distance are compiled as a separate map. Cells within one distance are then identical to the whole map's cells, to the
last bit.
"""

import math

import numpy as np

from hdsp.detailed.world.world import World, build_world
from hdsp.robot.lattice import cells
from hdsp.robot.robot import Robot
from hdsp.terrain.cost_maps import disc_mask, steep_reach
from hdsp.terrain.height_map import HeightMap

#: Largest share of the map's cells in a part; beyond it, copying saves too little.
LARGEST_SHARE = 0.5
_MAPS = ("standable", "uneven", "height", "swing", "window_height", "edge", "steep", "steps", "base")


def updated_world(world: World, terrain: HeightMap, robot: Robot, changed: np.ndarray) -> World:
    """Returns the world for a changed map. The world before the change stays as it is.

    Args:
        world: world before the change, with the same robot and map shape.
        terrain: map after the change.
        robot: the robot.
        changed: bool [nx, ny], cells in which the maps differ.

    Returns:
        The same as ``build_world``, with ``base`` filled in where no height nearby changed, and with ``banned`` kept.
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
    # Zeros from the operating system take no time until they are used; ``zeros_like`` writes all of them.
    return world._replace(**maps, level_ground=np.zeros(world.level_ground.shape, np.float32))


def influence(robot: Robot) -> int:
    """Distance in cells beyond which a height has no influence on a cell in ``World``."""
    clearance = len(disc_mask(cells(robot.feet.clearance))) // 2
    contact = math.hypot(robot.feet.contact_inward, robot.feet.contact_inward) + robot.feet.contact_half_width
    under_feet = cells(robot.drive.unevenness_radius + contact)
    stepping = cells(robot.step.max_length) + clearance
    corners = [math.hypot(max(abs(box.x_min), abs(box.x_max)), box.half_width) for box in robot.body.boxes]
    body = cells(max(corners, default=0.0))
    neutral_feet = cells(math.hypot(robot.feet.neutral_x, robot.feet.neutral_y))
    slope = steep_reach(robot)
    # One cell for height differences, two for rounding.
    return math.ceil(max(under_feet, stepping, body, neutral_feet + slope, stepping + slope)) + 3


def _rectangle(changed: np.ndarray, margin: int) -> tuple[slice, slice]:
    """Slices around all changed cells with a margin, cut off at the map border."""

    def span(axis: int) -> slice:
        at = np.flatnonzero(changed.any(axis=1 - axis))
        return slice(max(int(at[0]) - margin, 0), min(int(at[-1]) + 1 + margin, changed.shape[axis]))

    return span(0), span(1)


def _layers(values: np.ndarray, world: World) -> np.ndarray:
    """Flat array in a world as a view, [layers, padded nx, padded ny]."""
    return values.reshape(-1, len(world.standable) // world.stride, world.stride)
