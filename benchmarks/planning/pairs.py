"""Random pairs of start and goal: a spread of distances, and a share of pairs between different levels of the ground.

Pairs are drawn before any search. No heuristic takes part in the choice.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from hdsp.base.errors import InputError
from hdsp.planning.planner import Planner
from hdsp.robot.robot import Robot
from hdsp.terrain.cost_maps import COST_MODEL_VERSION
from hdsp.terrain.height_map import HeightMap

Pose = tuple[float, float, float]

STEPS_SHARE = 0.5  # of the pairs whose start and goal lie on different pieces of drivable ground, if there are several
_POOL = 48  # poses among which pairs are chosen
_TRIALS = 4000  # poses
_LEAST_PIECE = 0.4  # m2 of ground on which a robot may find a place
_LEAST = 0.8  # m between start and goal
_DIGITS = 4  # of a coordinate


@dataclass(frozen=True)
class Pair:
    """A start and a goal, world poses (x, y, heading) in m and rad.

    Attributes:
        key: hash of map, robot, start and goal.
        start, goal: the poses.
        distance: between both positions, m.
        levels: whether they lie on different pieces of drivable ground.
    """

    key: str
    start: Pose
    goal: Pose
    distance: float
    levels: bool


def draw_pairs(planner: Planner, count: int, source: np.random.SeedSequence) -> list[Pair]:
    """Draws ``count`` pairs of poses that the robot can leave.

    Distances are spread evenly from 0.8 m to the largest distance in a pool of random poses.

    Raises:
        InputError: the map has too few such poses.
    """
    random = np.random.default_rng(source)
    pieces = ground_pieces(planner.terrain, planner.robot.drive.highest_edge)
    anywhere = _poses(planner, random, np.argwhere(pieces > 0), 2 * _POOL)
    on_pieces = _poses_on_pieces(planner, random, pieces)
    if len(anywhere) < 2:
        raise InputError(f"{len(anywhere)} random poses can be left; need at least 2")
    starts, goals = anywhere[: len(anywhere) // 2], anywhere[len(anywhere) // 2 :]
    pairs: list[Pair] = []
    for stratum in random.permutation(count):
        wanted = (stratum + random.random()) / count
        levels = random.random() < STEPS_SHARE
        pair = levels and _nearest_to(wanted, on_pieces + starts, on_pieces + goals, True, pieces, planner, pairs)
        pair = pair or _nearest_to(wanted, starts, goals, False, pieces, planner, pairs)
        if pair is not None:
            pairs.append(pair)
    return pairs


def ground_pieces(terrain: HeightMap, drivable: float) -> np.ndarray:
    """Numbers the connected pieces of known ground without edges higher than ``drivable`` (m), int [nx, ny]; 0: none.

    Pieces that are too small for a robot count as none.
    """
    known = np.isfinite(terrain.heights)
    lowest = ndimage.minimum_filter(np.where(known, terrain.heights, np.inf), 3)
    highest = ndimage.maximum_filter(np.where(known, terrain.heights, -np.inf), 3)
    pieces, number = ndimage.label(known & (highest - lowest <= drivable))
    area = np.bincount(pieces.ravel(), minlength=number + 1) * terrain.resolution**2
    area[0] = 0.0
    return np.where(area[pieces] >= _LEAST_PIECE, pieces, 0)


def _nearest_to(wanted, starts, goals, levels, pieces, planner, taken) -> Pair | None:
    """Returns the pair whose distance is nearest to the wanted share of the largest distance.

    Both ends of it are on different pieces if ``levels`` is set; none is used twice.
    """
    used = {pose for pair in taken for pose in (pair.start, pair.goal)}
    starts, goals = ([pose for pose in poses if pose not in used] for poses in (starts, goals))
    if not starts or not goals:
        return None
    a, b = np.array(starts), np.array(goals)
    distance = np.hypot(a[:, None, 0] - b[None, :, 0], a[:, None, 1] - b[None, :, 1])
    on = [np.array([_piece(planner.terrain, pieces, pose) for pose in poses]) for poses in (starts, goals)]
    differ = on[0][:, None] != on[1][None, :]
    allowed = (distance >= _LEAST) & (differ | (not levels))
    if not allowed.any():
        return None
    largest = distance[allowed].max()
    off = np.where(allowed, np.abs(distance - (_LEAST + wanted * (largest - _LEAST))), np.inf)
    i, j = np.unravel_index(int(off.argmin()), off.shape)
    start, goal = starts[i], goals[j]
    key = pair_key(map_key(planner.terrain), planner.robot, start, goal)
    return Pair(key, start, goal, round(float(distance[i, j]), 3), bool(differ[i, j]))


def _piece(terrain: HeightMap, pieces: np.ndarray, pose: Pose) -> int:
    at = ((np.array(pose[:2]) - terrain.origin) // terrain.resolution).astype(int)
    return int(pieces[tuple(np.clip(at, 0, np.array(pieces.shape) - 1))])


def _poses(planner: Planner, random: np.random.Generator, cells: np.ndarray, count: int, trials=_TRIALS) -> list[Pose]:
    """Random poses over cells that the robot can leave, up to ``count``."""
    found: list[Pose] = []
    origin, side = np.array(planner.terrain.origin), planner.terrain.resolution
    for _ in range(trials if len(cells) else 0):
        x, y = origin + (cells[random.integers(len(cells))] + 0.5) * side
        pose = round(float(x), _DIGITS), round(float(y), _DIGITS), round(float(random.uniform(-np.pi, np.pi)), _DIGITS)
        if planner.can_leave(pose):
            found.append(pose)
        if len(found) == count:
            break
    return found


def _poses_on_pieces(planner: Planner, random: np.random.Generator, pieces: np.ndarray) -> list[Pose]:
    """Random poses on each piece of ground but the largest."""
    numbers, sizes = np.unique(pieces[pieces > 0], return_counts=True)
    others = numbers[np.argsort(-sizes)][1:]
    return [
        pose for number in others for pose in _poses(planner, random, np.argwhere(pieces == number), _POOL // 8, 400)
    ]


def map_key(terrain: HeightMap) -> str:
    """Hash of heights, origin and cell size."""
    heights = np.ascontiguousarray(terrain.heights, np.float32)
    head = f"{heights.shape} {tuple(map(float, terrain.origin))} {float(terrain.resolution)}"
    return hashlib.sha256(head.encode() + heights.tobytes()).hexdigest()[:16]


def robot_key(robot: Robot) -> str:
    """Hash of the robot and of the version of the cost model: two equal hashes mean equal costs of equal plans."""
    return hashlib.sha256(f"{robot.hash()} {COST_MODEL_VERSION}".encode()).hexdigest()[:16]


def pair_key(terrain: str, robot: Robot, start: Pose, goal: Pose) -> str:
    """Hash of a task on the map with hash ``terrain``."""
    return hashlib.sha256(f"{terrain} {robot_key(robot)} {start} {goal}".encode()).hexdigest()[:16]
