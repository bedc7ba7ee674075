"""Random terrain: cuboids, walls and staircases in the paper's nine training categories, and richer categories.

A map is a function of (seed, category, index) alone, so every map can be made again on any machine and in any order.

Convention: a scene has the frame of the robot that starts in it: x forward, y left, the robot's base at (0, 0).
"""

import hashlib
import math
from collections.abc import Callable

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.extensions import TERRAIN, extension_place, extensions, load_extension
from hdsp.base.settings import CountRange, Positive, Range, checked
from hdsp.robot import lattice
from hdsp.robot.lattice import PATCH_CELLS
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.obstacles import Bank, Block, Obstacle, Ramp, Scene, Staircase, Tiles, Tilted, TiltedGround

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
    "plane": ("plane",),
    "plane_mixed": ("plane", "any"),
    "plane_clutter": ("plane",) + ("clutter",) * 3,
    "long_ramp": ("long_ramp",),
    "long_ramp_mixed": ("long_ramp", "any"),
    "tilted_2": ("tilted",) * 2,
    "kerb": ("kerb",),
    "kerb_smeared": ("kerb_smeared",),
}
#: The paper's categories.
CATEGORIES = tuple(_CONTENTS)[:9]
#: Categories with slopes and kerbs.
SLOPE_CATEGORIES = tuple(_CONTENTS)[15:]
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
        plane_slope: angle of tilted ground, rad; its direction is any.
        long_ramp_slope, long_ramp_run, long_ramp_width: angle (rad), horizontal length and width (m) of a ramp between
            two landings.
        landing: length of the level ground behind a long ramp or a kerb, m.
        tilted_side, tilted_height, tilted_slope: side lengths of a tilted block and its middle's height, m; angle of
            its upper side, rad.
        kerb_height, kerb_length: m.
        kerb_smear: horizontal length over which a coarse map shows a kerb's edge, m.

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
    plane_slope: Range = (0.03, 0.35)
    long_ramp_slope: Range = (0.05, 0.35)
    long_ramp_run: Range = (1.0, 4.0)
    long_ramp_width: Range = (1.2, 4.0)
    landing: Positive = 2.0
    tilted_side: Range = (0.4, 2.0)
    tilted_height: Range = (0.02, 0.3)
    tilted_slope: Range = (0.05, 0.4)
    kerb_height: Range = (0.05, 0.2)
    kerb_length: Range = (1.0, 4.0)
    kerb_smear: Range = (0.05, 0.15)


def random_scene(seed: int, category: str, index: int, settings: TerrainSettings | None = None) -> Scene:
    """Draws scene number ``index`` in a category.

    A category of another package (entry point ``hdsp.terrain``, or ``module:function``) is a function
    ``draw(random, settings)`` that returns obstacles (`hdsp.terrain.obstacles`) and at most one ``TiltedGround``.

    Raises:
        InputError: if the category is unknown, or the seed or index is negative.
    """
    if not is_category(category):
        raise InputError(f"terrain category {category!r}; need one of {', '.join(categories())}")
    if seed < 0 or index < 0:
        raise InputError(f"terrain seed {seed}, index {index}; need numbers of at least 0")
    settings = settings or TerrainSettings()
    random = np.random.default_rng(np.random.SeedSequence([seed, category_number(category), index]))
    if category in _CONTENTS:
        drawn = [_DRAW[kind](random, settings) for kind in _CONTENTS[category]]
    else:
        drawn = list(load_extension(TERRAIN, category)(random, settings))
    ground = next((part for part in drawn if isinstance(part, TiltedGround)), None)
    return Scene(tuple(part for part in drawn if not isinstance(part, TiltedGround)), ground)


def categories() -> tuple[str, ...]:
    """Returns the names of all categories, also those of other packages."""
    return (*ALL_CATEGORIES, *sorted(extensions(TERRAIN).keys() - _CONTENTS.keys()))


def is_category(name: str) -> bool:
    """Whether a category has this name, or the name is ``module:function``."""
    return name in _CONTENTS or extension_place(TERRAIN, name) is not None


def category_number(category: str) -> int:
    """Returns a category's part in the seed for its maps; a hash of the name for another package's category."""
    if category in _CONTENTS:
        return ALL_CATEGORIES.index(category)
    return int.from_bytes(hashlib.sha256(category.encode()).digest()[:8], "little")


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

    Example:
        >>> random_map(seed=1, category="staircase", index=0).shape
        (72, 72)
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


def _plane(random: np.random.Generator, settings: TerrainSettings) -> TiltedGround:
    return TiltedGround(*_slopes(random, settings.plane_slope))


def _slopes(random: np.random.Generator, angle: Range) -> tuple[float, float]:
    """Rise over run along x and along y, for an angle in the range and any direction."""
    steepest, uphill = math.tan(random.uniform(*angle)), _any_yaw(random)
    return steepest * math.cos(uphill), steepest * math.sin(uphill)


def _long_ramp(random: np.random.Generator, settings: TerrainSettings) -> Bank:
    run, width = random.uniform(*settings.long_ramp_run), random.uniform(*settings.long_ramp_width)
    height = run * math.tan(random.uniform(*settings.long_ramp_slope))
    from_top = bool(random.integers(2))  # the foot or the top of the ramp is near the robot
    return _bank(random, settings, height, width, run, from_top)


def _kerb(random: np.random.Generator, settings: TerrainSettings) -> Bank:
    return _bank(random, settings, random.uniform(*settings.kerb_height), random.uniform(*settings.kerb_length), 0.0)


def _kerb_smeared(random: np.random.Generator, settings: TerrainSettings) -> Bank:
    height, length = random.uniform(*settings.kerb_height), random.uniform(*settings.kerb_length)
    return _bank(random, settings, height, length, random.uniform(*settings.kerb_smear))


def _bank(
    random: np.random.Generator,
    settings: TerrainSettings,
    height: float,
    width: float,
    run: float,
    from_top: bool = False,
) -> Bank:
    """Bank with the foot or the top of its incline at a random position."""
    (x, y), yaw, length = _position(random, settings), _any_yaw(random), run + settings.landing
    ahead = length / 2 - (run if from_top else 0.0)
    return Bank(x + ahead * math.cos(yaw), y + ahead * math.sin(yaw), yaw, length, width, height, run)


def _tilted(random: np.random.Generator, settings: TerrainSettings) -> Tilted:
    length, width = random.uniform(*settings.tilted_side, size=2).tolist()
    block = *_position(random, settings), _any_yaw(random), length, width, random.uniform(*settings.tilted_height)
    return Tilted(*block, *_slopes(random, settings.tilted_slope))


def _any(random: np.random.Generator, settings: TerrainSettings) -> Obstacle:
    return _DRAW_OBSTACLE[_ANY[int(random.integers(len(_ANY)))]](random, settings)


_ANY = ("cuboid", "wall", "staircase", "ramp", "tiles")
_DRAW_OBSTACLE: dict[str, Callable[[np.random.Generator, TerrainSettings], Obstacle]] = {
    "cuboid": _cuboid,
    "wall": _wall,
    "staircase": _staircase,
    "staircase_focused": _staircase_focused,
    "ramp": _ramp,
    "tiles": _tiles,
    "clutter": _clutter,
    "any": _any,
    "long_ramp": _long_ramp,
    "tilted": _tilted,
    "kerb": _kerb,
    "kerb_smeared": _kerb_smeared,
}
_DRAW: dict[str, Callable[[np.random.Generator, TerrainSettings], Obstacle | TiltedGround]] = {
    **_DRAW_OBSTACLE,
    "plane": _plane,
}
