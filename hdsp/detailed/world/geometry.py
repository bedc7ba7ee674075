"""Lattice cells under a robot's feet and body, as flat integer tables for the kernels.

Convention: a foot is in the cell nearest to ``base + t * move + R(theta) * (neutral + offset)``. A position exactly
between two cells belongs to the cell forward along x and toward the body along y, in the robot frame. Where the two
rules conflict (diagonal headings), it belongs to the cell forward. Mirrored and quarter-turned worlds therefore get
mirrored and quarter-turned cells.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hdsp.robot.lattice import DRIVE_MOVES, HEADINGS, cells, heading_angle, rotation
from hdsp.robot.robot import Robot
from hdsp.robot.shape import Rectangle

#: Nudge before rounding for a position exactly between two cells, in cells.
_NUDGE = 1e-6


class MoveSamples(NamedTuple):
    """Points on the drive moves where the state cost is sampled: ``t = 1/n .. 1`` with ``n = floor(length) + 1``.

    Attributes:
        displacement: float64 [n, 2], cells; row 0 is the state itself (t = 0), the other rows are samples with t < 1.
        first: int64 [20], first row per move.
        counts: int64 [20], number of rows per move; the sample at t = 1 is row 0 for the reached state.
    """

    displacement: np.ndarray
    first: np.ndarray
    counts: np.ndarray


def _move_samples() -> MoveSamples:
    rows, first, count = [(0.0, 0.0)], [], []
    for dx, dy in DRIVE_MOVES:
        n = math.floor(math.hypot(dx, dy)) + 1
        first.append(len(rows))
        count.append(n - 1)
        rows += [(dx * i / n, dy * i / n) for i in range(1, n)]
    return MoveSamples(np.array(rows), np.array(first), np.array(count))


MOVE_SAMPLES = _move_samples()


@lru_cache(maxsize=8)
def foot_cells(robot: Robot) -> np.ndarray:
    """Foot cells relative to the base cell.

    Returns:
        int64 [64 headings, 4 feet, offsets, samples, 2]; offsets from ``robot.offset_range()``, samples as in
        MOVE_SAMPLES.
    """
    low, high = robot.offset_range()
    neutral = cells(robot.neutral_feet())
    offsets = np.arange(low, high + 1)
    table = np.empty((HEADINGS, 4, len(offsets), len(MOVE_SAMPLES.displacement), 2), dtype=np.int64)
    for heading in range(HEADINGS):
        turn = rotation(float(heading_angle(heading)))
        for foot, (x, y) in enumerate(neutral):
            at = np.stack([x + offsets, np.full(len(offsets), y)], axis=1) @ turn.T + _inward(turn, y)
            table[heading, foot] = np.floor(at[:, None, :] + MOVE_SAMPLES.displacement[None] + 0.5)
    table.flags.writeable = False
    return table


@lru_cache(maxsize=8)
def contact_cells(robot: Robot) -> np.ndarray:
    """Middle cells of the foot contacts relative to the base cell, in the shape of ``foot_cells``.

    A contact moves by whole cells: its cell at the start of a move is shifted by the displacement, which is rounded as
    for a foot.
    """
    low, high = robot.offset_range()
    neutral = robot.neutral_feet()
    middle = cells(neutral - np.sign(neutral) * robot.feet.contact_inward)
    offsets = np.arange(low, high + 1)
    table = np.empty((HEADINGS, 4, len(offsets), len(MOVE_SAMPLES.displacement), 2), dtype=np.int64)
    for heading in range(HEADINGS):
        turn = rotation(float(heading_angle(heading)))
        for foot, (x, y) in enumerate(middle):
            inward = _inward(turn, y)
            at = np.stack([x + offsets, np.full(len(offsets), y)], axis=1) @ turn.T + inward
            moved = np.floor(MOVE_SAMPLES.displacement + inward + 0.5)
            table[heading, foot] = np.floor(at + 0.5)[:, None, :] + moved[None]
    table.flags.writeable = False
    return table


def _inward(turn: np.ndarray, y: float) -> np.ndarray:
    """Nudge that decides between two cells for a foot on the side of ``y``, float64 [2]."""
    return turn @ np.array([2 * _NUDGE, -_NUDGE * np.sign(y)])


class ArcMoves(NamedTuple):
    """Arcs by one heading step: ahead to the left, ahead to the right, back to the left, back to the right.

    "Left" raises the heading. Points between the ends are samples at ``t = 1/n .. (n - 1)/n`` with ``n = floor(length)
    + 1``, at the former heading before the middle of the arc and at the new one from there on.

    Attributes:
        displacement: int64 [64, 4, 2], cells; 0 = none.
        counts: int64 [64, 4], number of samples.
        feet: int64 [64, 4, samples, 4, 2], cells under neutral feet at the samples, relative to the base's first cell.
        contacts: int64, the same for the middle cells of the contacts.
        base: int64 [64, 4, samples, 2], cells under the base.
        factor: float64 [64, 4], cost factor of driving; inf = no arc.
    """

    displacement: np.ndarray
    counts: np.ndarray
    feet: np.ndarray
    contacts: np.ndarray
    base: np.ndarray
    factor: np.ndarray


@lru_cache(maxsize=8)
def arc_moves(robot: Robot) -> ArcMoves:
    """Arcs of a robot that does not turn on the spot; no arcs for other robots.

    An arc ends in a cell at least as far away as on a circle with the least radius, and within ``straight_deviation``
    of the mean heading; the nearest such cell to the end on the circle.
    """
    displacement, factor = np.zeros((HEADINGS, 4, 2), np.int64), np.full((HEADINGS, 4), np.inf)
    if robot.turn.radius is not None:
        for heading in range(HEADINGS):
            for arc in range(4):
                mean = heading_angle(heading) + (0.5 - arc % 2) * 2 * math.pi / HEADINGS
                displacement[heading, arc], factor[heading, arc] = _arc(robot, mean, 1 - 2 * (arc // 2))
    counts = np.floor(np.hypot(displacement[..., 0], displacement[..., 1]) + 1e-9).astype(np.int64)
    feet, contacts = (np.zeros((HEADINGS, 4, counts.max(), 4, 2), np.int64) for _ in range(2))
    base = np.zeros((HEADINGS, 4, counts.max(), 2), np.int64)
    at_rest = contact_cells(robot)[:, :, -robot.offset_range()[0], 0]
    neutral = cells(robot.neutral_feet())
    for heading, arc in np.ndindex(HEADINGS, 4):
        n = counts[heading, arc] + 1
        for s in range(n - 1):
            moved = displacement[heading, arc] * ((s + 1) / n)
            now = heading if 2 * (s + 1) < n else (heading + 1 - 2 * (arc % 2)) % HEADINGS
            turn = rotation(float(heading_angle(now)))
            for foot, (x, y) in enumerate(neutral):
                inward = _inward(turn, y)
                feet[heading, arc, s, foot] = np.floor(turn @ (x, y) + inward + moved + 0.5)
                contacts[heading, arc, s, foot] = at_rest[now, foot] + np.floor(moved + inward + 0.5).astype(np.int64)
            base[heading, arc, s] = np.floor(moved + _NUDGE * np.sign(moved) + 0.5)
    return ArcMoves(displacement, counts, feet, contacts, base, factor)


def _arc(robot: Robot, mean: float, ahead: int) -> tuple[np.ndarray, float]:
    """Displacement (cells) and cost factor of an arc with a mean heading (rad), ahead (1) or back (-1)."""
    assert robot.turn.radius is not None
    chord = 2 * cells(robot.turn.radius) * math.sin(math.pi / HEADINGS)
    span = np.arange(-math.ceil(chord) - 3, math.ceil(chord) + 4)
    grid = np.stack(np.meshgrid(span, span, indexing="ij"), axis=-1).reshape(-1, 2)
    along, across = (grid @ rotation(mean)).T
    off = np.arctan2(abs(across), ahead * along)
    far = np.hypot(along, across) >= max(chord - 1e-9, 0.5)
    chosen = np.flatnonzero(far & (off <= robot.drive.straight_deviation + 1e-9))
    if not len(chosen):
        return np.zeros(2, np.int64), math.inf
    best = chosen[np.argmin(np.round(np.hypot(along[chosen] - ahead * chord, across[chosen]), 9))]
    return grid[best], robot.drive.factor(float(off[best]) if ahead == 1 else math.pi - float(off[best]))


@lru_cache(maxsize=8)
def base_cells() -> np.ndarray:
    """Base cell at each sample, int64 [samples, 2]; halfway between two cells, the base counts as arrived."""
    arrived = _NUDGE * np.sign(MOVE_SAMPLES.displacement)
    return np.floor(MOVE_SAMPLES.displacement + arrived + 0.5).astype(np.int64)


def outline_cells(robot: Robot) -> np.ndarray:
    """Cells on the outline of the rectangle between the neutral feet, int64 [64 headings, n, 2], relative to the base.

    The points on the outline are half a cell apart at most, so no edge lies between two of its cells. A point between
    two cells adds both; mirrored and quarter-turned worlds therefore get mirrored and quarter-turned cells.
    """
    x, y = cells(robot.feet.neutral_x), cells(robot.feet.neutral_y)
    long, wide = np.linspace(-x, x, math.ceil(4 * x) + 1), np.linspace(-y, y, math.ceil(4 * y) + 1)
    sides = [np.stack([long, np.full_like(long, side)], axis=1) for side in (-y, y)]
    ends = [np.stack([np.full_like(wide, end), wide], axis=1) for end in (-x, x)]
    nudges = _NUDGE * np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)])
    outline = np.concatenate(sides + ends)
    by_heading = []
    for heading in range(HEADINGS):
        turned = (outline @ rotation(float(heading_angle(heading))).T)[:, None] + nudges
        by_heading.append(np.unique(np.floor(turned + 0.5).astype(np.int64).reshape(-1, 2), axis=0))
    longest = max(len(found) for found in by_heading)
    return np.array([np.pad(found, ((0, longest - len(found)), (0, 0)), mode="edge") for found in by_heading])


def rectangle_cells(rectangle: Rectangle, heading: int) -> np.ndarray:
    """Cells with centres in a robot's rectangle at ``heading``, int64 [n, 2] relative to the base cell."""
    corner = math.hypot(max(abs(rectangle.x_min), abs(rectangle.x_max)), rectangle.half_width)
    reach = math.ceil(cells(corner))
    span = np.arange(-reach, reach + 1)
    grid = np.stack(np.meshgrid(span, span, indexing="ij"), axis=-1).reshape(-1, 2)
    local = grid @ rotation(float(heading_angle(heading)))  # row vectors: this is R(-theta) applied to each
    tolerance = 1e-9
    x_min, x_max = cells(rectangle.x_min) - tolerance, cells(rectangle.x_max) + tolerance
    inside = (
        (local[:, 0] >= x_min) & (local[:, 0] <= x_max) & (abs(local[:, 1]) <= cells(rectangle.half_width) + tolerance)
    )
    return grid[inside]


@lru_cache(maxsize=1)
def base_shifts() -> np.ndarray:
    """Longitudinal base shift at each heading as (dx, dy, n), int64 [64, 3].

    The base moves to another cell and every foot offset changes by ``-n``, so the feet rest. At headings off the axes,
    no single cell lies exactly ahead. Among shifts one to four cells long, the table has the shift whose end is
    nearest to a cell.
    """
    table = np.empty((HEADINGS, 3), dtype=np.int64)
    for heading in range(HEADINGS):
        ahead = rotation(float(heading_angle(heading))) @ np.array([1.0, 0.0])
        candidates = []
        for n in range(1, 5):
            cell = np.rint(n * ahead)
            candidates.append((round(float(np.hypot(*(cell - n * ahead))), 9), n, *cell.astype(int)))
        _, n, dx, dy = min(candidates)
        table[heading] = dx, dy, n
    return table


@lru_cache(maxsize=8)
def step_line(robot: Robot) -> np.ndarray:
    """Cells ahead of a foot, int64 [64 headings, longest step + 1, 2], relative to the foot's cell."""
    length = math.floor(cells(robot.step.max_length) + 1e-9)
    reach = np.arange(length + 1)
    table = np.empty((HEADINGS, length + 1, 2), dtype=np.int64)
    for heading in range(HEADINGS):
        ahead = rotation(float(heading_angle(heading))) @ np.array([1.0, 0.0])
        table[heading] = np.rint(reach[:, None] * np.round(ahead, 12))
    return table
