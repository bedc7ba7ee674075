"""Tasks: a map with noise to plan on, true ground to drive on, start and goal.

A task depends on seed, kind and number alone.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from benchmarks.real_places import SCANS, poses_to_leave
from hdsp.base.errors import InputError
from hdsp.planning.planner import Planner
from hdsp.robot.lattice import Grid, cells
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.obstacles import Block, Obstacle, Ramp, Scene, Staircase

NOISE = 0.01  # m
KINDS = "flat", "stairs", "blocks", "ramps", "doors", "clutter", "places"
PLACES = "octomap_courtyard_stairs", "pcl_room_scan", "plane_seg_terrain_med", "rsl_real_stairs"
SIZE = 6.0, 3.0  # m, of made ground
BELOW = math.radians(2)  # between the steepest ramp and the robot's limit
_NEAR = 0.5, 3.0  # m, distances of a goal in a real place
Pose = tuple[float, float, float | None]


class Task(NamedTuple):
    """Ground to plan on, ground to drive on, start and goal."""

    map: HeightMap
    truth: HeightMap | Scene
    start: Pose
    goal: Pose


def make_task(kind: str, seed: int, number: int, robot: Robot) -> Task | None:
    """Returns a task; None where a place has no goal near the start."""
    if kind == "places":
        return place_task(seed, number, robot)
    return made_task(kind, seed, number, robot)


def made_task(kind: str, seed: int, number: int, robot: Robot) -> Task:
    """Returns a task on made ground; the robot drives along x, in a corridor or around obstacles."""
    random = np.random.default_rng((seed, KINDS.index(kind), number))
    (length, width), middle = SIZE, SIZE[1] / 2
    start = [0.8, middle + random.uniform(-0.1, 0.1), random.uniform(-0.1, 0.1)]
    goal: list = [length - 0.8, middle + random.uniform(-0.1, 0.1), random.uniform(-0.1, 0.1)]
    obstacles: list[Obstacle] = []
    yaw = random.uniform(-0.15, 0.15)
    if kind == "flat":
        start = [random.uniform(0.8, length - 0.8), random.uniform(0.8, width - 0.8), random.uniform(-math.pi, math.pi)]
        goal = [random.uniform(0.8, length - 0.8), random.uniform(0.8, width - 0.8), random.uniform(-math.pi, math.pi)]
    elif kind == "stairs":
        steps, highest = int(random.integers(2, 4)), min(0.2, robot.step.max_height)
        obstacles.append(
            Staircase(2.0, middle, yaw / 2, steps, random.uniform(0.6, 1.0) * highest, random.uniform(0.28, 0.34), 8, 8)
        )
    elif kind == "blocks":
        highest = 0.9 * robot.step.max_height
        obstacles.append(
            Block(3.0, middle, yaw, random.uniform(1.2, 2.0), 8, random.uniform(0.06, highest)),
        )
    elif kind == "ramps":
        slope = math.tan(random.uniform(0.4, 1.0) * (robot.slope.max_pitch - BELOW))
        run = random.uniform(1.0, 2.0)
        obstacles.append(Ramp(1.8 + run / 2, middle, 0.0, run, 8, slope * run))
        obstacles.append(Block(1.8 + run + 4, middle, 0.0, 8, 8, slope * run))
    elif kind == "doors":
        opening, place = random.uniform(0.75, 1.1), middle + random.uniform(-0.4, 0.4)
        for low, high in ((-1.0, place - opening / 2), (place + opening / 2, width + 1.0)):
            obstacles.append(Block(3.0, (low + high) / 2, math.pi / 2, high - low, 0.1, 1.2))
    elif kind == "clutter":
        for _ in range(8):
            x, y = random.uniform(1.6, length - 1.6), random.uniform(0.2, width - 0.2)
            side = random.uniform(0.1, 0.5, 2).tolist()
            obstacles.append(Block(x, y, random.uniform(-math.pi, math.pi), *side, random.uniform(0.03, 0.35)))
    if kind in ("stairs", "ramps") and random.random() < 0.5:  # down, ahead
        start, goal = [*goal[:2], goal[2] + math.pi], [*start[:2], start[2] + math.pi]
    scene = Scene(tuple(obstacles))
    return Task(noisy(map_of(scene, SIZE), random), scene, tuple(start), tuple(goal))  # type: ignore[arg-type]


def place_task(seed: int, number: int, robot: Robot) -> Task | None:
    """Returns a task between random poses in a real place, one place after the other; None without a goal nearby."""
    planner = _planner_of(PLACES[number % len(PLACES)], robot)
    random = np.random.default_rng((seed, KINDS.index("places"), number))
    start, *others = poses_to_leave(planner, 12, int(random.integers(2**31)))
    near = [pose for pose in others if _NEAR[0] < math.dist(pose[:2], start[:2]) < _NEAR[1]]
    if not near:
        return None
    truth = planner.terrain
    return Task(noisy(truth, random), filled(truth), start, (*near[0][:2], None))


@lru_cache
def _planner_of(place: str, robot: Robot) -> Planner:
    from hdsp.terrain.scans import build_map, find_files, load_scan

    paths, reason = find_files(scan := load_scan(SCANS / f"{place}.yaml"))
    if not paths:
        raise InputError(reason)
    return Planner(build_map(scan, paths), robot, "geometric")


def map_of(scene: Scene, size: tuple[float, float]) -> HeightMap:
    """Height map of a scene; its lower corner lies in the origin.

    Args:
        scene: the scene.
        size: length and width, m.
    """
    shape = round(cells(size[0])), round(cells(size[1]))
    centers = Grid((0.0, 0.0), shape).center(np.moveaxis(np.indices(shape), 0, -1))
    return HeightMap(scene.heights_at(centers[..., 0], centers[..., 1]))


def noisy(terrain: HeightMap, random: np.random.Generator) -> HeightMap:
    """The same ground with noise in each cell."""
    noise = random.normal(0.0, NOISE, terrain.shape).astype(np.float32)
    return HeightMap(terrain.heights + noise, terrain.origin, terrain.resolution)


def filled(terrain: HeightMap) -> HeightMap:
    """The same ground; unknown cells continue the nearest known ground, because shadows of a scan are no pits."""
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(np.isnan(terrain.heights), return_distances=False, return_indices=True)
    return HeightMap(terrain.heights[tuple(nearest)], terrain.origin, terrain.resolution)
