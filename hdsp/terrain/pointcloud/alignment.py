"""Levelling a cloud on its floor, and registering one cloud to another.

The floor is the lowest plane that is nearly horizontal and well supported: planes are proposed by RANSAC (Fischler and
Bolles 1981) and refined by least squares on their inliers. Points are thinned to one per voxel first, so that ground
near the sensor, where points are dense, weighs no more than ground far away.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hdsp.base.errors import InputError

_HYPOTHESES = 400
_REFINEMENTS = 20
#: Share of the support of the best plane that a lower one needs to be the floor: ceilings and landings are larger.
_LEAST_SUPPORT = 0.15
#: m below a plane from which on points may belong to another one.
_BELOW = 0.12


@dataclass(frozen=True)
class FloorSettings:
    """How the floor is found.

    Attributes:
        max_tilt: rad, largest angle between the floor and the horizontal plane of the cloud.
        thickness: m, half of the noise of points on the floor.
        voxel: m, one point in each counts.
        reach: m, how far apart the points are that propose a plane.
        seed: of the proposals.
    """

    max_tilt: float = math.radians(15)
    thickness: float = 0.025
    voxel: float = 0.05
    reach: float = 1.5
    seed: int = 0

    def __post_init__(self):
        for name in ("max_tilt", "thickness", "voxel", "reach"):
            if not (np.isfinite(value := getattr(self, name)) and value > 0):
                raise InputError(f"floor: {name} is {value}; need a positive number")


@dataclass(frozen=True)
class Plane:
    """The points p with ``normal . p = offset``; the normal points up.

    Attributes:
        normal: float64 [3], length 1.
        offset: m.
        support: number of voxels on it.
    """

    normal: np.ndarray
    offset: float
    support: int

    @property
    def tilt(self) -> float:
        """Angle to the horizontal, rad."""
        return float(math.acos(min(1.0, self.normal[2])))

    def heights(self, points: np.ndarray) -> np.ndarray:
        """Distances above the plane, m, of points [n, 3]."""
        return points @ self.normal - self.offset


def fit_floor(points: np.ndarray, settings: FloorSettings | None = None) -> Plane:
    """The floor of a cloud.

    Args:
        points: float64 [n, 3], m, z roughly up.
        settings: how it is found.

    Raises:
        InputError: if no nearly horizontal plane has points enough.
    """
    settings = settings or FloorSettings()
    rest = thinned(points, settings.voxel)
    floor, largest = None, 0
    while True:
        plane = _best_plane(rest, settings)
        if plane is None or plane.support < _LEAST_SUPPORT * largest:
            break
        floor, largest = plane, max(largest, plane.support)
        rest = rest[plane.heights(rest) < -_BELOW]
    if floor is None:
        tilt = math.degrees(settings.max_tilt)
        raise InputError(f"no floor among {len(points)} points: no plane within {tilt:.0f} degrees of the horizontal")
    return floor


def level(points: np.ndarray, floor: Plane) -> np.ndarray:
    """The cloud turned by the smallest angle that makes its floor the plane z = 0.

    The point of the floor below the middle of the cloud stays where it is in x and y.
    """
    x, y = points[:, :2].mean(axis=0)
    foot = np.array([x, y, (floor.offset - floor.normal[:2] @ (x, y)) / floor.normal[2]])
    return (points - foot) @ _onto_vertical(floor.normal).T + (x, y, 0)


def register(
    points: np.ndarray, target: np.ndarray, guess: np.ndarray | None = None, reach: float = 0.5, voxel: float = 0.05
) -> np.ndarray:
    """The motion that lays a cloud on another one: iterated closest points, point to plane (Chen and Medioni 1992).

    Args:
        points, target: float64 [n, 3], [m, 3], m; they overlap for the larger part.
        guess: float64 [4, 4], motion to start from.
        reach: m, pairs further apart do not count; it shrinks to two voxels.
        voxel: m, thinning of both clouds.

    Returns:
        float64 [4, 4], ``target = motion @ (points, 1)``.

    Raises:
        InputError: if fewer than 100 pairs are left: the clouds do not overlap near the guess.
    """
    from scipy.spatial import cKDTree
    from scipy.spatial.transform import Rotation

    points, target = thinned(points, voxel), thinned(target, voxel)
    tree = cKDTree(target)
    normals, flat = _normals(target, tree)
    motion = np.eye(4) if guess is None else np.array(guess, dtype=float)
    for limit in np.geomspace(reach, 2 * voxel, 40):
        moved = points @ motion[:3, :3].T + motion[:3, 3]
        distance, nearest = tree.query(moved, distance_upper_bound=limit)
        paired = np.isfinite(distance)
        paired[paired] = flat[nearest[paired]]
        if paired.sum() < 100:
            raise InputError(f"registration: {paired.sum()} pairs of points within {limit:.2f} m; need at least 100")
        p, q, n = moved[paired], target[nearest[paired]], normals[nearest[paired]]
        system = np.concatenate([np.cross(p, n), n], axis=1)
        small = np.linalg.lstsq(system, ((q - p) * n).sum(axis=1), rcond=None)[0]
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = Rotation.from_rotvec(small[:3]).as_matrix(), small[3:]
        motion = step @ motion
    return motion


def thinned(points: np.ndarray, voxel: float) -> np.ndarray:
    """One point, the mean, of each voxel that has any; float64 [k, 3]."""
    cells = np.floor(points / voxel).astype(np.int64)
    cells -= cells.min(axis=0)
    _, which, count = np.unique(
        np.ravel_multi_index(cells.T, cells.max(axis=0) + 1), return_inverse=True, return_counts=True
    )
    return np.stack([np.bincount(which, axis) / count for axis in points.T], axis=1)


def _best_plane(points: np.ndarray, settings: FloorSettings) -> Plane | None:
    """The nearly horizontal plane that most points lie on, if at least ten do."""
    from scipy.spatial import cKDTree

    if len(points) < 10:
        return None
    rng = np.random.default_rng(settings.seed)
    tree = cKDTree(points)
    least = math.cos(settings.max_tilt)
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
    return _refined(points, Plane(*best, support), settings) if best else None


def _refined(points: np.ndarray, plane: Plane, settings: FloorSettings) -> Plane:
    """Least squares on the inliers, until these stay the same; keeps the plane where it would tilt too far."""
    inliers = np.zeros(len(points), bool)
    for _ in range(_REFINEMENTS):
        near = np.abs(plane.heights(points)) < settings.thickness
        if (near == inliers).all() or near.sum() < 3:
            break
        inliers = near
        middle = points[inliers].mean(axis=0)
        normal = np.linalg.svd(points[inliers] - middle, full_matrices=False)[2][2]
        normal = normal * math.copysign(1, normal[2])
        if normal[2] < math.cos(settings.max_tilt):
            break
        plane = Plane(normal, float(normal @ middle), int(inliers.sum()))
    return plane


def _onto_vertical(normal: np.ndarray) -> np.ndarray:
    """The rotation [3, 3] by the smallest angle that turns a unit vector onto +z."""
    x, y, z = normal
    skew = np.array([[0, 0, -x], [0, 0, -y], [x, y, 0]])
    return np.eye(3) + skew + skew @ skew / (1 + z)


def _normals(points: np.ndarray, tree) -> tuple[np.ndarray, np.ndarray]:
    """Normals [n, 3] from the ten nearest neighbours, and bool [n]: whether these lie on a plane."""
    neighbours = points[tree.query(points, 10)[1]]
    centred = neighbours - neighbours.mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))
    return vectors[:, :, 0], values[:, 0] < 0.1 * values[:, 1]
