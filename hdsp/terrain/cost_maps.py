"""Cost maps of a terrain: edges, unevenness, and cells where a foot can stand.

docs/cost-model.md describes the model and its evidence. ``dH`` is the height difference of a cell: the largest
difference to its eight neighbours.

- A foot stands on the highest ground in its contact, a small square (``contact_heights``).
- Unevenness ``S(c)`` is a weighted sum over all cells within a radius, with weights that fall linearly to zero. It sums
  the height differences between footholds, i.e. ``dH`` of ``contact_heights``.
- A foot can stand and roll on a cell if no cell within its clearance has ``dH`` above the drivable limit.
- Ground is too steep at a heading if its gradient in the robot frame leaves the ellipse of ``Slope``. The gradient is
  measured in eight directions, over the shortest length on which an edge below the drivable limit is no steeper than
  the limit; single such edges therefore count as no slope. No foot stands on a cell that is too steep at all headings.
- Foot cost ``C_F = 1 + 0.309 S`` and base cost ``C_B = 1`` give the state cost
  ``C = 0.5 C_B + 0.1 (sum C_F + max C_F) = 1 + k (max S + sum S)`` (paper, Sec. V-A).

A height difference or slope that exceeds its limit by rounding counts as within it (`hdsp.terrain.rounding`).

Convention: arrays are indexed ``[ix, iy]``; heights in metres, NaN = unknown. No foot stands on an unknown cell, and a
foot keeps the same clearance to an unknown cell as to an edge.
"""

import math
from typing import NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.base.short_repr import short_repr
from hdsp.robot.lattice import HEADINGS, cells, heading_angle, metres
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.rounding import ROUNDING, height_tolerance

_CELL = metres(1.0)  # m, side of a cell

#: Increases whenever the same map, robot and task would get another cost. Labels and pretrained models carry it.
COST_MODEL_VERSION = 4


#: Value in ``CostMaps.steep`` for ground that is too steep at each heading.
EVERY_HEADING = np.uint64(2**HEADINGS - 1)


class CostMaps(NamedTuple):
    """Maps of a terrain from which costs are computed, all [nx, ny].

    Attributes:
        height_difference: float32, m; 0 where unknown.
        unevenness: float32, m; S in the module docstring.
        edge: bool; whether no wheel passes the cell: its height difference is too large, or its height is unknown.
        steep: uint64; bit h set if the ground is too steep at heading h.
        standable: bool; whether a foot can stand on the cell and roll over it.
    """

    height_difference: np.ndarray
    unevenness: np.ndarray
    edge: np.ndarray
    steep: np.ndarray
    standable: np.ndarray

    def __repr__(self) -> str:
        return short_repr(self)


def cost_maps(terrain: HeightMap, robot: Robot) -> CostMaps:
    """Computes the cost maps of a terrain for a robot."""
    heights = terrain.heights
    difference = _height_difference(heights)
    between_footholds = _height_difference(contact_heights(heights, robot))
    unevenness = _unevenness(between_footholds, _disc_weights(cells(robot.drive.unevenness_radius)))
    edge = np.isnan(heights) | (difference > np.float32(robot.drive.highest_edge) + height_tolerance(heights))
    steep = _steep(heights, edge, steep_reach(robot), robot.drive.highest_edge, *_direction_limits(robot))
    standable = ~_near(edge, _disc(cells(robot.feet.clearance))) & (steep != EVERY_HEADING)
    return CostMaps(difference, unevenness, edge, steep, standable)


def contact_heights(heights: np.ndarray, robot: Robot) -> np.ndarray:
    """Height at which a foot touches the ground: that of the highest known cell in its contact.

    Args:
        heights: float32 [nx, ny], m, NaN = unknown.
        robot: the robot; its ``feet.contact_half_width`` is half the side of the square contact.

    Returns:
        Float32 [nx, ny], m; unknown cells stay unknown.
    """
    return _highest_nearby(heights, math.floor(cells(robot.feet.contact_half_width) + 1e-9))


def steep_reach(robot: Robot) -> int:
    """Distance (cells) up to which the ground on both sides of a cell counts for its gradient."""
    length = robot.drive.highest_edge / min(robot.slope.steepest())
    return max(math.ceil(cells(length) / 2 - 1e-9), 1)


def slope_directions(robot: Robot) -> np.ndarray:
    """Offsets (dx, dy) in eight directions, at distances of 1 .. ``steep_reach`` cells, int64 [8, reach, 2]."""
    angles, reach = np.arange(8) * math.pi / 8, np.arange(1, steep_reach(robot) + 1)
    unit = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.rint(np.round(reach[:, None] * unit[:, None], 9)).astype(np.int64)


def _direction_limits(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """``slope_directions`` and the largest gradients along them at each heading, float64 [8, reach, 64]."""
    offsets = slope_directions(robot)
    ahead, left = robot.slope.steepest()
    turned = np.arctan2(offsets[..., 1], offsets[..., 0])[..., None] - heading_angle(np.arange(HEADINGS))
    # Largest gradient along a direction over all gradients in the ellipse.
    return offsets, np.hypot(ahead * np.cos(turned), left * np.sin(turned))


def disc_mask(radius: float) -> np.ndarray:
    """Mask for the cells with centres within ``radius`` cells from the middle cell, bool [2 r + 1, 2 r + 1]."""
    reach = math.floor(radius + 1e-9)
    span = np.arange(-reach, reach + 1)
    return np.hypot(span[:, None], span[None, :]) <= radius + 1e-9


def _disc(radius: float) -> np.ndarray:
    """Cells in ``disc_mask`` as offsets (dx, dy), int64 [n, 2]."""
    mask = disc_mask(radius)
    return np.argwhere(mask) - len(mask) // 2


def _disc_weights(radius: float) -> np.ndarray:
    """Rows (dx, dy, weight), float64 [n, 3]. The weight falls from 1 at the centre to 0 at ``radius`` cells."""
    offsets = _disc(radius)
    weight = 1 - np.hypot(offsets[:, 0], offsets[:, 1]) / radius
    return np.column_stack([offsets, weight])[weight > 0]


@njit(nogil=True)
def _highest_nearby(heights, reach):
    nx, ny = heights.shape
    result = heights.copy()
    for x in range(nx):
        for y in range(ny):
            if not np.isnan(heights[x, y]):
                for i in range(max(x - reach, 0), min(x + reach + 1, nx)):
                    for j in range(max(y - reach, 0), min(y + reach + 1, ny)):
                        if heights[i, j] > result[x, y]:  # false for NaN
                            result[x, y] = heights[i, j]
    return result


@njit(nogil=True)
def _height_difference(heights):
    nx, ny = heights.shape
    result = np.zeros((nx, ny), dtype=np.float32)
    for x in range(nx):
        for y in range(ny):
            h = heights[x, y]
            largest = np.float32(0)
            for i in range(max(x - 1, 0), min(x + 2, nx)):
                for j in range(max(y - 1, 0), min(y + 2, ny)):
                    d = abs(heights[i, j] - h)
                    if d > largest:  # false for NaN: unknown neighbours are ignored
                        largest = d
            result[x, y] = largest
    return result


@njit(nogil=True)
def _steep(heights, edge, reach, rolled_over, offsets, limits):
    nx, ny = heights.shape
    steep = np.zeros((nx, ny), dtype=np.uint64)
    for x in range(nx):
        for y in range(ny):
            for d in range(8):
                for n in range(reach):
                    dx, dy = offsets[d, n]
                    a, b, u, v = x + dx, y + dy, x - dx, y - dy
                    if min(a, b, u, v) < 0 or max(a, u) >= nx or max(b, v) >= ny or edge[a, b] or edge[u, v]:
                        break  # beyond an edge lies other ground
                    rise = abs(np.float64(heights[a, b]) - heights[u, v])
                    if rise > rolled_over + height_tolerance(heights[a, b]):
                        length = 2 * _CELL * np.hypot(np.float64(dx), np.float64(dy))
                        gradient = (rise - ROUNDING * abs(heights[a, b])) / length
                        for h in range(HEADINGS):
                            if gradient > limits[d, n, h] * (1 + 1e-5):
                                steep[x, y] |= np.uint64(1) << np.uint64(h)
    return steep


@njit(nogil=True)
def _unevenness(difference, weights):
    # Most cells are even. A loop over the uneven cells that adds to their neighbourhood therefore costs less than a sum
    # over the neighbourhood of every cell.
    nx, ny = difference.shape
    total = np.zeros((nx, ny), dtype=np.float64)
    for x in range(nx):
        for y in range(ny):
            d = np.float64(difference[x, y])
            if d > 0:
                for k in range(len(weights)):
                    i, j = x + int(weights[k, 0]), y + int(weights[k, 1])
                    if 0 <= i < nx and 0 <= j < ny:
                        total[i, j] += d * weights[k, 2]
    return total.astype(np.float32)


@njit(nogil=True)
def _near(mask, offsets):
    nx, ny = mask.shape
    result = np.zeros((nx, ny), dtype=np.bool_)
    for x in range(nx):
        for y in range(ny):
            if mask[x, y]:
                for k in range(len(offsets)):
                    i, j = x + offsets[k, 0], y + offsets[k, 1]
                    if 0 <= i < nx and 0 <= j < ny:
                        result[i, j] = True
    return result
