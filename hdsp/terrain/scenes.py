"""Random terrain: cuboids, walls and staircases in the paper's nine training categories, and richer categories.

A map is a function of (seed, category, index) alone, so every map can be made again on any machine and in any order.

Convention: a scene has the frame of the robot that starts in it: x forward, y left, the robot's base at (0, 0).
"""

import math
from collections.abc import Callable

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.settings import CountRange, Positive, Range, checked
from hdsp.robot import lattice
from hdsp.robot.lattice import PATCH_CELLS
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.obstacles import Block, Obstacle, Ramp, Scene, Staircase, Tiles

#: Contents of each category, in order. A category's position in this table is part of the seed for its maps.
_CONTENTS = {
    "cuboid_1": ("cuboid",),
    "cuboid_2": ("cuboid", "cuboid"),
    "cuboid_3": ("cuboid", "cuboid", "cuboid"),
    "wall_1": ("wall",),
    "wall_2": ("wall", "wall"),
    "cuboid_wall": ("cuboid", "wall"),
    "staircase": ("staircase",),
    "staircase_wall": ("staircase", "wall"),
    "staircase_focused": ("staircase_focused",),
    "mixed_2": ("any",) * 2,
    "mixed_3": ("any",) * 3,
    "mixed_4": ("any",) * 4,
    "ramp_mixed": ("ramp", "any"),
    "tiles_mixed": ("tiles", "any"),
    "clutter": ("clutter",) * 6,
}
#: The paper's categories.
CATEGORIES = tuple(_CONTENTS)[:9]
#: The paper's categories, and richer ones that are closer to real places.
ALL_CATEGORIES = tuple(_CONTENTS)


@checked
class TerrainSettings:
    """Ranges from which obstacles are drawn uniformly. The defaults are the authors' ranges.

    Attributes:
        area: side length of the square in which obstacles are placed, m.
        cuboid_side, cuboid_height: m; both sides of a cuboid are drawn from the same range.
        wall_length, wall_thickness, wall_height: m.
        staircase_steps: smallest and largest number of steps.
        staircase_rise, staircase_tread, staircase_width: m.
        staircase_depth: step length behind the riser, m.
        focused_width: width of a focused staircase, m.
        focused_yaw: largest angle between a focused staircase and the robot's heading, rad.
        ramp_length, ramp_width, ramp_height: m; one end of a ramp is a drop.
        tiles_extent, tile_side: side lengths of a tile field and of one tile, m.
        tile_height, tile_slope: height at a tile's middle, m; its largest slope along either side.
        clutter_side, clutter_height: clutter dimensions (small free-standing blocks), m.

    Raises:
        InputError: if a range is empty or not positive.
    """

    area: Positive = 1.8
    cuboid_side: Range = (0.2, 2.0)
    cuboid_height: Range = (0.02, 0.4)
    wall_length: Range = (0.4, 3.0)
    wall_thickness: Range = (0.05, 0.35)
    wall_height: Range = (0.7, 2.0)
    staircase_steps: CountRange = (2, 4)
    staircase_rise: Range = (0.15, 0.30)
    staircase_tread: Range = (0.25, 0.35)
    staircase_width: Range = (0.9, 2.0)
    staircase_depth: Positive = 2.0
    focused_width: Range = (1.4, 2.0)
    focused_yaw: Positive = math.pi / 16
    ramp_length: Range = (0.6, 2.0)
    ramp_width: Range = (0.6, 2.0)
    ramp_height: Range = (0.05, 0.4)
    tiles_extent: Range = (0.6, 2.0)
    tile_side: Range = (0.25, 0.5)
    tile_height: Range = (0.02, 0.3)
    tile_slope: Positive = 0.25
    clutter_side: Range = (0.05, 0.4)
    clutter_height: Range = (0.05, 1.2)


def random_scene(seed: int, category: str, index: int, settings: TerrainSettings | None = None) -> Scene:
    """Draws scene number ``index`` in a category.

    Raises:
        InputError: if the category is unknown, or the seed or index is negative.
    """
    if category not in _CONTENTS:
        raise InputError(f"terrain category {category!r}; need one of {', '.join(ALL_CATEGORIES)}")
    if seed < 0 or index < 0:
        raise InputError(f"terrain seed {seed}, index {index}; need numbers of at least 0")
    settings = settings or TerrainSettings()
    random = np.random.default_rng(np.random.SeedSequence([seed, ALL_CATEGORIES.index(category), index]))
    return Scene(tuple(_DRAW[kind](random, settings) for kind in _CONTENTS[category]))


def random_map(
    seed: int,
    category: str,
    index: int,
    settings: TerrainSettings | None = None,
    cells: int = PATCH_CELLS,
    heading: int = 0,
) -> HeightMap:
    """Makes the map for a robot that starts in a random scene, at the centre of cell (cells // 2, cells // 2).

    Args:
        seed, category, index, settings: as in `random_scene`.
        cells: map side length in cells.
        heading: detailed start heading, [0, 64). The scene rotates with the robot, so the robot sees the same terrain
            at every heading. The map must then be larger than the patch cut from it.

    Returns:
        a height map with the start at world (0, 0).

    Raises:
        InputError: as `random_scene`.
    """
    scene = random_scene(seed, category, index, settings)
    return scene.rasterise((cells, cells), (cells // 2, cells // 2), float(lattice.heading_angle(heading)))


def _position(random: np.random.Generator, settings: TerrainSettings) -> tuple[float, float]:
    half = settings.area / 2
    return random.uniform(-half, half), random.uniform(-half, half)


def _any_yaw(random: np.random.Generator) -> float:
    return random.uniform(-math.pi, math.pi)


def _cuboid(random: np.random.Generator, settings: TerrainSettings) -> Block:
    length, width = random.uniform(*settings.cuboid_side, size=2).tolist()
    return Block(*_position(random, settings), _any_yaw(random), length, width, random.uniform(*settings.cuboid_height))


def _wall(random: np.random.Generator, settings: TerrainSettings) -> Block:
    length, thickness = random.uniform(*settings.wall_length), random.uniform(*settings.wall_thickness)
    return Block(
        *_position(random, settings), _any_yaw(random), length, thickness, random.uniform(*settings.wall_height)
    )


def _staircase(random: np.random.Generator, settings: TerrainSettings) -> Staircase:
    return _steps(random, settings, _any_yaw(random), settings.staircase_width)


def _staircase_focused(random: np.random.Generator, settings: TerrainSettings) -> Staircase:
    yaw = random.uniform(-settings.focused_yaw, settings.focused_yaw)
    return _steps(random, settings, yaw, settings.focused_width)


def _steps(random: np.random.Generator, settings: TerrainSettings, yaw: float, width: Range) -> Staircase:
    low, high = settings.staircase_steps
    return Staircase(
        *_position(random, settings),
        yaw,
        steps=int(random.integers(low, high, endpoint=True)),
        rise=random.uniform(*settings.staircase_rise),
        tread=random.uniform(*settings.staircase_tread),
        width=random.uniform(*width),
        depth=settings.staircase_depth,
    )


def _ramp(random: np.random.Generator, settings: TerrainSettings) -> Ramp:
    length, width = random.uniform(*settings.ramp_length), random.uniform(*settings.ramp_width)
    return Ramp(*_position(random, settings), _any_yaw(random), length, width, random.uniform(*settings.ramp_height))


def _tiles(random: np.random.Generator, settings: TerrainSettings) -> Tiles:
    length, width = random.uniform(*settings.tiles_extent, size=2).tolist()
    side, highest = random.uniform(*settings.tile_side), random.uniform(*settings.tile_height)
    shape = math.ceil(length / side), math.ceil(width / side)
    heights = random.uniform(settings.tile_height[0], highest, shape)
    slopes = random.uniform(-settings.tile_slope, settings.tile_slope, (*shape, 2))
    tiles = np.concatenate([heights[..., None], slopes], axis=-1).tolist()
    rows = tuple(tuple(tuple(tile) for tile in row) for row in tiles)
    return Tiles(*_position(random, settings), _any_yaw(random), length, width, highest, side, rows)


def _clutter(random: np.random.Generator, settings: TerrainSettings) -> Block:
    length, width = random.uniform(*settings.clutter_side, size=2).tolist()
    return Block(
        *_position(random, settings), _any_yaw(random), length, width, random.uniform(*settings.clutter_height)
    )


def _any(random: np.random.Generator, settings: TerrainSettings) -> Obstacle:
    return _DRAW[_ANY[int(random.integers(len(_ANY)))]](random, settings)


_ANY = ("cuboid", "wall", "staircase", "ramp", "tiles")
_DRAW: dict[str, Callable[[np.random.Generator, TerrainSettings], Obstacle]] = {
    "cuboid": _cuboid,
    "wall": _wall,
    "staircase": _staircase,
    "staircase_focused": _staircase_focused,
    "ramp": _ramp,
    "tiles": _tiles,
    "clutter": _clutter,
    "any": _any,
}
