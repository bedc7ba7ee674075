"""Poses that the robot can leave, and the nearest of them.

The robot can stand at many poses that it cannot leave: its feet find footholds off neutral, but no way leads from there
to neutral feet, on which it drives. It can leave a state if some way leads to a base position as far away as the robot
is long.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence

import numpy as np

from hdsp.abstract.transform import feet_at_all
from hdsp.detailed.actions.state_costs import state_costs
from hdsp.detailed.search.leaving import leave
from hdsp.detailed.states import pack_states
from hdsp.detailed.world.world import World
from hdsp.robot.lattice import HEADINGS, Grid, cells, heading_angle, metres
from hdsp.robot.robot import Robot

_AT_ONCE = 512  # poses examined together
_ROUNDING = 1e-9  # m
_FIRST_DISC = 1.1  # m, radius in which poses are looked for first
_FEW = 20_000  # expansions for each pose near an asked one; a way on free ground takes a few dozen


def length_of(robot: Robot) -> float:
    """Length (m) of body and neutral feet along the heading."""
    ahead = [robot.feet.neutral_x, *(box.x_max for box in robot.body.boxes)]
    behind = [-robot.feet.neutral_x, *(box.x_min for box in robot.body.boxes)]
    return max(ahead) - min(behind)


def can_leave(world: World, robot: Robot, state: np.ndarray) -> bool:
    """Whether the robot can get from a valid state, int64 [7], to a base position as far away as it is long.

    True is proved by a way. False is proved unless the search reached its limit
    (``hdsp.detailed.search.leaving.MOST_EXPANSIONS``).
    """
    return leave(world, state, cells(length_of(robot))) is None


def states_at(world: World, bases: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the states, int64 [n, 7], in which the robot stands at base poses, and whether it stands, bool [n].

    The robot stands on neutral feet, or where it cannot, on the feet from T_a->d.
    """
    states = np.concatenate([bases, np.zeros((len(bases), 4), dtype=np.int64)], axis=1)
    stands = np.isfinite(state_costs(world, pack_states(states, world.tables.lowest)))
    states[~stands], valid = feet_at_all(world, bases[~stands])
    stands[~stands] = valid
    return states, stands


def nearest_to_leave(
    world: World, grid: Grid, robot: Robot, pose: np.ndarray, heading_free: bool, radius: float, per_radian: float
) -> tuple[np.ndarray, float] | None:
    """Returns the nearest state that the robot can leave, int64 [7], and its distance; None without one.

    Poses from which the way is hard to find, i.e. takes more than 20,000 expansions, do not count.

    Args:
        world: terrain and robot, compiled.
        grid: place of the terrain in the world.
        robot: the robot.
        pose: float64 [3], world pose.
        heading_free: whether any heading is as near as the pose's.
        radius: largest distance, m.
        per_radian: distance for each radian of difference in heading, m.
    """
    length = cells(length_of(robot))
    # Base positions that a search has reached from a state without getting away, by packed state.
    stuck: dict[int, np.ndarray] = {}
    for bases, distance in _poses_outward(grid, pose, heading_free, radius, per_radian):
        states, stands = states_at(world, bases)
        keys = pack_states(states, world.tables.lowest)
        for k in np.flatnonzero(stands):
            state = states[k]
            places = stuck.get(int(keys[k]))
            if places is not None and np.hypot(*(places - state[:2]).T).max() < length:
                continue
            seen = leave(world, state, length, _FEW)
            if seen is None:
                return state, float(distance[k])
            stuck |= dict.fromkeys(pack_states(seen, world.tables.lowest).tolist(), np.unique(seen[:, :2], axis=0))
    return None


def _poses_outward(
    grid: Grid, pose: np.ndarray, heading_free: bool, radius: float, per_radian: float
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yields base poses int64 [n, 3] within a distance, and their distances, float64 [n], the nearest first.

    Cells are looked at in larger and larger discs, and poses in shells, so that near poses take little memory.
    """
    turned = abs(np.mod(heading_angle(np.arange(HEADINGS)) - pose[2] + math.pi, 2 * math.pi) - math.pi)
    with np.errstate(over="ignore"):  # a turn may be farther than any distance
        added = (0.0 if heading_free else per_radian) * turned
    farthest, whole, reach = radius + _ROUNDING, metres(float(sum(grid.shape))), _FIRST_DISC
    taken, complete = [0] * HEADINGS, False
    while not complete:
        complete = reach >= min(farthest, whole)
        at, away = _cells_within(grid, pose, min(reach, farthest))
        # A pose is at least as far away as its cell: up to here, all are known.
        known = farthest if complete else reach
        while (nearest := _nearest(away, added, taken)) <= known:
            until = min(nearest + metres(1.0), known)
            ends = [
                bisect_right(away, until, first, key=more.__add__)
                for first, more in zip(taken, added.tolist(), strict=True)
            ]
            cell = np.concatenate([np.arange(*span) for span in zip(taken, ends, strict=True)])
            heading = np.repeat(np.arange(HEADINGS), np.subtract(ends, taken))
            distance = away[cell] + added[heading]
            # Among equally near poses, the heading nearest to the pose's comes first.
            order = np.lexsort((heading, *at[cell].T[::-1], turned[heading], distance))
            bases = np.column_stack([at[cell], heading])[order]
            for first in range(0, len(bases), _AT_ONCE):
                yield bases[first : first + _AT_ONCE], distance[order][first : first + _AT_ONCE]
            taken = ends
        reach *= 2


def _nearest(away: np.ndarray, added: np.ndarray, taken: Sequence[int]) -> float:
    """Distance of the nearest pose that is not yet taken; inf without any."""
    left = [float(away[n]) + more for n, more in zip(taken, added.tolist(), strict=True) if n < len(away)]
    return min(left, default=math.inf)


def _cells_within(grid: Grid, pose: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Cells int64 [n, 2] with their centres within a distance (m), and these distances, float64 [n], the nearest first.

    Cells within a smaller distance are the first ones, in the same order.
    """
    middle, span = grid.cell(pose[:2]), math.ceil(min(cells(reach), max(grid.shape))) + 1
    low, high = np.maximum(middle - span, 0), np.minimum(middle + span + 1, grid.shape)
    (x, _), (_, y) = (grid.center(np.column_stack([axis] * 2)).T for axis in map(np.arange, low, high))
    away = np.hypot((x - pose[0])[:, None], y - pose[1])
    near = np.flatnonzero(away <= reach)
    near = near[np.argsort(away.ravel()[near], kind="stable")]
    return np.column_stack(np.unravel_index(near, away.shape)) + low, away.ravel()[near]
