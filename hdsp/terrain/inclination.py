"""Inclination of the ground under feet, for checks: measured on any ground, without the planner's cost maps.

The rule is that of ``hdsp.robot.action_limits.Slope``: the gradient of the ground in the robot frame lies within an
ellipse. A gradient is measured over the length on which an edge that a wheel just passes is no steeper than the limit.

Convention: x forward, y left, m; angles in rad.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from hdsp.robot.lattice import cells, metres
from hdsp.robot.robot import Robot
from hdsp.terrain.cost_maps import slope_directions, steep_reach
from hdsp.terrain.rounding import height_tolerance

#: Heights (m) at points (x, y), with x's shape; NaN = unknown.
Heights = Callable[[np.ndarray, np.ndarray], np.ndarray]

_DIRECTIONS = np.arange(8) * math.pi / 8
_SHIFTS = np.array([-1.0, 0.0, 1.0])
_ROUNDING = 1e-3  # share of a limit that rounding of heights may take
_AT_BENDS = 0.05  # the same where a slope begins, if the planner measured it between cells in other directions


class Inclination(NamedTuple):
    """Ground under feet [n] in the direction in which it is steepest, compared with the limit in this direction.

    Attributes:
        angle: rad.
        limit: rad.
        too_steep: bool.
    """

    angle: np.ndarray
    limit: np.ndarray
    too_steep: np.ndarray


def inclination(
    heights: Heights, feet: np.ndarray, headings: np.ndarray, robot: Robot, cell: float = 0.0
) -> Inclination:
    """Measures the ground under feet.

    Ground beyond an edge that no wheel passes, and unknown ground, does not count. The place of a foot is uncertain by
    half a cell, so the least gradient within this distance counts.

    Args:
        heights: the ground.
        feet: float64 [n, 2], world positions, m; with cells, the centres of their cells.
        headings: float64 [n], headings of the robot, rad.
        robot: its limits.
        cell: side of the cells in which the ground is known, m; 0 = known at any point. A gradient is then measured
            between centres of cells.
    """
    ahead, left = robot.slope.steepest()
    half = metres(math.ceil(cells(robot.drive.highest_edge / min(ahead, left)) / 2 - 1e-9))
    angles = np.asarray(headings, float)[:, None] + _DIRECTIONS
    unit = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    shift = (cell or metres(0.5)) * unit
    offset = half * unit
    if cell:
        offset, shift = (cell * np.rint(np.round(vectors / cell, 6)) for vectors in (offset, shift))
    length = np.linalg.norm(offset, axis=-1)
    turned = np.arctan2(offset[..., 1], offset[..., 0]) - np.asarray(headings, float)[:, None]
    limits = np.hypot(ahead * np.cos(turned), left * np.sin(turned))
    middles = feet[:, None, None] + shift[:, :, None] * _SHIFTS[:, None]
    high, low = (heights(*np.moveaxis(middles + side * offset[:, :, None], -1, 0)) for side in (1.0, -1.0))
    gradients = np.nan_to_num(np.abs(high.astype(float) - low).min(axis=-1) / (2 * length))
    most = limits * (1 + (_ROUNDING if cell else _AT_BENDS))
    row, column = np.nonzero(gradients > most)
    gradients[row, column] *= ~_crosses_edge(heights, feet[row], unit[row, column], half, robot)
    worst = np.arange(len(feet)), (gradients / limits).argmax(axis=1)
    return Inclination(np.arctan(gradients[worst]), np.arctan(limits[worst]), gradients[worst] > most[worst])


def inclination_at_cell(heights: np.ndarray, cell: tuple[int, int], robot: Robot) -> float:
    """Steepest inclination at a cell as the planner measures it, rad; 0 on even ground.

    The rule is that of ``hdsp.terrain.cost_maps``: between cells on both sides, over each length up to the longest,
    as far as no edge lies at an end; a rise that a wheel passes as an edge does not count.

    Args:
        heights: float [nx, ny], m; NaN or -inf = unknown.
        cell: (ix, iy).
        robot: its limits.
    """
    reach = steep_reach(robot) + 1
    near = np.full((2 * reach + 1, 2 * reach + 1), np.nan)
    low = np.maximum(np.array(cell) - reach, 0)
    part = heights[low[0] : cell[0] + reach + 1, low[1] : cell[1] + reach + 1]
    at = low - np.array(cell) + reach
    near[at[0] : at[0] + part.shape[0], at[1] : at[1] + part.shape[1]] = np.where(np.isfinite(part), part, np.nan)
    highest, steepest = robot.drive.highest_edge, 0.0
    for direction in slope_directions(robot):
        for offset in direction:
            high, low = (tuple(reach + side * offset) for side in (1, -1))
            if _is_edge(near, high, highest) or _is_edge(near, low, highest):
                break
            rise, length = abs(float(near[high] - near[low])), 2 * metres(float(np.hypot(*offset)))
            if rise > highest + height_tolerance(near[high]):
                steepest = max(steepest, rise / length)
    return math.atan(steepest)


def _is_edge(heights: np.ndarray, cell: tuple[int, ...], highest: float) -> bool:
    """Whether a cell is unknown, or differs from a known neighbour by more than ``highest``."""
    around = heights[cell[0] - 1 : cell[0] + 2, cell[1] - 1 : cell[1] + 2]
    if not np.isfinite(heights[cell]):
        return True
    return bool(np.nanmax(abs(around - heights[cell]), initial=0.0) > highest + height_tolerance(heights[cell]))


def _crosses_edge(heights: Heights, feet: np.ndarray, unit: np.ndarray, half: float, robot: Robot) -> np.ndarray:
    """Whether an edge lies on the line between both ends of a measurement, or beside one of them; bool [n]."""
    cell = metres(1.0)
    along = np.arange(-half - cell, half + 1.5 * cell, cell)
    across = np.stack([-unit[:, 1], unit[:, 0]], axis=-1)
    line = feet[:, None] + unit[:, None] * along[:, None]
    crossed = np.zeros(len(feet), bool)
    for aside in (-cell, 0.0, cell):
        at = line + aside * across[:, None]
        jumps = np.abs(np.diff(heights(at[..., 0], at[..., 1]).astype(float), axis=1))
        # Beside the line, only the cells next to the ends matter.
        jumps = jumps if aside == 0 else np.delete(jumps, np.s_[2:-2], axis=1)
        crossed |= ~(jumps.max(axis=1, initial=0.0) <= robot.drive.highest_edge)
    return crossed
