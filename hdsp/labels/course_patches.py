"""Simulated patches: random courses are scanned by a simulated robot and cut at places of interest.

The detailed planner labels each patch on the scanned map. A course's patches are a function of (settings, course index)
alone.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from hdsp.abstract.transform import feet_at
from hdsp.base.provenance import ROOT, code_fingerprint
from hdsp.base.settings import Count, Seed, checked
from hdsp.base.short_repr import short_repr
from hdsp.base.workers import ClusterSettings, connected
from hdsp.detailed.world.world import build_world
from hdsp.labels.rules import LabelSettings, MapTasks, label_map
from hdsp.labels.tasks import TaskSet, columns_of
from hdsp.robot.lattice import HEADINGS, HEADINGS_PER_ABSTRACT, PATCH_CELLS, Grid, Residue, heading_index
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.patches import ROTATED_MAP_CELLS
from hdsp.terrain.simulation.courses import Course, CourseSettings, Place, random_course
from hdsp.terrain.simulation.lidar import Lidar
from hdsp.terrain.simulation.lidar_mapping import scanned_map

_QUARTER = HEADINGS // 4
_SHIFT = 0.15  # m, standard deviation of the distance between a place of interest and the start of its patch
_TRIES = 20
_CLOSEST = 0.4  # m between the starts of two patches with the same heading


@checked
class CoursePatchSettings:
    """Number and kind of patches.

    Attributes:
        seed: seed for courses, scans and the choice of places.
        courses: number of courses.
        patches_per_course: largest number of patches per course. A place without a valid start gives no patch; if
            places are fewer than this number, one place may give several patches.
        heading_residues: abstract headings within a quarter turn, [0, 4), used by the starts in turn. With 0 alone, all
            headings are multiples of 90 degrees, and all goals lie on the abstract state grid.

    Raises:
        InputError: if a number is out of range.
    """

    seed: Seed
    courses: Count
    patches_per_course: Count
    heading_residues: Annotated[tuple[Residue, ...], Field(min_length=1)] = (0,)


@dataclass(frozen=True)
class PatchRun:
    """Settings that determine the patches."""

    patches: CoursePatchSettings
    courses: CourseSettings
    lidar: Lidar
    robot: Robot
    labels: LabelSettings

    def __repr__(self) -> str:
        return short_repr(self)

    def inputs(self) -> dict[str, Any]:
        """Plain values by name; a fingerprint represents the code."""
        return {**asdict(self), "robot": self.robot.to_dict(), "code": courses_code()}

    def hash(self) -> str:
        return hashlib.sha256(json.dumps(self.inputs(), sort_keys=True).encode()).hexdigest()

    def course_hash(self) -> str:
        """Hash of everything that determines one course: all settings except the number of courses."""
        return replace(self, patches=replace(self.patches, courses=1)).hash()


class Patch(NamedTuple):
    """A place in a course, the start chosen near it (x, y in m; detailed heading), and its labels."""

    kind: str
    start: tuple[float, float, int]
    tasks: MapTasks


class ScannedCourse(NamedTuple):
    """A course, its scanned map, and its patches."""

    number: int
    course: Course
    terrain: HeightMap
    patches: list[Patch]

    def __repr__(self) -> str:
        return short_repr(self)


def simulated_courses(
    run: PatchRun, cluster: ClusterSettings | None = None, numbers: Sequence[int] | None = None
) -> Iterator[ScannedCourse]:
    """Yields courses in order, each scanned, cut and labelled.

    Args:
        run: settings for courses and patches.
        cluster: processes for the work; None = this process.
        numbers: course numbers; None = all.

    Raises:
        InputError: if MuJoCo is missing, or a worker was killed.
    """
    numbers = range(run.patches.courses) if numbers is None else numbers
    # This process scans the first course, which fills the cache of compiled kernels before several processes read it.
    yield from (scan_course(run, index) for index in numbers[:1])
    rest = numbers[1:]
    if cluster is None or cluster.processes(len(rest)) == 1:
        yield from (scan_course(run, index) for index in rest)
        return
    with connected(cluster, len(rest)) as client:
        for future in client.map(partial(scan_course, run), rest):
            yield future.result()


def scan_course(run: PatchRun, index: int) -> ScannedCourse:
    """Scans course number ``index`` and labels the patches at its places of interest."""
    course = random_course(run.patches.seed, index, run.courses)
    terrain = scanned_map(course.arena, course.start, run.lidar, seed=run.patches.seed + index)
    world, grid = build_world(terrain, run.robot), Grid(terrain.origin, terrain.shape)
    random = np.random.default_rng(np.random.SeedSequence([run.patches.seed, index, 1]))
    found: list[Patch] = []
    taken: list[tuple[float, float, int]] = []
    for place in _visits(course.places, random, found):
        if len(found) == run.patches.patches_per_course:
            break
        residue = run.patches.heading_residues[len(found) % len(run.patches.heading_residues)]
        start = _valid_start(world, grid, place, residue, taken, random)
        if start is None:
            continue
        # Quarter turns permute cells exactly; they bring the start heading between 0 and 90 degrees.
        cells = PATCH_CELLS if residue == 0 else ROTATED_MAP_CELLS
        heading = residue * HEADINGS_PER_ABSTRACT
        around = terrain.crop_cells(*start[:2], start[2] - heading, cells)
        tasks = label_map(around, run.robot, run.labels, heading)
        if tasks is not None:
            x, y = (float(value) for value in grid.center(start[:2]))
            taken.append((x, y, start[2]))
            found.append(Patch(place.kind, taken[-1], tasks))
    return ScannedCourse(index, course, terrain, found)


def task_set(run: PatchRun, courses: list[ScannedCourse]) -> TaskSet:
    """Labelled tasks from all patches; ``category`` is the place's kind, ``index`` the course."""
    rows = [(course.number, patch) for course in courses for patch in course.patches]
    if not rows:
        return TaskSet.empty()
    return TaskSet(
        **columns_of([patch.tasks for _, patch in rows]),
        category=np.array([patch.kind for _, patch in rows]),
        index=np.array([index for index, _ in rows]),
        heading=np.array([patch.start[2] % _QUARTER for _, patch in rows]),
        seed=np.full(len(rows), run.patches.seed),
    )


def courses_code(root: Path = ROOT) -> str:
    """Fingerprint of all code that determines the patches; ``root``: folder with another copy of the package."""
    return code_fingerprint(scan_course, task_set, root=root)


def _visits(places: tuple[Place, ...], random: np.random.Generator, found: list[Patch]) -> Iterator[Place]:
    """All places once, then again as long as a round adds a patch to ``found``."""
    before = -1
    while len(found) > before:
        before = len(found)
        yield from _mixed(places, random)


def _mixed(places: tuple[Place, ...], random: np.random.Generator) -> list[Place]:
    """Places in random order, with one place of each kind before the second place of any kind."""
    kinds: dict[str, list[Place]] = {}
    for number in random.permutation(len(places)):
        kinds.setdefault(places[number].kind, []).append(places[number])
    order = [kind for _, kind in sorted((random.random(), kind) for kind in kinds)]
    longest = max(map(len, kinds.values()), default=0)
    return [kinds[kind][turn] for turn in range(longest) for kind in order if turn < len(kinds[kind])]


def _valid_start(world, grid: Grid, place: Place, residue: int, taken, random) -> tuple[int, int, int] | None:
    """Finds a valid start near a place, not too near to other starts: cell and detailed heading, or None."""
    for _ in range(_TRIES):
        x, y = random.normal((place.x, place.y), _SHIFT)
        heading = int(heading_index(place.heading + random.normal(0.0, 0.3)))
        step = residue * HEADINGS_PER_ABSTRACT
        heading = (round((heading - step) / _QUARTER) * _QUARTER + step) % HEADINGS
        near = any(turn == heading and np.hypot(x - u, y - v) < _CLOSEST for u, v, turn in taken)
        cell = grid.cell((x, y))
        inside = grid.contains(cell)
        if inside and not near and feet_at(world, (int(cell[0]), int(cell[1]), heading)) is not None:
            return int(cell[0]), int(cell[1]), heading
    return None
