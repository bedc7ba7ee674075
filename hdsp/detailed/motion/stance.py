"""Stances: the base over given feet, balanced, within leg limits, clear of the ground.

The base has five degrees of freedom over resting feet: two shifts, roll, pitch and height. ``find_stance`` returns the
valid stance nearest to a wanted one, while one foot may swing along given points.

Convention: ``Rz(heading) Ry(pitch) Rx(roll)`` takes the base frame to the world. Positive roll leans to the right,
positive pitch lowers the nose. Shifts are along the heading and to its left.
"""

import itertools
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.robot.robot import Robot

#: Results of ``find_stance``: the condition that fails, in the order of the checks, or success.
UNBALANCED, OUT_OF_REACH, TOUCHING, FOUND = range(4)

_SLACK = 0.002  # m; reserve to all limits, so that stances in between keep the limits, too
_LIFT = 0.05  # m; step size when a base in contact with the ground rises


class StanceLimits(NamedTuple):
    """Robot limits for the kernel, metres and radians."""

    hips: np.ndarray  # float64 [4, 3]
    min_length: float
    max_length: float
    mass_x: float
    mass_z: float
    margin: float
    max_roll: float
    max_pitch: float
    boxes: np.ndarray  # float64 [n, 4]: x_min, x_max, half width, lower side above the hips
    candidates: np.ndarray  # float64 [m, 4]: shifts x, y, changes of roll and pitch; the most comfortable first


class Ground(NamedTuple):
    """Heights [nx, ny], NaN = unknown, and their place: lower corner x, y and cell size, m."""

    heights: np.ndarray
    x: float
    y: float
    resolution: float


@lru_cache(maxsize=8)
def limits_of(robot: Robot) -> StanceLimits:
    """Robot limits for ``find_stance``."""
    s = robot.stance
    return StanceLimits(
        hips=robot.hips(),
        min_length=robot.legs.min_length,
        max_length=robot.legs.max_length,
        mass_x=s.mass_x,
        mass_z=s.mass_z,
        margin=s.margin,
        max_roll=s.max_roll,
        max_pitch=s.max_pitch,
        boxes=np.array([(b.x_min, b.x_max, b.half_width, b.above - s.base_height) for b in robot.body.boxes]),
        candidates=_candidates(s),
    )


def _candidates(stance) -> np.ndarray:
    """Deviations from the wanted stance, float64 [n, 4], sorted by their share of the limits."""
    shares = (
        np.linspace(-1, 1, 17),  # along x
        np.linspace(-1, 1, 9),
        np.linspace(-1, 1, 5),
        (0.0, -1 / 6, 1 / 6, -1 / 3, 1 / 3, -2 / 3, 2 / 3),
    )
    parts = np.array(list(itertools.product(*shares)))
    comfort = (parts**2).sum(axis=1)
    parts = parts[np.argsort(comfort, kind="stable")]
    return parts * np.array([stance.reach_x, stance.reach_y, stance.max_roll, stance.max_pitch])


@njit()
def find_stance(limits, ground, x, y, heading, feet, lifted, swing, wanted):
    """Returns the valid stance nearest to the wanted one.

    Args:
        limits: robot limits.
        ground: ground that the base must not touch.
        x, y, heading: planned base pose, m and rad.
        feet: float64 [4, 3], world, m.
        lifted: the foot in the air, or -1.
        swing: float64 [n, 3], points that this foot must reach from the same stance.
        wanted: float64 [3], wanted base height (m), roll and pitch (rad); wanted shift is 0.

    Returns:
        FOUND, or the failed condition of the best candidate (UNBALANCED, OUT_OF_REACH, TOUCHING); then x, y, z, roll
        and pitch of the base.
    """
    cos, sin = np.cos(heading), np.sin(heading)
    hips, candidates = limits.hips, limits.candidates
    best = UNBALANCED
    for k in range(len(candidates)):
        shift_x, shift_y = candidates[k, 0], candidates[k, 1]
        roll = min(max(wanted[1] + candidates[k, 2], -limits.max_roll), limits.max_roll)
        pitch = min(max(wanted[2] + candidates[k, 3], -limits.max_pitch), limits.max_pitch)
        bx, by = x + cos * shift_x - sin * shift_y, y + sin * shift_x + cos * shift_y
        r = rotation_matrix(cos, sin, roll, pitch)
        mx = bx + r[0, 0] * limits.mass_x + r[0, 2] * limits.mass_z
        my = by + r[1, 0] * limits.mass_x + r[1, 2] * limits.mass_z
        if _inside(feet, lifted, mx, my) < limits.margin + _SLACK:
            continue
        best = max(best, OUT_OF_REACH)
        low, high = -np.inf, np.inf
        for i in range(4):
            hx = bx + r[0, 0] * hips[i, 0] + r[0, 1] * hips[i, 1] + r[0, 2] * hips[i, 2]
            hy = by + r[1, 0] * hips[i, 0] + r[1, 1] * hips[i, 1] + r[1, 2] * hips[i, 2]
            hz = r[2, 0] * hips[i, 0] + r[2, 1] * hips[i, 1] + r[2, 2] * hips[i, 2]
            low, high = _reach(limits, hx, hy, hz, feet[i], low, high)
            if i == lifted:
                for n in range(len(swing)):
                    low, high = _reach(limits, hx, hy, hz, swing[n], low, high)
        if low > high:
            continue
        best = TOUCHING
        z = min(max(wanted[0], low), high)
        while True:
            if clear(limits.boxes, ground, bx, by, z, r):
                return FOUND, bx, by, z, roll, pitch
            if z == high:
                break
            z = min(z + _LIFT, high)
    return best, x, y, wanted[0], wanted[1], wanted[2]


@njit(inline="always")
def _reach(limits, hx, hy, hz, foot, low, high):
    """Narrows the base heights to those with an allowed leg length; ``hz`` is the hip above the base."""
    across = (hx - foot[0]) ** 2 + (hy - foot[1]) ** 2
    longest, shortest = (limits.max_length - _SLACK) ** 2 - across, (limits.min_length + _SLACK) ** 2 - across
    if longest < 0:
        return np.inf, -np.inf
    return max(low, foot[2] - hz + np.sqrt(max(shortest, 0.0))), min(high, foot[2] - hz + np.sqrt(longest))


@njit()
def rotation_matrix(cos, sin, roll, pitch):
    """Rz(heading) Ry(pitch) Rx(roll), float64 [3, 3], for cosine and sine of the heading."""
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    r = np.empty((3, 3))
    r[0, 0], r[0, 1], r[0, 2] = cos * cp, cos * sp * sr - sin * cr, cos * sp * cr + sin * sr
    r[1, 0], r[1, 1], r[1, 2] = sin * cp, sin * sp * sr + cos * cr, sin * sp * cr - cos * sr
    r[2, 0], r[2, 1], r[2, 2] = -sp, cp * sr, cp * cr
    return r


@njit()
def _inside(feet, lifted, mx, my):
    """Distance (m) from a point inside the support polygon to its edge; negative outside."""
    least = np.inf
    last = 3 if lifted != 3 else 2
    for i in range(4):
        if i == lifted:
            continue
        # The feet run counter-clockwise: inside is to the left of every edge.
        ax, ay = feet[last, 0], feet[last, 1]
        ex, ey = feet[i, 0] - ax, feet[i, 1] - ay
        least = min(least, (ex * (my - ay) - ey * (mx - ax)) / np.sqrt(ex * ex + ey * ey))
        last = i
    return least


@njit()
def clear(boxes, ground, x, y, z, r):
    """Whether no ground column reaches into a body box; boxes have no upper end.

    Args:
        boxes: body boxes as in ``StanceLimits``.
        ground: heights.
        x, y, z: base position.
        r: float64 [3, 3], base frame to world.
    """
    heights, resolution = ground.heights, ground.resolution
    reach, lowest = 0.0, np.inf
    for b in range(len(boxes)):
        corner = np.hypot(max(-boxes[b, 0], boxes[b, 1]), boxes[b, 2])
        reach, lowest = max(reach, corner + abs(boxes[b, 3])), min(lowest, boxes[b, 3] - corner)
    first_x = max(0, int(np.floor((x - reach - ground.x) / resolution)))
    first_y = max(0, int(np.floor((y - reach - ground.y) / resolution)))
    end_x = min(heights.shape[0], int(np.floor((x + reach - ground.x) / resolution)) + 1)
    end_y = min(heights.shape[1], int(np.floor((y + reach - ground.y) / resolution)) + 1)
    for ix in range(first_x, end_x):
        dx = ground.x + (ix + 0.5) * resolution - x
        for iy in range(first_y, end_y):
            top = heights[ix, iy] - z
            if not top > lowest:  # low enough, or unknown
                continue
            dy = ground.y + (iy + 0.5) * resolution - y
            if _reaches_into(boxes, dx, dy, top, r):
                return False
    return True


@njit()
def all_clear(boxes, ground, stances):
    """Whether no ground column reaches into a body box in any stance, float64 [n, 6]: x, y, z, roll, pitch, heading."""
    for k in range(len(stances)):
        x, y, z, roll, pitch, heading = stances[k]
        if not clear(boxes, ground, x, y, z, rotation_matrix(np.cos(heading), np.sin(heading), roll, pitch)):
            return False
    return True


@njit(inline="always")
def _reaches_into(boxes, dx, dy, top, r):
    """Whether the column below (dx, dy, top), relative to the base, reaches into a box."""
    # At height h of the column, the frame of the base sees (ax, ay, az) + h (r20, r21, r22).
    ax, ay, az = r[0, 0] * dx + r[1, 0] * dy, r[0, 1] * dx + r[1, 1] * dy, r[0, 2] * dx + r[1, 2] * dy
    for b in range(len(boxes)):
        low, high = (boxes[b, 3] - az) / r[2, 2], top  # above the lower side, below the top
        low, high = _between(ax, r[2, 0], boxes[b, 0], boxes[b, 1], low, high)
        low, high = _between(ay, r[2, 1], -boxes[b, 2], boxes[b, 2], low, high)
        if low < high - 1e-9:
            return True
    return False


@njit(inline="always")
def _between(start, slope, least, most, low, high):
    """Narrows [low, high] to the h with ``start + h slope`` in [least, most]."""
    if abs(slope) < 1e-12:
        return (low, high) if least <= start <= most else (np.inf, -np.inf)
    one, other = (least - start) / slope, (most - start) / slope
    return max(low, min(one, other)), min(high, max(one, other))


@njit()
def resting_stances(limits, ground, poses, feet, wanted):
    """``find_stance`` on four feet for many states: poses [n, 3], feet [n, 4, 3], wanted [n, 3].

    Returns:
        Results as in ``find_stance``, int64 [n], and x, y, z, roll, pitch, float64 [n, 5].
    """
    lacking, stances = np.empty(len(poses), np.int64), np.empty((len(poses), 5))
    nowhere = np.empty((0, 3))
    for k in range(len(poses)):
        x, y, heading = poses[k]
        found = find_stance(limits, ground, x, y, heading, feet[k], -1, nowhere, wanted[k])
        lacking[k] = found[0]
        stances[k] = found[1:]
    return lacking, stances
