"""Quick proofs that a goal cannot be reached, and what stands in the way.

Two relaxed problems, each of which allows more than the robot can do: what cannot be reached there cannot be reached at
all.

- **foot**: the ground on which each foot can roll, joined by the steps that it can make (``footing``).
- **pose**: driving and turning on neutral feet from one valid state to the next, and base shifts along the heading over
  poses at which each foot finds some foothold, begun where a foot can step. Three dimensions, but the headings at a
  cell are the bits of one word: all are moved at once.
"""

import math
from typing import NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.actions.state_costs import feet_cells, foot_row
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.relaxed.foothold_regions import Footing, efforts_to, find_footing
from hdsp.detailed.world.world import World, cell_index, collides
from hdsp.robot.lattice import HEADINGS

FOOT, POSE = "foot", "pose"


class Unreachable(NamedTuple):
    """Proof that no plan leads from a start to a goal.

    Cells are (ix, iy) of the map, int64. For the proof ``foot`` they are cells of that foot, else of the base.

    Attributes:
        proof: which relaxed problem shows it: ``foot`` or ``pose``.
        foot: for ``foot``, its number; else -1.
        from_start: where what can be reached from the start comes nearest to what is joined to the goal (for ``pose``
            by driving, for ``foot`` by steps that lead to it).
        from_goal: the other side of that gap; the same cell if only the headings differ there.
        blocked: [n, 2], the cells between the two, in a straight line.
        heading: heading along the gap, [0, 64).
        body_hits: [n, 2], cells of the terrain that the body would hit in the middle of the gap at that heading, the
            highest first.
        footless: feet that would find no foothold there, whatever their offset.
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
    world: World, start: np.ndarray, goal: np.ndarray, rules: Rules | None = None
) -> Unreachable | None:
    """Try to prove that a goal cannot be reached.

    Args:
        world: terrain and robot.
        start, goal: int64 [7], valid states in lattice units.
        rules: of the search.

    Returns:
        The proof, or None if there is none: then a plan may exist or not.
    """
    rules = rules or Rules()
    start, goal = np.asarray(start, dtype=np.int64), np.asarray(goal, dtype=np.int64)
    footing = find_footing(world, rules, 0.0)
    efforts = efforts_to(footing, world, goal[None])
    for foot in range(4):
        if efforts[foot, footing.region[_foothold(world, start, foot)]] == np.inf:
            return _gap_of_foot(world, footing, efforts[foot], start, goal, foot)
    allowed, poses, tables = _allowed_headings(rules), _new_poses(world), _mask_tables(world)
    reached = _flood(world, allowed, tables, poses, start, drive_only=rules.drive_only)
    if _holds(reached, goal):
        return None
    around_goal = _flood(world, allowed, tables, poses, goal, drive_only=True)
    return _gap_of_base(world, reached.any(axis=0), around_goal.any(axis=0), start, goal)


class _Poses(NamedTuple):
    """What is possible at each cell, one bit a heading; computed when first asked for.

    Attributes:
        plain: bool [nx, ny], even ground all around: neutral feet stand and roll at every heading.
        known: uint8 [nx, ny], bit 0: the masks for neutral feet are filled in, bit 1: ``some`` is.
        neutral: uint64 [nx, ny], the robot can stand on neutral feet.
        level: uint64 [nx, ny], and these feet are level.
        step: uint64 [nx, ny], and one of them can step.
        some: uint64 [nx, ny], the body is free and each foot finds some foothold.
    """

    plain: np.ndarray
    known: np.ndarray
    neutral: np.ndarray
    level: np.ndarray
    step: np.ndarray
    some: np.ndarray


class _MaskTables(NamedTuple):
    """Actions by headings as bits."""

    straight: np.ndarray  # uint64 [20], headings at which a drive move leads ahead or back
    shift_dx: np.ndarray  # int64 [n], displacements of base shifts
    shift_dy: np.ndarray
    shift_headings: np.ndarray  # uint64 [n], headings at which they are possible


_ALL = np.uint64(2**64 - 1)
_ONE = np.uint64(1)
_LAST = np.uint64(63)


def _bits(flags: np.ndarray) -> np.ndarray:
    """Rows of 64 flags as words, uint64 [...]."""
    return (flags.astype(np.uint64) << np.arange(HEADINGS, dtype=np.uint64)).sum(axis=-1, dtype=np.uint64)


def _allowed_headings(rules: Rules) -> np.uint64:
    off = (np.arange(HEADINGS) - rules.heading_center + HEADINGS // 2) % HEADINGS - HEADINGS // 2
    return np.uint64(_bits(abs(off) <= rules.heading_window))


def _mask_tables(world: World) -> _MaskTables:
    t = world.tables
    shifts = t.shifts[:, :2]
    ways = [shifts, -shifts] if world.constants.shift_backward else [shifts]
    found = np.unique(np.concatenate(ways), axis=0)
    headings = [_bits(np.any([(way == d).all(axis=1) for way in ways], axis=0)) for d in found]
    return _MaskTables(_bits(t.straight.T), found[:, 0].copy(), found[:, 1].copy(), np.array(headings, np.uint64))


def _new_poses(world: World) -> _Poses:
    from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter

    inner = (slice(world.pad, world.pad + world.nx), slice(world.pad, world.pad + world.ny))
    height, standable = world.height.reshape(-1, world.stride), world.standable.reshape(-1, world.stride)
    # Neutral feet can stand, and roll on, at every heading; so none steps.
    feet = math.hypot(world.constants.neutral_x, world.constants.neutral_y) + 3
    even = distance_transform_edt(standable)[inner] > feet
    # No heading brings the body or two feet to heights that differ enough to matter.
    window = 2 * math.ceil(feet) + 1
    highest = np.maximum(maximum_filter(height, window), world.window_height.reshape(height.shape))
    most = min([world.constants.level, *world.tables.box_above.tolist()])
    even &= (highest <= minimum_filter(height, window) + most)[inner]
    masks = [np.zeros((world.nx, world.ny), dtype=np.uint64) for _ in range(4)]
    return _Poses(even, np.zeros((world.nx, world.ny), np.uint8), *masks)


def _flood(world, allowed, tables, poses, source, drive_only) -> np.ndarray:
    """Headings at each cell that are reached from a state, uint64 [2, nx, ny]; layer 0 on neutral feet, 1 on any."""
    reached = np.zeros((2, world.nx, world.ny), dtype=np.uint64)
    reached[int(source[3:].any()), source[0], source[1]] = _ONE << np.uint64(source[2])
    _flood_masks(world, allowed, tables, poses, reached, source[0], source[1], drive_only)
    return reached


def _holds(reached: np.ndarray, state: np.ndarray) -> bool:
    return bool(reached[int(state[3:].any()), state[0], state[1]] >> np.uint64(state[2]) & _ONE)


@njit()
def _flood_masks(world, allowed, tables, poses, reached, x, y, drive_only):
    nx, ny, move_dx, move_dy = world.nx, world.ny, world.tables.move_dx, world.tables.move_dy
    straight, shift_headings = tables.straight, tables.shift_headings
    shift_dx, shift_dy = tables.shift_dx, tables.shift_dy
    known, neutral, level, step, some = poses.known, poses.neutral, poses.level, poses.step, poses.some
    room = nx * ny + 1
    queue, waits = np.empty(room, np.int64), np.zeros((nx, ny), np.bool_)
    queue[0] = x * ny + y
    first, last = 0, 1
    while first != last:
        x, y = queue[first] // ny, queue[first] % ny
        first = (first + 1) % room
        waits[x, y] = False
        if known[x, y] == 0:
            _fill_neutral(world, allowed, poses, x, y)
        free = level[x, y]
        on_any = reached[1, x, y]
        on_neutral = reached[0, x, y] | (on_any & neutral[x, y])
        before = ~on_neutral
        while before != on_neutral:
            before = on_neutral
            turning = on_neutral & free
            turning = (turning << _ONE) | (turning >> _LAST) | (turning >> _ONE) | (turning << _LAST)
            on_neutral |= turning & neutral[x, y]
        if not drive_only:
            on_any |= on_neutral & step[x, y]
        reached[0, x, y], reached[1, x, y] = on_neutral, on_any
        for m in range(len(move_dx)):
            u, v = x + move_dx[m], y + move_dy[m]
            moved = on_neutral & (free | straight[m])
            if moved == 0 or not (0 <= u < nx and 0 <= v < ny) or moved & ~reached[0, u, v] == 0:
                continue
            if known[u, v] == 0:
                _fill_neutral(world, allowed, poses, u, v)
            new = moved & neutral[u, v] & ~reached[0, u, v]
            if new != 0:
                reached[0, u, v] |= new
                if not waits[u, v]:
                    waits[u, v] = True
                    queue[last] = u * ny + v
                    last = (last + 1) % room
        if on_any == 0 or drive_only:
            continue
        for m in range(len(shift_dx)):
            moved = on_any & shift_headings[m]
            u, v = x + shift_dx[m], y + shift_dy[m]
            if moved == 0 or not (0 <= u < nx and 0 <= v < ny) or moved & ~reached[1, u, v] == 0:
                continue
            if known[u, v] != 3:
                _fill_some(world, allowed, poses, u, v)
            new = moved & some[u, v] & ~reached[1, u, v]
            if new != 0:
                reached[1, u, v] |= new
                if not waits[u, v]:
                    waits[u, v] = True
                    queue[last] = u * ny + v
                    last = (last + 1) % room


@njit()
def _fill_neutral(world, allowed, poses, x, y):
    """Compute the masks of a cell for neutral feet."""
    if poses.plain[x, y]:
        poses.neutral[x, y] = poses.level[x, y] = poses.some[x, y] = allowed
        poses.known[x, y] = 3
        return
    t = world.tables
    standable, feet, height, steps = world.standable, t.feet, world.height, world.steps
    n_offsets, n_samples, neutral_offset, limit = t.n_offsets, t.n_samples, -t.lowest, world.constants.level
    step_backward = world.constants.step_backward
    p = cell_index(world, x, y)
    neutral, level, step = np.uint64(0), np.uint64(0), np.uint64(0)
    for h in range(HEADINGS):
        bit = _ONE << np.uint64(h)
        if allowed & bit == 0:
            continue
        o = neutral_offset
        p0, p1, p2, p3 = feet_cells(p, feet, n_offsets, n_samples, h, o, o, o, o)
        if not (standable[p0] and standable[p1] and standable[p2] and standable[p3]) or collides(world, h, p):
            continue
        neutral |= bit
        h0, h1, h2, h3 = height[p0], height[p1], height[p2], height[p3]
        if max(max(h0, h1), max(h2, h3)) - min(min(h0, h1), min(h2, h3)) <= limit:
            level |= bit
        ways = steps[p0] | steps[p1] | steps[p2] | steps[p3]
        if step_backward:
            ways |= (ways << np.uint64(HEADINGS // 2)) | (ways >> np.uint64(HEADINGS // 2))
        step |= ways & bit
    poses.neutral[x, y], poses.level[x, y], poses.step[x, y] = neutral, level, step
    poses.known[x, y] = 1


@njit()
def _fill_some(world, allowed, poses, x, y):
    """Compute the mask of a cell for any feet."""
    if poses.known[x, y] == 0:
        _fill_neutral(world, allowed, poses, x, y)
    if poses.known[x, y] == 3:
        return
    p = cell_index(world, x, y)
    some = poses.neutral[x, y]
    for h in range(HEADINGS):
        bit = _ONE << np.uint64(h)
        if (allowed & ~some) & bit != 0 and _footless(world, p, h) == 0 and not collides(world, h, p):
            some |= bit
    poses.some[x, y] = some
    poses.known[x, y] = 3


@njit()
def _footless(world, p, heading):
    """Feet that find no foothold at flat cell ``p``, as bits."""
    standable, feet = world.standable, world.tables.feet
    n_offsets, n_samples = world.tables.n_offsets, world.tables.n_samples
    missing = 0
    for foot in range(4):
        row = (heading * 4 + foot) * n_offsets
        found = False
        for offset in range(n_offsets):
            found = found or standable[p + feet[(row + offset) * n_samples]]
        missing |= (not found) << foot
    return missing


def _foothold(world: World, state: np.ndarray, foot: int) -> int:
    """Flat cell of a foot."""
    row = foot_row(world.tables, int(state[2]), foot, int(state[3 + foot]) - world.tables.lowest)
    return int(cell_index(world, state[0], state[1])) + int(world.tables.feet[row])


def _gap_of_base(world: World, reached: np.ndarray, around_goal: np.ndarray, start, goal) -> Unreachable:
    one, other, between, heading = _gap(reached, around_goal, start, goal)
    x, y = between[len(between) // 2] if len(between) else other
    p = int(cell_index(world, x, y))
    missing = _footless(world, p, heading)
    footless = tuple(foot for foot in range(4) if missing >> foot & 1)
    return Unreachable(POSE, -1, one, other, between, heading, body_hits(world, x, y, heading), footless)


def _gap_of_foot(world: World, footing: Footing, efforts: np.ndarray, start, goal, foot: int) -> Unreachable:
    inner = (slice(world.pad, world.pad + world.nx), slice(world.pad, world.pad + world.ny))
    region = footing.region.reshape(-1, world.stride)[inner]
    ahead = np.zeros(len(efforts), dtype=bool)
    ahead[footing.region[_foothold(world, start, foot)]] = True
    while True:
        wider = ahead | np.isfinite(footing.effort[ahead]).any(axis=0)
        if (wider == ahead).all():
            break
        ahead = wider
    known = region >= 0
    one, other, between, heading = _gap(known & ahead[region], known & np.isfinite(efforts)[region], start, goal)
    return Unreachable(FOOT, foot, one, other, between, heading, np.empty((0, 2), np.int64), (foot,))


def _gap(one: np.ndarray, other: np.ndarray, start: np.ndarray, goal: np.ndarray):
    """Where two regions, bool [nx, ny], come nearest: a cell of each, the cells between, the heading along the gap.

    Of equally narrow gaps the one that makes the shortest way from start to goal.
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


def body_hits(world: World, ix: int, iy: int, heading: int) -> np.ndarray:
    """Cells of the map that the body would hit at a pose, int64 [n, 2], with the highest first."""
    t, p = world.tables, int(cell_index(world, ix, iy))
    feet = world.height[[p + t.feet[foot_row(t, heading, foot, -t.lowest)] for foot in range(4)]]
    feet = feet[feet > -np.inf]
    ground = min(world.height[p], feet.mean() if len(feet) else np.inf)
    boxes = [p + t.box_cells[b, heading, : t.box_count[b, heading]] for b in range(len(t.box_above))]
    hit = np.concatenate([cells[world.height[cells] > ground + t.box_above[b]] for b, cells in enumerate(boxes)])
    hit = np.unique(hit)
    hit = hit[np.argsort(-world.height[hit], kind="stable")]
    return np.stack([hit // world.stride - world.pad, hit % world.stride - world.pad], axis=1)
