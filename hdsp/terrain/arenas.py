"""Arenas: walled squares with obstacles, described in a file or drawn from a seed.

A random arena has two rooms with a door, blocks, and a platform at the end of stairs.

Convention: an arena spans [0, size] x [0, size] metres including its walls; x forward, y left.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field
from scipy import ndimage

from hdsp.base.errors import InputError
from hdsp.base.settings import Count, Name, Natural, Positive, Range, Share, checked, fault, load_settings
from hdsp.robot import lattice
from hdsp.robot.lattice import Grid
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import Block, Obstacle, Ramp, Scene, Staircase


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
        if not (0 < self.size < math.inf and _is_whole(self.size)):
            raise InputError(f"arena of {self.size} m; need a positive multiple of {lattice.RESOLUTION} m")

    def height_map(self) -> HeightMap:
        """Height map with the heights at the cell centres. No cell is unknown; the lower corner is at world (0, 0)."""
        cells = round(lattice.cells(self.size))
        x, y = np.moveaxis(Grid((0.0, 0.0), (cells, cells)).center(np.stack(np.indices((cells, cells)), -1)), -1, 0)
        return HeightMap(self.scene.heights_at(x, y))

    def blocks(self) -> list[Block]:
        """All blocks, including the blocks in staircases and ramps."""
        return [block for obstacle in self.scene.obstacles for block in obstacle.blocks()]


def _is_whole(size: float) -> bool:
    cells = lattice.cells(size)
    return round(cells) >= 1 and abs(cells - round(cells)) <= 1e-6


def _whole(size: float) -> float:
    if not _is_whole(size):
        raise fault("", size, f"a positive multiple of {lattice.RESOLUTION} m")
    return size


#: Side length of an arena, m.
ArenaSize = Annotated[float, Field(gt=0, le=200), AfterValidator(_whole)]
#: A pose: x, y (m), heading (rad).
Pose = tuple[float, float, float]


@checked
class ArenaTask:
    """A task in an arena.

    Attributes:
        name: unique name.
        start, goal: poses: x, y (m), heading (rad).
    """

    name: Name
    start: Pose
    goal: Pose


@checked
class BlockDescription:
    """A block or a ramp in an arena, with the attributes of `hdsp.terrain.scenes.Block`."""

    x: float
    y: float
    length: Positive
    width: Positive
    height: Positive
    yaw: float = 0.0


@checked
class StaircaseDescription:
    """Stairs in an arena, with the attributes of `hdsp.terrain.scenes.Staircase`."""

    x: float
    y: float
    steps: Annotated[int, Field(ge=1, le=100)]
    rise: Positive
    tread: Positive
    width: Positive
    depth: Positive
    yaw: float = 0.0


@checked
class ArenaDescription:
    """An arena description from a file, as in ``conf/arena/paper.yaml``. It does not list the walls around the arena.

    Attributes:
        size: side length, m; a multiple of the cell size.
        wall_height, wall_thickness: dimensions of all walls, m.
        walls: centre lines, from x, y to x, y, m; a wall extends half its thickness beyond both ends.
        blocks, ramps, staircases: other obstacles.
        tasks: starts and goals for the planning experiment.
        source: ``scanned``; the planning experiment uses the map from a simulated lidar scan.
    """

    size: ArenaSize
    wall_height: Positive
    wall_thickness: Positive
    walls: tuple[tuple[float, float, float, float], ...] = ()
    blocks: tuple[BlockDescription, ...] = ()
    ramps: tuple[BlockDescription, ...] = ()
    staircases: tuple[StaircaseDescription, ...] = ()
    tasks: tuple[ArenaTask, ...] = ()
    source: Literal["scanned"] = "scanned"


def read_arena(description: ArenaDescription | Mapping[str, Any]) -> Arena:
    """Makes an arena from its description, or from plain values with the same keys.

    Raises:
        InputError: if a key is missing or unknown, or a value is wrong; the message names it.
    """
    given = load_settings(ArenaDescription, description, "arena")
    height, thickness = given.wall_height, given.wall_thickness
    obstacles = walls_around(given.size, height, thickness)
    obstacles += [_wall(line, height, thickness) for line in given.walls]
    obstacles += [Block(**asdict(block)) for block in given.blocks]
    obstacles += [Ramp(**asdict(ramp)) for ramp in given.ramps]
    obstacles += [Staircase(**asdict(stairs)) for stairs in given.staircases]
    return Arena(given.size, Scene(tuple(obstacles)))


def walls_around(size: float, height: float, thickness: float) -> list[Obstacle]:
    """Walls along the inside of an arena's border; lengths in m."""
    low, high = thickness / 2, size - thickness / 2
    lines = [(low, low, high, low), (high, low, high, high), (high, high, low, high), (low, high, low, low)]
    return [_wall(line, height, thickness) for line in lines]


def _wall(line: Sequence[float], height: float, thickness: float) -> Block:
    x0, y0, x1, y1 = line
    length = math.hypot(x1 - x0, y1 - y0) + thickness
    return Block((x0 + x1) / 2, (y0 + y1) / 2, math.atan2(y1 - y0, x1 - x0), length, thickness, height)


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
    seed: Natural
    contents: ArenaSettings = field(default_factory=ArenaSettings)
    tasks: tuple[ArenaTask, ...] = ()
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
