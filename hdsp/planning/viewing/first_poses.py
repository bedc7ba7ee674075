"""Start and goal of the first query where a user names none."""

from __future__ import annotations

import numpy as np

from hdsp.base.errors import InputError
from hdsp.planning.planner import Planner

#: World pose (x, y, heading) in m and rad, or a state with 7 values; a goal's heading may be None (free).
Pose = tuple[float | None, ...]

#: Places that are tried, as shares of both sides of the map.
_SHARES = 0.2, 0.5, 0.8
_RADIUS = 0.3  # of the search for a pose around a place, as a share of the shorter side


def first_poses(planner: Planner, start: Pose | None = None, goal: Pose | None = None) -> tuple[Pose, Pose]:
    """Returns a start and a goal far apart, at poses that the robot can leave; a given one stays.

    Raises:
        InputError: there are no two such poses.
    """
    places = [pose for pose in (start, goal) if pose is not None] or None
    found = _standing(planner)
    if places is not None:
        from_here = np.hypot(*(found[:, :2] - np.array(places[0][:2], float)).T) if len(found) else np.empty(0)
        if not len(from_here) or from_here.max() == 0:
            raise InputError("the robot can stand and turn nowhere else on the map; give --start and --goal")
        other = _pose(found[int(from_here.argmax())])
        return (start, other) if start is not None else (other, places[0])
    apart = np.hypot(*(found[:, None, :2] - found[None, :, :2]).transpose(2, 0, 1))
    if not apart.size or apart.max() == 0:
        raise InputError("the robot can stand and turn at fewer than two places; give --start and --goal")
    first, last = sorted(np.unravel_index(int(apart.argmax()), apart.shape))
    return _pose(found[first]), _pose(found[last])


def _standing(planner: Planner) -> np.ndarray:
    """States on a coarse raster that the robot can leave, float64 [n, 7]."""
    (x, y), (length, width) = planner.terrain.origin, planner.terrain.size
    radius = _RADIUS * min(length, width)
    places = [(x + along * length, y + across * width) for across in _SHARES for along in _SHARES]
    states = [planner.nearest((*place, 0.0), radius) for place in places]
    return np.array([state for state in states if state is not None]).reshape(-1, 7)


def _pose(state: np.ndarray) -> Pose:
    return tuple(state[:3].tolist())
