"""Levelling of a cloud on its floor, and registration between clouds.

The floor is the lowest plane that is nearly horizontal and well supported. RANSAC (Fischler and Bolles 1981) proposes
planes; least squares on the inliers refines them. The points are first thinned to one per voxel, so dense ground near
the sensor has no more weight than sparse ground far away.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from hdsp.base.errors import InputError
from hdsp.base.messages import shown, spans
from hdsp.base.scalars import real
from hdsp.base.settings import Positive, Seed, checked, load_settings
from hdsp.terrain.pointcloud.point_arrays import finite_points

_HYPOTHESES = 400
_REFINEMENTS = 20
#: A lower plane is the floor if it has this share of the largest support: ceilings and landings are larger than floors.
_LEAST_SUPPORT = 0.15
#: m; points at least this far below a plane may belong to another plane.
_BELOW = 0.12
_MOST_VOXELS = 1 << 62  # in the box around a cloud
_NEIGHBOURS = 10  # points around another one, for its normal


@checked
class FloorSettings:
    """Settings for floor detection.

    Attributes:
        max_tilt: rad, largest angle between the floor and the cloud's horizontal plane.
        thickness: m, largest distance from the floor's plane to its points.
        voxel: m, voxel size for thinning.
        reach: m, radius around the first point for the other two points in a proposal.
        seed: seed for the proposals.
    """

    max_tilt: Annotated[float, Field(gt=0, le=math.pi / 2)] = math.radians(15)
    thickness: Positive = 0.025
    voxel: Positive = 0.05
    reach: Positive = 1.5
    seed: Seed = 0


@dataclass(frozen=True)
class Plane:
    """The points p with ``dot(normal, p) = offset``; the normal points up.

    Attributes:
        normal: float64 [3], length 1.
        offset: m.
        support: number of voxels on the plane.
    """

    normal: np.ndarray
    offset: float
    support: int

    @property
    def tilt(self) -> float:
        """Angle to the horizontal, rad."""
        return float(math.acos(min(1.0, self.normal[2])))

    def heights(self, points: np.ndarray) -> np.ndarray:
        """Signed distances from the plane to points [n, 3], m; positive above it."""
        return points @ self.normal - self.offset


def fit_floor(points: np.ndarray, settings: FloorSettings | None = None) -> Plane:
    """Finds a cloud's floor.

    Args:
        points: float [n, 3], m, z roughly up.
        settings: settings for the detection.

    Raises:
        InputError: if points or settings are invalid, or no nearly horizontal plane has enough points.
    """
    points = finite_points(points)
    settings = FloorSettings() if settings is None else load_settings(FloorSettings, settings, "settings")
    return lowest_plane(thinned(points, settings.voxel), settings, len(points))


def lowest_plane(voxels: np.ndarray, settings: FloorSettings, points: int) -> Plane:
    """Finds the floor among mean points in voxels [k, 3]; ``points`` is the number of points, for the message."""
    floor, largest, rest = None, 0, voxels
    while True:
        plane = best_plane(rest, settings, settings.max_tilt)
        if plane is None or plane.support < _LEAST_SUPPORT * largest:
            break
        floor, largest = plane, max(largest, plane.support)
        rest = rest[plane.heights(rest) < -_BELOW]
    if floor is None:
        tilt = math.degrees(settings.max_tilt)
        text = f"no floor among {points} points: no plane within {tilt:.0f} degrees of the horizontal"
        raise InputError(f"{text}; see the options axes and max-tilt")
    return floor


def level(points: np.ndarray, floor: Plane) -> np.ndarray:
    """Levels a cloud: the smallest rotation after which its floor is the plane z = 0.

    The floor point below the middle of the cloud keeps its x and y.

    Raises:
        InputError: if points are invalid.
    """
    points = finite_points(points)
    foot, turn = _foot(points, floor), _onto_vertical(floor.normal)
    return (points - foot) @ turn.T + (*foot[:2], 0)


def unlevelled(points: np.ndarray, floor: Plane) -> np.ndarray:
    """Motion float64 [4, 4] from the frame after `level(points, floor)` back to the frame of the points, m."""
    foot, turn = _foot(points, floor), _onto_vertical(floor.normal)
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = turn.T, foot - turn.T @ (*foot[:2], 0)
    return motion


def _foot(points: np.ndarray, floor: Plane) -> np.ndarray:
    """The floor point below the middle of the cloud."""
    x, y = points[:, :2].mean(axis=0)
    return np.array([x, y, (floor.offset - floor.normal[:2] @ (x, y)) / floor.normal[2]])


def register(
    points: np.ndarray, target: np.ndarray, guess: np.ndarray | None = None, reach: float = 0.5, voxel: float = 0.05
) -> np.ndarray:
    """Registers a cloud to another one by iterated closest points, point to plane (Chen and Medioni 1992).

    Args:
        points, target: float [n, 3], [m, 3], m; most of their area overlaps.
        guess: float64 [4, 4], initial motion.
        reach: m, initial distance limit for point pairs; it shrinks to two voxels.
        voxel: m, voxel size for thinning both clouds.

    Returns:
        float64 [4, 4], ``target = motion @ (points, 1)``.

    Raises:
        InputError: if an argument is out of range, or fewer than 100 pairs remain, because the clouds do not overlap
            near the guess.
    """
    from scipy.spatial import cKDTree
    from scipy.spatial.transform import Rotation

    for name, value in (("reach", reach), ("voxel", voxel)):
        if not 0 < real(value) < math.inf:
            raise InputError(f"{name} is {shown(value)}; need a positive number of metres")
    motion = _motion(guess)
    points = thinned(finite_points(points), voxel)
    target = thinned(finite_points(target, "points of the target"), voxel)
    if len(target) < _NEIGHBOURS:
        raise InputError(f"registration: a target of {len(target)} voxels; need at least {_NEIGHBOURS}")
    tree = cKDTree(target)
    across, flat = normals(target, tree)
    for limit in np.geomspace(reach, 2 * voxel, 40):
        moved = points @ motion[:3, :3].T + motion[:3, 3]
        distance, nearest = tree.query(moved, distance_upper_bound=limit)
        paired = np.isfinite(distance)
        paired[paired] = flat[nearest[paired]]
        if paired.sum() < 100:
            raise InputError(f"registration: {paired.sum()} pairs of points within {limit:.2f} m; need at least 100")
        p, q, n = moved[paired], target[nearest[paired]], across[nearest[paired]]
        system = np.concatenate([np.cross(p, n), n], axis=1)
        small = np.linalg.lstsq(system, ((q - p) * n).sum(axis=1), rcond=None)[0]
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = Rotation.from_rotvec(small[:3]).as_matrix(), small[3:]
        motion = step @ motion
    return motion


def _motion(guess: Any) -> np.ndarray:
    """A motion as float64 [4, 4]; the identity for None."""
    try:
        motion = np.eye(4) if guess is None else np.array(guess, dtype=float)
    except (TypeError, ValueError):
        motion = np.empty(0)
    if motion.shape != (4, 4) or not np.isfinite(motion).all():
        raise InputError(f"guess is {shown(guess)}; need a motion [4, 4], all finite numbers")
    return motion


def thinned(points: np.ndarray, voxel: float) -> np.ndarray:
    """Mean point in each occupied voxel, float64 [k, 3].

    Raises:
        InputError: if the cloud spans too many voxels for their numbers.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    with np.errstate(over="ignore"):
        most = max(np.prod((high - low) / voxel + 2), np.abs([low, high]).max() / voxel)
    if most > _MOST_VOXELS:
        raise InputError(f"points span {spans(low, high)} m: too much for voxels of {voxel:g} m; are they in metres?")
    cells = np.floor(points / voxel).astype(np.int64)
    cells -= cells.min(axis=0)
    _, which, count = np.unique(
        np.ravel_multi_index(cells.T, cells.max(axis=0) + 1), return_inverse=True, return_counts=True
    )
    return np.stack([np.bincount(which, axis) / count for axis in points.T], axis=1)


def best_plane(points: np.ndarray, settings: FloorSettings, max_tilt: float) -> Plane | None:
    """Finds the plane with the most points, tilted by at most ``max_tilt`` rad; None with fewer than ten points."""
    from scipy.spatial import cKDTree

    if len(points) < 10:
        return None
    rng = np.random.default_rng(settings.seed)
    tree = cKDTree(points)
    least = math.cos(max_tilt)
    best, support = None, 9
    for first in rng.integers(len(points), size=_HYPOTHESES):
        near = tree.query_ball_point(points[first], settings.reach)
        if len(near) < 3:
            continue
        a, b, c = points[[first, *rng.choice(near, 2)]]
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        if length < 1e-9 or abs(normal[2]) < least * length:
            continue
        normal *= math.copysign(1 / length, normal[2])
        count = int(np.count_nonzero(np.abs(points @ normal - normal @ a) < settings.thickness))
        if count > support:
            best, support = (normal, float(normal @ a)), count
    return _refined(points, Plane(*best, support), settings.thickness, max_tilt) if best else None


def _refined(points: np.ndarray, plane: Plane, thickness: float, max_tilt: float) -> Plane:
    """Fits the plane to its inliers by least squares until the inliers no longer change.

    A fit that exceeds the largest tilt is discarded.
    """
    inliers = np.zeros(len(points), bool)
    for _ in range(_REFINEMENTS):
        near = np.abs(plane.heights(points)) < thickness
        if (near == inliers).all() or near.sum() < 3:
            break
        inliers = near
        middle = points[inliers].mean(axis=0)
        normal = np.linalg.svd(points[inliers] - middle, full_matrices=False)[2][2]
        normal = normal * math.copysign(1, normal[2])
        if normal[2] < math.cos(max_tilt):
            break
        plane = Plane(normal, float(normal @ middle), int(inliers.sum()))
    return plane


def _onto_vertical(normal: np.ndarray) -> np.ndarray:
    """Smallest rotation [3, 3] from a unit vector to +z."""
    x, y, z = normal
    skew = np.array([[0, 0, -x], [0, 0, -y], [x, y, 0]])
    return np.eye(3) + skew + skew @ skew / (1 + z)


def normals(points: np.ndarray, tree, neighbours: int = _NEIGHBOURS) -> tuple[np.ndarray, np.ndarray]:
    """Normals [n, 3] from the nearest neighbours, and bool [n]: whether these neighbours lie on a plane."""
    near = points[tree.query(points, neighbours)[1]]
    centred = near - near.mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))
    return vectors[:, :, 0], values[:, 0] < 0.1 * values[:, 1]
