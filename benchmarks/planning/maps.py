"""Maps of the planning benchmark: random arenas, courses, rows of courses, and real places.

A map is a function of seed and number alone. Real places are few and belong to no seed: some appear with test seeds,
the others with development seeds.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hdsp.robot.lattice import cells
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.random_arenas import ArenaSettings, random_arena
from hdsp.terrain.scans import build_map, find_files, load_scan
from hdsp.terrain.simulation.courses import CourseSettings, random_course

SCANS = Path(__file__).parents[2] / "conf/scans"
#: Seeds below belong to the final benchmark; development takes seeds from here on.
FIRST_DEVELOPMENT_SEED = 1000
#: Scans for test seeds, and for development seeds.
TEST_PLACES = "octomap_courtyard_stairs", "rsl_real_stairs", "tum_fr2_pioneer_slam2", "plane_seg_ori_stairs"
DEVELOPMENT_PLACES = "plane_seg_terrain_med", "pcl_room_scan", "plane_seg_terrain_close_rect"

#: Kind and side length (m) by map number; a row consists of several courses with this side. Beyond the last map, the
#: sequence begins again, without real places.
SEQUENCE = (
    ("arena", 6.0), ("course", 6.0), ("place", 0.0), ("course", 8.0), ("arena", 8.0), ("row of 2", 7.5),
    ("course", 7.0), ("place", 0.0), ("arena", 10.0), ("course", 10.0), ("course", 6.0), ("row of 3", 6.65),
    ("arena", 6.0), ("place", 0.0), ("course", 8.0), ("arena", 10.0), ("course", 6.0), ("place", 0.0),
    ("arena", 15.0), ("course", 12.0), ("course", 7.0), ("arena", 7.0), ("row of 2", 7.5), ("row of 3", 6.65),
    ("course", 9.0),
)  # fmt: skip
DEFAULT_MAPS = len(SEQUENCE)

_CONTENTS_SIDE = 5.0  # m; the arena for which the numbers of blocks and bumps in ArenaSettings are meant
_OPENING = 0.95, 1.15  # m, width of the opening between two courses


class Map(NamedTuple):
    """A map of the benchmark; ``kind`` is arena, course, row or place."""

    name: str
    kind: str
    terrain: HeightMap


def maps(seed: int, count: int = DEFAULT_MAPS) -> Iterator[Map]:
    """Yields ``count`` maps for a seed; a place whose scan is missing is left out, with a line that says so."""
    places = iter(TEST_PLACES if seed < FIRST_DEVELOPMENT_SEED else DEVELOPMENT_PLACES)
    number = made = 0
    while made < count:
        kind, side = SEQUENCE[number % len(SEQUENCE)]
        terrain, name = None, f"{number:02d} {kind} {side:g} m"
        if kind == "place":
            if (place := next(places, None)) is not None:
                terrain, name = _place(place), f"{number:02d} {place}"
        else:
            terrain = _DRAW[kind.split()[0]](np.random.SeedSequence([seed, number]), kind, side)
        number += 1
        if terrain is not None:
            made += 1
            yield Map(name, kind.split()[0], terrain)


def _arena(source: np.random.SeedSequence, kind: str, side: float) -> HeightMap:
    drawn = _seed(source)
    room = (side / _CONTENTS_SIDE) ** 2
    settings = ArenaSettings(
        blocks=round(ArenaSettings().blocks * room), bumps=round(ArenaSettings().bumps * room), steps=2 + drawn % 2
    )
    return random_arena(drawn, side, settings)


def _course(source: np.random.SeedSequence, kind: str, side: float, index: int = 0) -> HeightMap:
    usual = CourseSettings()
    low, high = (round(number * side / usual.size) for number in usual.clutter)
    settings = CourseSettings(size=side, clutter=(low, high))
    return random_course(_seed(source), index, settings).arena.height_map()


def _row(source: np.random.SeedSequence, kind: str, side: float) -> HeightMap:
    """Courses side by side along x, with an opening in each pair of adjacent walls."""
    random = np.random.default_rng(source)
    number = int(kind.split()[-1])
    heights = np.concatenate([_course(source, kind, side, index).heights for index in range(number)])
    wall = round(cells(CourseSettings().wall_thickness))
    for index in range(1, number):
        at, width = index * round(cells(side)), random.uniform(*_OPENING)
        # Obstacles stand in the corners of each course, so the middle of its walls is free.
        middle = side * random.uniform(0.47, 0.53)
        first, last = round(cells(middle - width / 2)), round(cells(middle + width / 2))
        heights[at - wall : at + wall, first:last] = 0.0
    return HeightMap(heights)


def _place(name: str) -> HeightMap | None:
    scan = load_scan(SCANS / f"{name}.yaml")
    paths, reason = find_files(scan)
    if not paths:
        print(f"{name}: left out, {reason}", file=sys.stderr, flush=True)
        return None
    return build_map(scan, paths)


def _seed(source: np.random.SeedSequence) -> int:
    return int(source.generate_state(1)[0])


_DRAW = {"arena": _arena, "course": _course, "row": _row}
