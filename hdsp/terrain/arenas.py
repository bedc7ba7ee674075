"""Arenas: walled squares with obstacles, as described in a file.

Convention: an arena spans [0, size] x [0, size] metres including its walls; x forward, y left.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field

from hdsp.base.errors import InputError
from hdsp.base.settings import Name, Positive, checked, fault, load_settings
from hdsp.base.short_repr import short_repr
from hdsp.robot import lattice
from hdsp.robot.lattice import Grid
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.obstacles import Block, Obstacle, Ramp, Scene, Staircase


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

    def __repr__(self) -> str:
        return short_repr(self)

    def height_map(self) -> HeightMap:
        """Height map with the heights at the cell centres. No cell is unknown; the lower corner is at world (0, 0)."""
        side = round(lattice.cells(self.size))
        cells = np.moveaxis(np.indices((side, side)), 0, -1)
        x, y = np.moveaxis(Grid((0.0, 0.0), (side, side)).center(cells), -1, 0)
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


def _unique(tasks: tuple[ArenaTask, ...]) -> tuple[ArenaTask, ...]:
    names = [task.name for task in tasks]
    for place, name in enumerate(names):
        if name in names[:place]:
            raise fault(f"[{place}].name", name, "a name that no other task has")
    return tasks


ArenaTasks = Annotated[tuple[ArenaTask, ...], AfterValidator(_unique)]


@checked
class BlockDescription:
    """A block or a ramp in an arena, with the attributes of `hdsp.terrain.obstacles.Block`."""

    x: float
    y: float
    length: Positive
    width: Positive
    height: Positive
    yaw: float = 0.0


@checked
class StaircaseDescription:
    """Stairs in an arena, with the attributes of `hdsp.terrain.obstacles.Staircase`."""

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
    tasks: ArenaTasks = ()
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
