"""Random arenas: two rooms with a door, blocks, and a platform at the end of stairs.

Convention: as in `hdsp.terrain.arenas`.
"""

import math
from dataclasses import field
from typing import Literal

import numpy as np
from scipy import ndimage

from hdsp.base.errors import InputError
from hdsp.base.settings import Count, Natural, Positive, Range, Seed, Share, checked
from hdsp.robot import lattice
from hdsp.robot.lattice import Grid
from hdsp.terrain.arenas import Arena, ArenaSize, ArenaTasks
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.obstacles import Block, Obstacle, Scene, Staircase


@checked
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

    wall_height: Positive = 1.0
    wall_thickness: Positive = 0.1
    door_width: Range = (1.0, 1.2)
    blocks: Natural = 4
    block_side: Range = (0.2, 0.6)
    block_height: Range = (0.1, 0.3)
    bumps: Natural = 3
    bump_side: Range = (0.3, 0.8)
    bump_height: Range = (0.02, 0.045)
    steps: Count = 2
    rise: Range = (0.15, 0.18)
    tread: Range = (0.30, 0.35)
    platform: Range = (1.2, 1.4)
    clearance: Positive = 0.43
    least_free_share: Share = 0.3


@checked
class RandomArena:
    """A random arena from a file, as in ``conf/arena/small.yaml``.

    Attributes:
        size: side length, m; a multiple of the cell size.
        seed: seed for the random generator.
        contents: arena contents.
        tasks: starts and goals for the planning experiment.
        source: ``random``; the planning experiment uses the true heights.
    """

    size: ArenaSize
    seed: Seed
    contents: ArenaSettings = field(default_factory=ArenaSettings)
    tasks: ArenaTasks = ()
    source: Literal["random"] = "random"


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

    Example:
        >>> terrain = random_arena(seed=7, size=5.0)
        >>> terrain.size, float(terrain.heights.max())
        ((5.0, 5.0), 1.0)
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

    def cuboid(side: Range, height: Range) -> Block:
        x, y = random.uniform(*inside, size=2).tolist()
        yaw = random.uniform(-math.pi, math.pi)
        length, width = random.uniform(*side, size=2).tolist()
        return Block(x, y, yaw, length, width, random.uniform(*height))

    middle = random.uniform(0.42, 0.48) * size
    between = middle, middle + thickness
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
        *(cuboid(settings.block_side, settings.block_height) for _ in range(settings.blocks)),
        *(cuboid(settings.bump_side, settings.bump_height) for _ in range(settings.bumps)),
    ]
    return Arena(size, Scene(tuple(obstacles))).height_map(), stairs


def _stairs(random: np.random.Generator, far: float, inside: Range, settings: ArenaSettings) -> Staircase:
    """Stairs along the farther room's wall up to a landing in a corner."""
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
    ahead = stairs.y - math.copysign(settings.clearance + lattice.metres(2), stairs.yaw)
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
