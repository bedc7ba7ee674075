"""Random courses for simulated patches: two rooms with a door, obstacles, and places of interest.

Stairs, a ramp, a platform and clutter stand in the four corners. A course is a function of (seed, index) alone.

Convention: as in `hdsp.terrain.arenas`; poses are (x, y, heading), m, rad.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from hdsp.base.errors import InputError
from hdsp.base.settings import CountRange, Positive, Range, checked
from hdsp.terrain.arenas import Arena, walls_around
from hdsp.terrain.obstacles import Block, Obstacle, Ramp, Scene, Staircase


@checked
class CourseSettings:
    """Contents of a course; lengths in metres, angles in rad. Each value is drawn uniformly from its range.

    Attributes:
        size: side length.
        wall_height, wall_thickness: wall dimensions.
        door_width: width of the opening between the rooms.
        steps: smallest and largest number of stair steps.
        rise, tread, stairs_width: stair dimensions; the last step extends to the wall.
        slope, ramp_height, ramp_width: ramp dimensions; a block with the ramp's height stands at its upper end.
        platform_side, platform_height: dimensions of blocks onto which the robot steps.
        clutter: smallest and largest number of clutter blocks.
        clutter_side, clutter_height: clutter block dimensions.
        askew: largest angle between platforms and the walls; stairs and ramps use a third of it.

    Raises:
        InputError: if a range is empty or not positive.
    """

    size: Annotated[float, Field(ge=6.0)] = 6.0  # two rooms with two obstacles in each
    wall_height: Positive = 1.2
    wall_thickness: Positive = 0.1
    door_width: Range = (0.75, 1.1)
    steps: CountRange = (2, 3)
    rise: Range = (0.12, 0.22)
    tread: Range = (0.28, 0.35)
    stairs_width: Range = (1.2, 1.7)
    slope: Range = (0.08, 0.25)
    ramp_height: Range = (0.1, 0.25)
    ramp_width: Range = (0.9, 1.3)
    platform_side: Range = (0.8, 1.3)
    platform_height: Range = (0.06, 0.28)
    clutter: CountRange = (5, 8)
    clutter_side: Range = (0.1, 0.5)
    clutter_height: Range = (0.03, 0.35)
    askew: Positive = 0.2


class Place(NamedTuple):
    """A pose where the robot has a choice, and the kind of obstacle there."""

    kind: str
    x: float
    y: float
    heading: float


class Course(NamedTuple):
    """An arena, a free position (x, y) for the start of a scan, and places of interest."""

    arena: Arena
    start: tuple[float, float]
    places: tuple[Place, ...]


def random_course(seed: int, index: int, settings: CourseSettings | None = None) -> Course:
    """Draws course number ``index`` for a seed.

    Raises:
        InputError: if the seed or index is negative.
    """
    if seed < 0 or index < 0:
        raise InputError(f"course seed {seed}, index {index}; need numbers of at least 0")
    s = settings or CourseSettings()
    random = np.random.default_rng(np.random.SeedSequence([seed, index]))
    middle, between = s.size / 2, s.size * random.uniform(0.45, 0.55)
    width = random.uniform(*s.door_width)
    # The door is near the middle of the wall, away from the obstacles in the corners.
    door = middle + random.uniform(-0.05, 0.05) * s.size
    obstacles: list[Obstacle] = walls_around(s.size, s.wall_height, s.wall_thickness)
    for low, high in ((0.0, door - width / 2), (door + width / 2, s.size)):
        obstacles.append(Block(between, (low + high) / 2, math.pi / 2, high - low, s.wall_thickness, s.wall_height))
    places = [
        Place("door", between - 0.45, door, 0.0),
        Place("door", between + 0.45, door, math.pi),
        Place("door", between, door, random.choice([0.0, math.pi])),
    ]
    kinds = ["stairs", "ramp", "platform", "clutter"]
    for corner, kind in zip(random.permutation(4), kinds, strict=True):
        left, lower = corner % 2 == 0, corner < 2
        # The corner's range in x.
        x = (s.wall_thickness, between) if left else (between, s.size - s.wall_thickness)
        made, found = _DRAW[kind](random, s, sum(x) / 2, x[1] - x[0], lower)
        obstacles += made
        places += found
    free = Place("open", between - 1.2 if random.random() < 0.5 else between + 1.2, middle, random.uniform(0, math.tau))
    return Course(Arena(s.size, Scene(tuple(obstacles))), (between, door), (*places, free))


def _toward_wall(s: CourseSettings, lower: bool) -> tuple[float, float]:
    """Heading toward a corner's wall, and the wall's y."""
    return (-math.pi / 2, s.wall_thickness) if lower else (math.pi / 2, s.size - s.wall_thickness)


def _stairs(random, s: CourseSettings, x: float, room: float, lower: bool) -> tuple[list[Obstacle], list[Place]]:
    ahead, wall = _toward_wall(s, lower)
    side = math.sin(ahead)
    steps, tread = int(random.integers(*s.steps, endpoint=True)), random.uniform(*s.tread)
    landing = 1.3
    length = landing + (steps - 1) * tread
    yaw = ahead + random.uniform(-s.askew, s.askew) / 3
    stairs = Staircase(
        x=x, y=wall - side * length, yaw=yaw, steps=steps, rise=random.uniform(*s.rise), tread=tread,
        width=min(random.uniform(*s.stairs_width), room), depth=length,
    )  # fmt: skip
    at = [-0.6, -0.45, (steps - 1) * tread + 0.65]
    places = [Place("stairs", x + d * math.cos(yaw), stairs.y + d * math.sin(yaw), ahead) for d in at]
    down = Place("stairs", places[2].x, places[2].y, ahead + math.pi)
    return [stairs], [*places, down]


def _ramp(random, s: CourseSettings, x: float, room: float, lower: bool) -> tuple[list[Obstacle], list[Place]]:
    ahead, wall = _toward_wall(s, lower)
    side = math.sin(ahead)
    height, width = random.uniform(*s.ramp_height), min(random.uniform(*s.ramp_width), room)
    length = min(height / random.uniform(*s.slope), 1.3)
    top = 1.0
    yaw = ahead + random.uniform(-s.askew, s.askew) / 3
    foot = x, wall - side * (top + length)
    c, sn = math.cos(yaw), math.sin(yaw)
    ramp = Ramp(foot[0] + c * length / 2, foot[1] + sn * length / 2, yaw, length, width, height)
    block = Block(foot[0] + c * (length + top / 2), foot[1] + sn * (length + top / 2), yaw, top, width, height)
    at = [-0.5, length / 2, length + 0.5]
    return [ramp, block], [Place("ramp", foot[0] + c * d, foot[1] + sn * d, ahead) for d in at]


def _platform(random, s: CourseSettings, x: float, room: float, lower: bool) -> tuple[list[Obstacle], list[Place]]:
    ahead, wall = _toward_wall(s, lower)
    side = math.sin(ahead)
    length, width = random.uniform(*s.platform_side, size=2)
    yaw = ahead + random.uniform(-s.askew, s.askew)
    y = wall - side * (0.4 + length / 2)
    block = Block(x, y, yaw, length, width, random.uniform(*s.platform_height))
    before = y - side * (length / 2 + 0.55)
    return [block], [
        Place("platform", x, before, ahead),
        Place("platform", x + 0.3 * width, before, ahead),
        Place("platform", x, y, ahead + math.pi),
    ]


def _clutter(random, s: CourseSettings, x: float, room: float, lower: bool) -> tuple[list[Obstacle], list[Place]]:
    ahead, wall = _toward_wall(s, lower)
    side = math.sin(ahead)

    def somewhere() -> tuple[float, float]:
        return x + random.uniform(-0.45, 0.45) * room, wall - side * random.uniform(0.2, 1.7)

    def thing() -> Block:
        place = somewhere()
        yaw = random.uniform(-math.pi, math.pi)
        length, width = random.uniform(*s.clutter_side, size=2).tolist()
        return Block(*place, yaw, length, width, random.uniform(*s.clutter_height))

    blocks: list[Obstacle] = [thing() for _ in range(random.integers(*s.clutter, endpoint=True))]
    return blocks, [Place("clutter", *somewhere(), random.uniform(0, math.tau)) for _ in range(4)]


_DRAW = {"stairs": _stairs, "ramp": _ramp, "platform": _platform, "clutter": _clutter}
