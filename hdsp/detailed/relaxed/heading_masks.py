"""Reachable base poses: the headings at a cell are bits in one word, so one operation moves all of them."""

import math
from typing import NamedTuple

import numpy as np

from hdsp.base.gradual import Steps, finished
from hdsp.base.jit import njit
from hdsp.detailed.actions.action import DRIVES
from hdsp.detailed.actions.state_costs import feet_cells
from hdsp.detailed.actions.successors import Rules, allowed_headings
from hdsp.detailed.relaxed.bucket_queue import new_bucket_queue, put, take, waits
from hdsp.detailed.world.body import collides, may_be_free, on_slope
from hdsp.detailed.world.world import World, cell_index
from hdsp.robot.lattice import HEADINGS


class HeadingMasks(NamedTuple):
    """Possible headings at each cell, one bit per heading; computed on first use.

    Attributes:
        plain: bool [nx, ny], even ground all around: neutral feet stand and roll at every heading.
        known: uint8 [nx, ny], bit 0: the masks for neutral feet are computed; bit 1: ``some`` is computed.
        neutral: uint64 [nx, ny], the robot can stand on neutral feet.
        level: uint64 [nx, ny], neutral feet can stand and are level or on a slope.
        step: uint64 [nx, ny], neutral feet can stand, and one foot can step.
        some: uint64 [nx, ny], the body is free and each foot finds some foothold.
    """

    plain: np.ndarray
    known: np.ndarray
    neutral: np.ndarray
    level: np.ndarray
    step: np.ndarray
    some: np.ndarray


class PoseFlood:
    """Flood fill over the relaxed poses on one terrain, under the rules of a search."""

    def __init__(self, world: World, rules: Rules):
        self._world = world
        self._allowed = np.uint64(_bits(allowed_headings(rules)))
        self._tables, self._masks = _mask_tables(world), _new_masks(world)

    def reached_from(self, state: np.ndarray, drive_only: bool) -> np.ndarray:
        """Headings at each cell that a state int64 [7] can reach, as bits; uint64 [2, nx, ny].

        Layer 0 = on neutral feet, layer 1 = on any feet.
        """
        return finished(self.steps_from(state, drive_only))

    def steps_from(self, state: np.ndarray, drive_only: bool, goals: np.ndarray | None = None) -> Steps[np.ndarray]:
        """Like `reached_from`, in short steps.

        Args:
            state: int64 [7].
            drive_only: whether the robot makes no step.
            goals: int64 [n, 7]. The flood heads for the first one, and ends at any of them with the headings reached so
                far: on the way to a goal in reach, it looks at few cells. None: the flood reaches all it can.
        """
        nx, ny = self._world.nx, self._world.ny
        reached = _bits_of(state[None], (nx, ny))
        wanted = _bits_of(state[None][:0] if goals is None else goals, (nx, ny))
        x, y = (state if goals is None else goals[0])[:2]
        distance = np.hypot(*np.ogrid[-x : nx - x, -y : ny - y]).astype(np.int32)
        queue, first = new_bucket_queue(1.0, float(distance.max()), nx * ny), distance[state[0], state[1]]
        put(queue, state[0] * ny + state[1], first)
        least = np.array([first])
        world, allowed, tables, masks = self._world, self._allowed, self._tables, self._masks
        while not _flood(world, allowed, tables, masks, reached, wanted, queue, distance, least, _VISITS, drive_only):
            yield
        return reached


def holds(reached: np.ndarray, states: np.ndarray) -> bool:
    """Whether the reached headings contain any of some states, int64 [7] or [n, 7]."""
    states = np.atleast_2d(states)
    headings = reached[states[:, 3:].any(axis=1).astype(np.int64), states[:, 0], states[:, 1]]
    return bool((headings >> states[:, 2].astype(np.uint64) & _ONE).any())


def _bits_of(states: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Headings of states int64 [n, 7] at each cell, as in `PoseFlood.reached_from`."""
    bits = np.zeros((2, *shape), dtype=np.uint64)
    layers = states[:, 3:].any(axis=1).astype(np.int64)
    np.bitwise_or.at(bits, (layers, states[:, 0], states[:, 1]), _ONE << states[:, 2].astype(np.uint64))
    return bits


class MaskTables(NamedTuple):
    """Actions with their headings as bits."""

    drives: np.ndarray  # uint64 [2, 20], headings at which a drive move is possible; [1] for feet not level
    shift_dx: np.ndarray  # int64 [n], displacements of base shifts
    shift_dy: np.ndarray
    shift_headings: np.ndarray  # uint64 [n], headings at which the shifts are possible
    arc_dx: np.ndarray  # int64 [n], displacements of arcs
    arc_dy: np.ndarray
    arc_turn: np.ndarray  # int64 [n], heading steps of the arcs, 1 or -1
    arc_headings: np.ndarray  # uint64 [n], headings at which the arcs begin


_ONE = np.uint64(1)
_LAST = np.uint64(63)
_VISITS = 250  # visits to cells between two looks at the clock


def _bits(flags: np.ndarray) -> np.ndarray:
    """Packs rows of 64 flags into words, uint64 [...]."""
    return (flags.astype(np.uint64) << np.arange(HEADINGS, dtype=np.uint64)).sum(axis=-1, dtype=np.uint64)


def _mask_tables(world: World) -> MaskTables:
    t = world.tables
    shifts = t.shifts[:, :2]
    ways = [shifts, -shifts] if world.constants.shift_backward else [shifts]
    found = np.unique(np.concatenate(ways), axis=0)
    headings = [_bits(np.any([(way == d).all(axis=1) for way in ways], axis=0)) for d in found]
    possible = np.isfinite(t.drive_price)
    drives = _bits(possible[..., :DRIVES].transpose(0, 2, 1))
    at = np.argwhere(possible[0, :, DRIVES:])
    arcs = np.column_stack([t.arcs[at[:, 0], at[:, 1], :2], 1 - 2 * (at[:, 1] % 2)])
    distinct, which = np.unique(arcs, axis=0, return_inverse=True)
    arc_headings = np.zeros(len(distinct), np.uint64)
    np.bitwise_or.at(arc_headings, which.ravel(), _ONE << at[:, 0].astype(np.uint64))
    return MaskTables(
        drives=drives,
        shift_dx=found[:, 0].copy(),
        shift_dy=found[:, 1].copy(),
        shift_headings=np.array(headings, np.uint64),
        arc_dx=distinct[:, 0].copy(),
        arc_dy=distinct[:, 1].copy(),
        arc_turn=distinct[:, 2].copy(),
        arc_headings=arc_headings,
    )


def _new_masks(world: World) -> HeadingMasks:
    from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter

    inner = (slice(world.pad, world.pad + world.nx), slice(world.pad, world.pad + world.ny))
    height, standable = world.height.reshape(-1, world.stride), world.standable.reshape(-1, world.stride)
    # Neutral feet stand and roll on at every heading. A foot steps only where it cannot roll on, so no foot steps here.
    feet = math.hypot(world.constants.neutral_x, world.constants.neutral_y) + 3
    even = distance_transform_edt(standable)[inner] > feet
    # The heights under the body and under the feet differ too little to matter at any heading.
    window = 2 * math.ceil(feet) + 1
    highest = np.maximum(maximum_filter(height, window), world.window_height.reshape(height.shape))
    c, (ahead, left) = world.constants, world.tables.corner
    # A plane between the feet rises no more than its feet differ, per distance between them.
    leaning = 1 + ahead / (2 * c.neutral_x) + left / (2 * c.neutral_y)
    most = min([c.level, *(world.tables.box_above / leaning).tolist()])
    even &= (highest <= minimum_filter(height, window) + most)[inner]
    masks = [np.zeros((world.nx, world.ny), dtype=np.uint64) for _ in range(4)]
    return HeadingMasks(even, np.zeros((world.nx, world.ny), np.uint8), *masks)


@njit(nogil=True)
def _flood(world, allowed, tables, masks, reached, wanted, queue, distance, least, visits, drive_only):
    """Empties the queue or reaches a goal; returns False after so many visits to cells, and the next call continues.

    Args:
        world: terrain and robot.
        allowed: headings under the rules of the search, as bits.
        tables, masks: actions, and possible headings.
        reached: uint64 [2, nx, ny], see `PoseFlood.reached_from`; changed.
        wanted: uint64 [2, nx, ny], headings of the goals at each cell.
        queue: waiting cells, the one with the least distance first; changed.
        distance: int32 [nx, ny], order of the cells.
        least: int32 [1], no waiting cell has a smaller distance; changed.
        visits: number of visits.
        drive_only: whether the robot makes no step.
    """
    nx, ny, move_dx, move_dy = world.nx, world.ny, world.tables.move_dx, world.tables.move_dy
    drives, shift_headings = tables.drives, tables.shift_headings
    shift_dx, shift_dy = tables.shift_dx, tables.shift_dy
    known, neutral, level, step, some = masks.known, masks.neutral, masks.level, masks.step, masks.some
    heads = queue.heads
    while True:
        while least[0] < len(heads) and heads[least[0]] < 0:
            least[0] += 1
        if least[0] == len(heads):
            return True
        if visits == 0:
            return False
        visits -= 1
        at = np.int64(heads[least[0]])
        take(queue, at)
        x, y = at // ny, at % ny
        if known[x, y] == 0:
            _fill_neutral(world, allowed, masks, x, y)
        free = level[x, y]
        on_any = reached[1, x, y]
        on_neutral = reached[0, x, y] | (on_any & neutral[x, y])
        before = ~on_neutral
        while world.constants.on_the_spot and before != on_neutral:
            before = on_neutral
            turning = on_neutral & free
            turning = (turning << _ONE) | (turning >> _LAST) | (turning >> _ONE) | (turning << _LAST)
            on_neutral |= turning & neutral[x, y]
        if not drive_only:
            on_any |= on_neutral & step[x, y]
        reached[0, x, y], reached[1, x, y] = on_neutral, on_any
        if (on_neutral & wanted[0, x, y]) | (on_any & wanted[1, x, y]) != 0:
            return True
        for m in range(len(move_dx)):
            u, v = x + move_dx[m], y + move_dy[m]
            moved = on_neutral & ((free & drives[0, m]) | drives[1, m])
            if moved == 0 or not (0 <= u < nx and 0 <= v < ny) or moved & ~reached[0, u, v] == 0:
                continue
            if known[u, v] == 0:
                _fill_neutral(world, allowed, masks, u, v)
            new = moved & neutral[u, v] & ~reached[0, u, v]
            if new != 0:
                reached[0, u, v] |= new
                _wait(queue, distance, least, u, v)
        for m in range(len(tables.arc_dx)):
            moved = on_neutral & free & tables.arc_headings[m]
            moved = (
                (moved << _ONE) | (moved >> _LAST) if tables.arc_turn[m] == 1 else (moved >> _ONE) | (moved << _LAST)
            )
            u, v = x + tables.arc_dx[m], y + tables.arc_dy[m]
            if moved == 0 or not (0 <= u < nx and 0 <= v < ny) or moved & ~reached[0, u, v] == 0:
                continue
            if known[u, v] == 0:
                _fill_neutral(world, allowed, masks, u, v)
            new = moved & neutral[u, v] & ~reached[0, u, v]
            if new != 0:
                reached[0, u, v] |= new
                _wait(queue, distance, least, u, v)
        if on_any == 0 or drive_only:
            continue
        for m in range(len(shift_dx)):
            moved = on_any & shift_headings[m]
            u, v = x + shift_dx[m], y + shift_dy[m]
            if moved == 0 or not (0 <= u < nx and 0 <= v < ny) or moved & ~reached[1, u, v] == 0:
                continue
            if known[u, v] != 3:
                _fill_some(world, allowed, masks, u, v)
            new = moved & some[u, v] & ~reached[1, u, v]
            if new != 0:
                reached[1, u, v] |= new
                _wait(queue, distance, least, u, v)


@njit(inline="always")
def _wait(queue, distance, least, x, y):
    """Puts a cell into the queue, unless it waits."""
    node = x * distance.shape[1] + y
    if not waits(queue, node):
        put(queue, node, distance[x, y])
        least[0] = min(least[0], distance[x, y])


@njit()
def _fill_neutral(world, allowed, masks, x, y):
    """Computes the masks for neutral feet at a cell."""
    if masks.plain[x, y]:
        masks.neutral[x, y] = masks.level[x, y] = masks.some[x, y] = allowed
        masks.known[x, y] = 3
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
        if max(max(h0, h1), max(h2, h3)) - min(min(h0, h1), min(h2, h3)) <= limit or on_slope(world, h, p):
            level |= bit
        ways = steps[p0] | steps[p1] | steps[p2] | steps[p3]
        if step_backward:
            ways |= (ways << np.uint64(HEADINGS // 2)) | (ways >> np.uint64(HEADINGS // 2))
        step |= ways & bit
    masks.neutral[x, y], masks.level[x, y], masks.step[x, y] = neutral, level, step
    masks.known[x, y] = 1


@njit()
def _fill_some(world, allowed, masks, x, y):
    """Computes the mask for any feet at a cell."""
    if masks.known[x, y] == 0:
        _fill_neutral(world, allowed, masks, x, y)
    if masks.known[x, y] == 3:
        return
    p = cell_index(world, x, y)
    some = masks.neutral[x, y]
    for h in range(HEADINGS):
        bit = _ONE << np.uint64(h)
        if (allowed & ~some) & bit != 0 and may_be_free(world, h, p):
            some |= bit
    masks.some[x, y] = some
    masks.known[x, y] = 3


@njit()
def missing_feet(world, p, heading):
    """Feet without a foothold at flat cell ``p``, as bits."""
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
