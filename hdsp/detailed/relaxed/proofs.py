"""Quick proofs that a goal is unreachable, and the place of the obstacle.

Each proof solves a relaxed problem, which allows more than the robot can do. A goal that is unreachable in a relaxed
problem is unreachable for the robot.

- **foot**: the ground over which each foot can roll, connected by possible steps (``foothold_regions``).
- **pose**: driving and turning on neutral feet between valid states, and base shifts along the heading between poses
  at which each foot finds some foothold. Base shifts begin where a foot can step. The problem has three dimensions, but
  the headings at a cell are bits in one word, so one operation moves all of them.
"""

from typing import NamedTuple

import numpy as np

from hdsp.base.gradual import Steps, finished
from hdsp.detailed.actions.state_costs import foot_row
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.base_pose import ground_plane
from hdsp.detailed.relaxed.foothold_regions import (
    FootholdRegions,
    efforts_to,
    find_foothold_regions,
    foothold_region_steps,
)
from hdsp.detailed.relaxed.heading_masks import PoseFlood, holds, missing_feet
from hdsp.detailed.world.world import World, cell_index
from hdsp.robot.lattice import HEADINGS

FOOT, POSE = "foot", "pose"


class Unreachable(NamedTuple):
    """Proof that no plan leads from a start to a goal.

    Cells are (ix, iy) in the map, int64: cells of the foot for the proof ``foot``, cells of the base for ``pose``.

    Attributes:
        proof: relaxed problem without a path to the goal, ``foot`` or ``pose``.
        foot: number of the foot for ``foot``, -1 for ``pose``.
        from_start: reachable cell nearest to the cells connected to the goal (for ``pose`` by driving, for ``foot`` by
            steps toward the goal).
        from_goal: cell on the other side of this gap; the same cell if only the headings differ.
        blocked: [n, 2], cells between the two sides, in a straight line.
        heading: heading along the gap, [0, 64).
        body_hits: [n, 2], terrain cells that the body hits in the middle of the gap at this heading, the highest first.
        footless: feet without a foothold in the middle of the gap at this heading, at any offset.
    """

    proof: str
    foot: int
    from_start: np.ndarray
    from_goal: np.ndarray
    blocked: np.ndarray
    heading: int
    body_hits: np.ndarray
    footless: tuple[int, ...]


def why_unreachable(
    world: World, start: np.ndarray, goals: np.ndarray, rules: Rules | None = None
) -> Unreachable | None:
    """Tries to prove that a goal, or each of several goals, is unreachable.

    Args:
        world: terrain and robot.
        start: int64 [7], a valid state in lattice units.
        goals: int64 [7] or [n, 7], valid states.
        rules: restrictions of the search.

    Returns:
        The proof, or None without a proof; a plan may then exist or not. Its gap lies between the start and the goal
        nearest to it in a straight line.
    """
    return finished(proof_steps(world, start, goals, rules))


def proof_steps(
    world: World, start: np.ndarray, goals: np.ndarray, rules: Rules | None = None
) -> Steps[Unreachable | None]:
    """Like `why_unreachable`, in short steps."""
    rules = rules or Rules()
    start, goals = np.asarray(start, dtype=np.int64), np.atleast_2d(np.asarray(goals, dtype=np.int64))
    goal = nearest_state(start, goals)
    regions = yield from foothold_region_steps(world, rules, 0.0)
    efforts = efforts_to(regions, world, goals)
    yield
    foot = _stopped_foot(world, regions, efforts, start)
    if foot is not None:
        return _gap_of_foot(world, regions, efforts[foot], start, goal, foot)
    flood = PoseFlood(world, rules)
    yield
    reached = yield from flood.steps_from(start, rules.drive_only, goals)
    if holds(reached, goals):
        return None
    around_goal = yield from flood.steps_from(goal, drive_only=True)
    return _gap_of_base(world, (reached != 0).any(axis=0), (around_goal != 0).any(axis=0), start, goal)


def nearest_state(start: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Returns the state, int64 [7], among [n, 7] whose base is nearest to the start's in a straight line."""
    return states[np.argmin(np.hypot(*(states[:, :2] - start[:2]).T))]


def is_foot_stopped(world: World, start: np.ndarray, goal: np.ndarray) -> bool:
    """Whether the proof ``foot`` holds, for two valid states, int64 [7]."""
    regions = find_foothold_regions(world, Rules(), 0.0)
    return _stopped_foot(world, regions, efforts_to(regions, world, goal[None]), start) is not None


def _stopped_foot(world: World, regions: FootholdRegions, efforts: np.ndarray, start: np.ndarray) -> int | None:
    """The first foot for which no steps lead from the start to the goal of ``efforts``."""
    stopped = (f for f in range(4) if efforts[f, regions.region[_foothold(world, start, f)]] == np.inf)
    return next(stopped, None)


def _foothold(world: World, state: np.ndarray, foot: int) -> int:
    """Flat cell index of a foot."""
    row = foot_row(world.tables, int(state[2]), foot, int(state[3 + foot]) - world.tables.lowest)
    return int(cell_index(world, state[0], state[1])) + int(world.tables.feet[row])


def _gap_of_base(world: World, reached: np.ndarray, around_goal: np.ndarray, start, goal) -> Unreachable:
    one, other, between, heading = _gap(reached, around_goal, start, goal)
    x, y = between[len(between) // 2] if len(between) else other
    p = int(cell_index(world, x, y))
    missing = missing_feet(world, p, heading)
    footless = tuple(foot for foot in range(4) if missing >> foot & 1)
    return Unreachable(
        POSE, -1, one, other, between, heading, body_hits(world, np.array([x, y, heading, 0, 0, 0, 0])), footless
    )


def _gap_of_foot(world: World, regions: FootholdRegions, efforts: np.ndarray, start, goal, foot: int) -> Unreachable:
    inner = (slice(world.pad, world.pad + world.nx), slice(world.pad, world.pad + world.ny))
    region = regions.region.reshape(-1, world.stride)[inner]
    ahead = np.zeros(len(efforts), dtype=bool)
    ahead[regions.region[_foothold(world, start, foot)]] = True
    while True:
        wider = ahead | np.isfinite(regions.effort[ahead]).any(axis=0)
        if (wider == ahead).all():
            break
        ahead = wider
    known = region >= 0
    one, other, between, heading = _gap(known & ahead[region], known & np.isfinite(efforts)[region], start, goal)
    return Unreachable(FOOT, foot, one, other, between, heading, np.empty((0, 2), np.int64), (foot,))


def _gap(one: np.ndarray, other: np.ndarray, start: np.ndarray, goal: np.ndarray):
    """Narrowest gap between two regions, bool [nx, ny]: a cell in each, the cells between, the heading along the gap.

    Among equally narrow gaps, it is the gap with the shortest distance from the start over the gap to the goal.
    """
    from scipy.ndimage import distance_transform_edt

    distance, nearest = distance_transform_edt(~other, return_indices=True)
    distance[~one] = np.inf
    ends = np.argwhere(distance <= distance.min() + 0.5)
    detour = np.hypot(*(ends - start[:2]).T) + np.hypot(*(ends - goal[:2]).T)
    a = ends[np.argmin(detour)]
    b = nearest[:, a[0], a[1]].astype(np.int64)
    n = int(abs(b - a).max())
    line = np.rint(a + (b - a) * np.arange(1, n)[:, None] / max(n, 1)).astype(np.int64)
    along = np.arctan2(b[1] - a[1], b[0] - a[0]) * HEADINGS / (2 * np.pi)
    return a, b, line, int(np.rint(along)) % HEADINGS


def body_hits(world: World, state: np.ndarray) -> np.ndarray:
    """Map cells that the body hits in a state int64 [7], int64 [n, 2], the highest first.

    Feet over unknown ground count as high as the mean of the others; feet out of reach count as far as they reach.
    """
    t, c, (ix, iy, heading) = world.tables, world.constants, (int(v) for v in state[:3])
    p = int(cell_index(world, ix, iy))
    offsets = np.clip(state[3:], t.lowest, t.lowest + t.n_offsets - 1)
    rows = [foot_row(t, heading, foot, int(offsets[foot]) - t.lowest) for foot in range(4)]
    heights = world.height[p + t.feet[rows]].astype(float)
    known = np.isfinite(heights)
    heights[~known] = heights[known].mean() if known.any() else 0.0
    ground, ahead, left = ground_plane(
        c.neutral_x, c.neutral_y, c.steepest_ahead, c.steepest_left, tuple(offsets.tolist()), tuple(heights.tolist())
    )
    cos, sin = t.ahead[heading]
    slope = ahead * cos - left * sin, ahead * sin + left * cos
    found = []
    for b in range(len(t.box_above)):
        n = t.box_count[b, heading]
        cells = p + t.box_cells[b, heading, :n]
        rise = slope[0] * t.box_dx[b, heading, :n] + slope[1] * t.box_dy[b, heading, :n]
        found.append(cells[world.height[cells] > ground + t.box_above[b] + rise])
    hit = np.unique(np.concatenate(found)) if found else np.empty(0, np.int64)
    hit = hit[np.argsort(-world.height[hit], kind="stable")]
    return np.stack([hit // world.stride - world.pad, hit % world.stride - world.pad], axis=1)
