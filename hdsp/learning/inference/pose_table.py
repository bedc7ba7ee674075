"""Constant tables of the footprint network: cells that it reads, relative to a base, and poses on the ways to goals."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from hdsp.learning.footprint_geometry import (
    ASIDE,
    CONTEXT_STEP,
    FEET,
    HEIGHT_TOLERANCE,
    LINE,
    POSES,
    PROFILE,
    REACH,
    SAMPLES,
    FootprintOptions,
    foot_cells,
    footprint_taps,
    requirement_points,
    rotated,
    turn_angles,
)
from hdsp.learning.inference.foot_way_kernels import FootPlaces
from hdsp.learning.inference.gather_kernels import PoseCells
from hdsp.robot.lattice import CELLS_PER_ABSTRACT

#: The four cells around a point, relative to the lowest, in the order of all weights.
CORNERS = np.array([(0, 0), (0, 1), (1, 0), (1, 1)])


@cache
def square(radius: int, step: int = 1) -> np.ndarray:
    """Returns the cells of a square around a cell, int64 [n, 2], read-only; y changes fastest."""
    along = np.arange(-radius, radius + 1, step)
    cells = np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1).reshape(-1, 2)
    cells.flags.writeable = False
    return cells


def numbers(cells: np.ndarray, across: int) -> np.ndarray:
    """Returns cells [..., 2] of a window with ``across`` cells along y as offsets of cell numbers, int64 [...]."""
    cells = np.asarray(cells)
    return np.ascontiguousarray(cells[..., 0] * across + cells[..., 1], np.int64)


def corner_weights(points: np.ndarray, highest: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Returns the lower cell, int64 [..., 2], and the bilinear weights of ``CORNERS``, float32 [..., 4], of points.

    Args:
        points: float32 [..., 2], in cells.
        highest: largest lower cell along each axis; None = no limit.
    """
    low = np.floor(points)
    low = low if highest is None else np.minimum(low, highest)
    x, y = np.moveaxis(points - low, -1, 0)
    weights = [(1 - x) * (1 - y), (1 - x) * y, x * (1 - y), x * y]
    return low.astype(np.int64), np.stack(weights, axis=-1).astype(np.float32)


class PoseTable:
    """Cells that the network reads at poses, relative to their base.

    Attributes:
        context: int64 [49, 2], footprints in the summary around the start.
        lower, weights: int64 [8, taps, 2], float32 [8, taps, 4], local features of the footprints of a turn, see
            ``corner_weights``.
        turned_local: int64 [n, 2], all cells that they read.
        along, profile, footholds: int64 [n, 2], cells ahead of the feet and behind them.
        feet: where feet find footholds; None for a network without foot ways.
    """

    def __init__(self, options: FootprintOptions):
        assert options.stance is not None
        self.context = square(REACH, CONTEXT_STEP)
        taps = footprint_taps(options)
        self.lower, self.weights = corner_weights(rotated(taps, turn_angles()))
        self.turned_local = np.unique((self.lower[:, :, None] + CORNERS).reshape(-1, 2), axis=0)
        feet = np.multiply(FEET, options.foot)
        self.along, self.profile, self.footholds = (
            (feet[:, None] + np.stack([offsets, np.zeros_like(offsets)], axis=-1)).reshape(-1, 2)
            for offsets in map(np.array, (LINE, PROFILE, range(PROFILE[0], PROFILE[-1] + 1)))
        )
        self.feet = _foot_places(options) if options.foot_ways else None
        self._straight = [taps[None], *(group.round()[None] for group in requirement_points(options.stance))]
        self._turned = [rotated(taps, turn_angles()).round()]
        self._turned += [rotated(group, turn_angles()).round() for group in requirement_points(options.stance)]
        above = [box.above for box in options.stance.boxes]
        self._limits = np.array([options.stance.level, options.stance.unevenness_cost, *above], np.float32)

    def straight(self, across: int) -> PoseCells:
        """Returns the cells of a pose with the start heading."""
        return self._cells(self._straight, across)

    def turned(self, across: int) -> PoseCells:
        """Returns the cells of the poses of a turn."""
        return self._cells(self._turned, across)

    def _cells(self, groups: list[np.ndarray], across: int) -> PoseCells:
        taps, _, feet, contacts, *bodies = (numbers(group.astype(np.int64), across) for group in groups)
        ends = np.cumsum([body.shape[1] for body in bodies], dtype=np.int64)
        body = np.concatenate(bodies, axis=1) if bodies else np.empty((len(taps), 0), np.int64)
        return PoseCells(taps, feet, contacts, body, ends, self._limits)


def _foot_places(options: FootprintOptions) -> FootPlaces:
    rules = options.foot_ways
    assert rules is not None
    region = np.array([*options.foot_region, options.rough_reach], np.int64)
    most = (limit + HEIGHT_TOLERANCE for limit in (rules.max_height, rules.max_clearance))
    limits = np.array([*most, rules.cost, rules.cost_per_cell, rules.cost_per_height], np.float32)
    return FootPlaces(foot_cells(options), region, rules.longest, limits)


@dataclass(frozen=True)
class Ways:
    """Poses on the straight ways to goals, after the start.

    Attributes:
        lower: int64 [goals, 4, 2], lower cell of each pose, relative to the base.
        weights: float32 [goals, 4, 4], see ``corner_weights``.
        turning: int64 [goals], first pose of a goal that turns among the poses of a turn; -1 = it does not.
    """

    lower: np.ndarray
    weights: np.ndarray
    turning: np.ndarray

    @classmethod
    def to(cls, goals: np.ndarray) -> Ways:
        """Ways to goals, float32 [goals, 3] in abstract steps in the robot frame."""
        share = np.linspace(0, 1, SAMPLES, dtype=np.float32)[1:, None] * np.float32(CELLS_PER_ABSTRACT)
        points = np.clip(goals[:, None, :2] * share + np.float32(REACH), 0, POSES - 1)
        lower, weights = corner_weights(points, POSES - 2)
        turning = np.where(goals[:, 2] > 0, 0, np.where(goals[:, 2] < 0, SAMPLES - 1, -1))
        return cls(lower - REACH, weights, turning.astype(np.int64))

    def cells(self) -> np.ndarray:
        """Returns all cells that some way reads, int64 [n, 2]."""
        corners = self.lower[:, :, None] + CORNERS
        read = (self.weights != 0) & (self.turning < 0)[:, None, None]
        return np.unique(corners[read].reshape(-1, 2), axis=0)


def goal_features(goals: np.ndarray) -> np.ndarray:
    """See ``hdsp.learning.networks.goals.goal_features``."""
    position = goals[:, :2]
    distance = np.hypot(*position.T)[:, None]
    direction = position / np.maximum(distance, np.float32(1e-6))
    return np.concatenate([goals, distance, direction, distance < 1e-3], axis=1).astype(np.float32)


def goal_cells(goals: np.ndarray) -> np.ndarray:
    """Returns goals as ``foot_way_rows`` takes them, int64 [G, 4]."""
    at = np.rint(goals[:, :2] * np.float32(CELLS_PER_ABSTRACT))
    turning = goals[:, 2] != 0
    heading = np.where(turning, np.where(goals[:, 2] > 0, 1, 2), 0)
    ahead = ~turning & (goals[:, 0] > 0) & (np.abs(at[:, 1]) <= ASIDE)
    at[turning] = 0
    return np.column_stack([at, heading, ahead]).astype(np.int64)
