"""Arenas: walled squares with obstacles, described in a file or drawn from a seed.

A random arena has two rooms with a door, blocks, and a platform at the end of stairs.

Convention: an arena spans [0, size] x [0, size] metres including its walls; x forward, y left.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from scipy import ndimage

from hdsp.base.errors import InputError
from hdsp.robot import lattice
from hdsp.robot.lattice import Grid
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import Block, Obstacle, Ramp, Range, Scene, Staircase


@dataclass(frozen=True)
class Arena:
    """A walled square with obstacles, the single source for height map, physics and pictures.

    Attributes:
        size: side length, m; a multiple of the cell size.
        scene: obstacles in world coordinates, including the surrounding walls.

    Raises:
        InputError: if the size is not a positive multiple of the cell size.
    """

    size: float
    scene: Scene

    def __post_init__(self):
        cells = lattice.cells(self.size) if math.isfinite(self.size) else 0.0
        if cells < 1 or abs(cells - round(cells)) > 1e-6:
            raise InputError(f"arena of {self.size} m; need a positive multiple of {lattice.RESOLUTION} m")

    def height_map(self) -> HeightMap:
        """Height map with the heights at the cell centres. No cell is unknown; the lower corner is at world (0, 0)."""
        cells = round(lattice.cells(self.size))
        x, y = np.moveaxis(Grid((0.0, 0.0), (cells, cells)).center(np.stack(np.indices((cells, cells)), -1)), -1, 0)
        return HeightMap(self.scene.heights_at(x, y))

    def blocks(self) -> list[Block]:
        """All blocks, including the blocks in staircases and ramps."""
        return [block for obstacle in self.scene.obstacles for block in obstacle.blocks()]


def read_arena(description: Mapping[str, Any]) -> Arena:
    """Makes an arena from plain values, as in ``conf/arena/paper.yaml``.

    Args:
        description: `size`, `wall_height` and `wall_thickness` in m, and optional lists `walls`, `blocks`, `ramps` and
            `staircases`. A wall is its centre line, from x, y to x, y; the wall extends half its thickness beyond both
            ends. The other obstacles have the attributes defined by their classes in `hdsp.terrain.scenes`, with `yaw`
            optional. The function adds the walls around the arena. Other keys are ignored.

    Raises:
        InputError: if a value is missing, unknown or not a number; the message names it.
    """
    size, height, thickness = (
        _positive(description.get(name), f"arena.{name}") for name in ("size", "wall_height", "wall_thickness")
    )
    obstacles = walls_around(size, height, thickness)
    for line in description.get("walls") or ():
        if len(line) != 4 or not all(_is_number(value) for value in line):
            raise InputError(f"arena.walls {line}; need four numbers: from x, y to x, y, in m")
        obstacles.append(_wall(line, height, thickness))
    for key, kind in (("blocks", Block), ("ramps", Ramp), ("staircases", Staircase)):
        obstacles += [_obstacle(kind, values, f"arena.{key}") for values in description.get(key) or ()]
    return Arena(size, Scene(tuple(obstacles)))


def walls_around(size: float, height: float, thickness: float) -> list[Obstacle]:
    """Walls along the inside of an arena's border; lengths in m."""
    low, high = thickness / 2, size - thickness / 2
    lines = [(low, low, high, low), (high, low, high, high), (high, high, low, high), (low, high, low, low)]
    return [_wall(line, height, thickness) for line in lines]


def _wall(line: Sequence[float], height: float, thickness: float) -> Block:
    x0, y0, x1, y1 = line
    length = math.hypot(x1 - x0, y1 - y0) + thickness
    return Block((x0 + x1) / 2, (y0 + y1) / 2, math.atan2(y1 - y0, x1 - x0), length, thickness, height)


def _obstacle(kind: type, values: Mapping[str, Any], where: str) -> Obstacle:
    names = [field.name for field in fields(kind)]
    values = {"yaw": 0.0, **values}
    if wrong := sorted(set(names) ^ set(values)):
        raise InputError(f"{where} {dict(values)}: {wrong[0]!r} is missing or unknown; need {', '.join(names)}")
    for name, value in values.items():
        if name in ("x", "y", "yaw"):
            if not _is_number(value):
                raise InputError(f"{where}: {name} is {value!r}; need a finite number")
        else:
            _positive(value, f"{where}: {name}")
    return kind(**values)


def _positive(value: Any, where: str) -> float:
    if not _is_number(value) or value <= 0:
        raise InputError(f"{where} is {value!r}; need a positive number")
    return value


def _is_number(value) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


@dataclass(frozen=True)
class ArenaSettings:
    """Contents of a random arena; lengths in metres. Each value is drawn uniformly from its range.

    Attributes:
        wall_height, wall_thickness: dimensions of all walls.
        door_width: width of the opening in the wall between the rooms.
        blocks: number of cuboids too high to be driven over.
        block_side, block_height: dimensions of these cuboids.
        bumps: number of low cuboids.
        bump_side, bump_height: dimensions of the low cuboids.
        steps: number of stair steps.
        rise, tread: step height, distance between two risers.
        platform: side length of the square landing above the stairs.
        clearance: space around its centre that the robot needs to stand and to pass.
        least_free_share: smallest share of either half of the arena in which the robot's centre has this clearance.
    """

    wall_height: float = 1.0
    wall_thickness: float = 0.1
    door_width: Range = (1.0, 1.2)
    blocks: int = 4
    block_side: Range = (0.2, 0.6)
    block_height: Range = (0.1, 0.3)
    bumps: int = 3
    bump_side: Range = (0.3, 0.8)
    bump_height: Range = (0.02, 0.045)
    steps: int = 2
    rise: Range = (0.15, 0.18)
    tread: Range = (0.30, 0.35)
    platform: Range = (1.2, 1.4)
    clearance: float = 0.43
    least_free_share: float = 0.3


#: Smallest arena, m: it has space for a turning robot in both rooms, and for a platform with stairs.
SMALLEST = 4.0

_ATTEMPTS = 200
_DRIVABLE = 0.05  # m; a lower bump takes no space from the robot


def random_arena(seed: int, size: float = 5.0, settings: ArenaSettings | None = None) -> HeightMap:
    """Draws a walled square with two rooms and a door; the platform stands in a corner of the farther room.

    Arenas are drawn until one has suitable free ground: connected, large enough in both rooms, and leading to the
    stairs.

    Args:
        seed: seed for the random generator.
        size: side length, m.
        settings: arena contents.

    Returns:
        a height map with its lower corner at world (0, 0).

    Raises:
        InputError: if the size is below 4 m, or no arena with these settings has enough free ground.
    """
    settings = settings or ArenaSettings()
    if not (math.isfinite(size) and size >= SMALLEST):
        raise InputError(f"arena of {size} m; need a side of at least {SMALLEST} m")
    if seed < 0:
        raise InputError(f"arena seed {seed}; need a number of at least 0")
    random = np.random.default_rng(seed)
    for _ in range(_ATTEMPTS):
        terrain, stairs = _draw(random, size, settings)
        if _passable(terrain, stairs, settings):
            return terrain
    raise InputError(
        f"arena: none of {_ATTEMPTS} drawn with seed {seed} has {settings.least_free_share:.0%} of free ground in one "
        "piece; need fewer blocks, a wider door or a larger size"
    )


def _draw(random: np.random.Generator, size: float, settings: ArenaSettings) -> tuple[HeightMap, Staircase]:
    thickness = settings.wall_thickness
    inside = thickness, size - thickness

    def wall(x: Range, y: Range) -> Block:
        return Block(sum(x) / 2, sum(y) / 2, 0.0, x[1] - x[0], y[1] - y[0], settings.wall_height)

    def cuboids(count: int, side: Range, height: Range) -> list[Block]:
        return [
            Block(
                *random.uniform(*inside, size=2).tolist(),
                random.uniform(-math.pi, math.pi),
                *random.uniform(*side, size=2).tolist(),
                random.uniform(*height),
            )
            for _ in range(count)
        ]

    between = random.uniform(0.42, 0.48) * size
    between = between, between + thickness
    door = random.uniform(*settings.door_width)
    door_from = random.uniform(inside[0] + settings.clearance, inside[1] - settings.clearance - door)
    stairs = _stairs(random, inside[1], inside, settings)
    obstacles: list[Obstacle] = [
        wall((0.0, thickness), (0.0, size)),
        wall((size - thickness, size), (0.0, size)),
        wall((0.0, size), (0.0, thickness)),
        wall((0.0, size), (size - thickness, size)),
        wall(between, (0.0, door_from)),
        wall(between, (door_from + door, size)),
        stairs,
        *cuboids(settings.blocks, settings.block_side, settings.block_height),
        *cuboids(settings.bumps, settings.bump_side, settings.bump_height),
    ]
    return Arena(size, Scene(tuple(obstacles))).height_map(), stairs


def _stairs(random: np.random.Generator, far: float, inside: Range, settings: ArenaSettings) -> Staircase:
    """Stairs along the farther room's wall up to a landing in one of its corners."""
    landing, tread = random.uniform(*settings.platform), random.uniform(*settings.tread)
    length = landing + (settings.steps - 1) * tread
    up = random.random() < 0.5
    return Staircase(
        x=far - landing / 2,
        y=inside[1] - length if up else inside[0] + length,
        yaw=math.pi / 2 if up else -math.pi / 2,
        steps=settings.steps,
        rise=random.uniform(*settings.rise),
        tread=tread,
        width=landing,
        depth=landing,
    )


def _passable(terrain: HeightMap, stairs: Staircase, settings: ArenaSettings) -> bool:
    """Whether the free ground is connected, large enough in both rooms, and leads to stairs with a free landing."""
    heights = terrain.heights
    edges = ndimage.maximum_filter(heights, 3) - ndimage.minimum_filter(heights, 3) > _DRIVABLE
    room = ndimage.distance_transform_edt(~edges)
    free = room >= lattice.cells(settings.clearance)
    pieces, _ = ndimage.label(free & (heights < settings.rise[0]))
    ahead = stairs.y - math.copysign(settings.clearance + 2 * lattice.RESOLUTION, stairs.yaw)
    foot = tuple(Grid(terrain.origin, terrain.shape).cell((stairs.x, ahead)))
    landing = free & (np.abs(heights - stairs.steps * stairs.rise) < 1e-3)
    ground = pieces == pieces[foot]
    rooms = np.array_split(ground, [round(heights.shape[0] * 0.45)], axis=0)
    return bool(
        pieces[foot]
        and landing.any()
        and all(part.mean() >= settings.least_free_share for part in rooms)
        and ground.sum() >= 0.95 * (pieces > 0).sum()
    )
