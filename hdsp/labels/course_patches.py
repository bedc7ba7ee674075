"""The set of simulated patches: random courses, scanned as a robot would, cut where it has something to decide.

Each patch is labelled by the detailed planner on the scanned map. The patches of a course are a function of (settings,
index of the course) alone.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from hdsp.abstract.transform import feet_at
from hdsp.base.errors import InputError
from hdsp.base.provenance import code_fingerprint
from hdsp.base.workers import ClusterSettings, connected
from hdsp.detailed.world.world import build_world
from hdsp.labels.rules import LabelSettings, MapTasks, label_map
from hdsp.labels.tasks import TaskSet
from hdsp.robot.lattice import HEADINGS, HEADINGS_PER_ABSTRACT, PATCH_CELLS, Grid, heading_index
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.simulation.courses import Course, CourseSettings, Place, random_course
from hdsp.terrain.simulation.lidar import Lidar
from hdsp.terrain.simulation.lidar_mapping import scanned_map

_QUARTER = HEADINGS // 4
_SHIFT = 0.15  # m, standard deviation of the distance between a place of interest and the start of its patch
_TRIES = 20
_CLOSEST = 0.4  # m between the starts of two patches with the same heading
_TURNED_CELLS = 104  # side of a map that holds a patch at every heading


@dataclass(frozen=True)
class PatchSettings:
    """How many patches there are, and what of.

    Attributes:
        seed: of the courses, their scans and the choice of places.
        courses: how many.
        patches_per_course: how many at most; a place where no start is valid gives none, another one several where
            there are fewer places than that.
        heading_residues: abstract headings within a quarter turn, [0, 4), that starts have in turn; 0: only multiples
            of 90 degrees, at which all goals lie on the grid of the abstract states.

    Raises:
        InputError: for a number out of range.
    """

    seed: int
    courses: int
    patches_per_course: int
    heading_residues: tuple[int, ...] = (0,)

    def __post_init__(self):
        for name, least in (("seed", 0), ("courses", 1), ("patches_per_course", 1)):
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise InputError(f"patches: {name} is {value!r}; need a whole number of at least {least}")
        if not self.heading_residues or not set(self.heading_residues) <= set(range(4)):
            raise InputError(f"patches: heading_residues is {list(self.heading_residues)}; need some of 0, 1, 2, 3")


@dataclass(frozen=True)
class PatchRun:
    """All that the set depends on."""

    patches: PatchSettings
    courses: CourseSettings
    lidar: Lidar
    robot: Robot
    labels: LabelSettings

    def inputs(self) -> dict[str, Any]:
        """Plain values by name; the code as a fingerprint."""
        modules = ["hdsp.labels.rules", "hdsp.labels.course_patches"]
        return {**asdict(self), "robot": self.robot.to_dict(), "code": code_fingerprint(modules)}

    def hash(self) -> str:
        return hashlib.sha256(json.dumps(self.inputs(), sort_keys=True).encode()).hexdigest()

    def course_hash(self) -> str:
        """Hash of what one course depends on: all but how many there are."""
        return replace(self, patches=replace(self.patches, courses=1)).hash()


class Patch(NamedTuple):
    """A place of a course, the start chosen near it (x, y in m; detailed heading), and its labels."""

    kind: str
    start: tuple[float, float, int]
    tasks: MapTasks


class ScannedCourse(NamedTuple):
    """A course, its scanned map, and the patches cut from it."""

    index: int
    course: Course
    terrain: HeightMap
    patches: list[Patch]


def simulated_courses(
    run: PatchRun, cluster: ClusterSettings | None = None, numbers: Sequence[int] | None = None
) -> Iterator[ScannedCourse]:
    """Courses in order, scanned, cut and labelled.

    Args:
        run: what they are.
        cluster: which processes do the work; None = this one.
        numbers: which of them; None = all.

    Raises:
        InputError: if MuJoCo is missing, or a worker was killed.
    """
    numbers = range(run.patches.courses) if numbers is None else numbers
    # The first one here: it fills the cache of compiled kernels before several processes read it.
    yield from (scan_course(run, index) for index in numbers[:1])
    rest = numbers[1:]
    if cluster is None or cluster.processes(len(rest)) == 1:
        yield from (scan_course(run, index) for index in rest)
        return
    with connected(cluster, len(rest)) as client:
        for future in client.map(partial(scan_course, run), rest):
            yield future.result()


def scan_course(run: PatchRun, index: int) -> ScannedCourse:
    """Scan course number ``index`` and label the patches at its places of interest."""
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
        # Turned by quarters, which permutes cells exactly, so that the start heads between 0 and 90 degrees.
        cells = PATCH_CELLS if residue == 0 else _TURNED_CELLS
        heading = residue * HEADINGS_PER_ABSTRACT
        around = terrain.crop_cells(*start[:2], start[2] - heading, cells)
        tasks = label_map(around, run.robot, run.labels, heading)
        if tasks is not None:
            x, y = (float(value) for value in grid.center(start[:2]))
            taken.append((x, y, start[2]))
            found.append(Patch(place.kind, taken[-1], tasks))
    return ScannedCourse(index, course, terrain, found)


def task_set(run: PatchRun, courses: list[ScannedCourse]) -> TaskSet:
    """The labelled tasks of all patches; ``category`` is the kind of place, ``index`` the course."""
    rows = [(course.index, patch) for course in courses for patch in course.patches]
    if not rows:
        return TaskSet.empty()
    tasks = [patch.tasks for _, patch in rows]
    arrays = {name: np.array(column) for name, column in zip(MapTasks._fields, zip(*tasks, strict=True), strict=True)}
    return TaskSet(
        **arrays,
        category=np.array([patch.kind for _, patch in rows]),
        index=np.array([index for index, _ in rows]),
        heading=np.array([patch.start[2] % _QUARTER for _, patch in rows]),
        seed=np.full(len(rows), run.patches.seed),
    )


def _visits(places: tuple[Place, ...], random: np.random.Generator, found: list[Patch]) -> Iterator[Place]:
    """All places once, and again as long as a round adds to what is found."""
    before = -1
    while len(found) > before:
        before = len(found)
        yield from _mixed(places, random)


def _mixed(places: tuple[Place, ...], random: np.random.Generator) -> list[Place]:
    """The places in random order, but one of each kind before the second of any."""
    kinds: dict[str, list[Place]] = {}
    for number in random.permutation(len(places)):
        kinds.setdefault(places[number].kind, []).append(places[number])
    order = [kind for _, kind in sorted((random.random(), kind) for kind in kinds)]
    longest = max(map(len, kinds.values()), default=0)
    return [kinds[kind][turn] for turn in range(longest) for kind in order if turn < len(kinds[kind])]


def _valid_start(world, grid: Grid, place: Place, residue: int, taken, random) -> tuple[int, int, int] | None:
    """Cell and detailed heading of a valid start near a place, and not too near to those taken; None: not found."""
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
