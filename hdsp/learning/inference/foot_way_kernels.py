"""Kernels for the feet on the way to a goal, see ``hdsp.learning.networks.foot_ways.FootWays``.

Convention: as in ``gather_kernels``; positions are in cells from a base, offsets of a foot in cells along x.
"""

from typing import NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.learning.footprint_geometry import (
    COUNTED_HEIGHT,
    COUNTED_LENGTH,
    DRIVE_SAMPLES,
    FOOT_PLACE,
    FOOT_WAY,
    MANOEUVRE,
    MANOEUVRE_FEATURES,
    MOST_ROUGH,
    OFFSET_UNIT,
    ROUGH_TOLERANCE,
    SHARE_TOLERANCE,
    STEP_COST_UNIT,
    UNKNOWN_ROUGH,
    WAY_FEATURES,
)
from hdsp.learning.inference.gather_kernels import relative_height

_FEET = 4
_INFINITE, _ONE, _ZERO = np.float32(np.inf), np.float32(1), np.float32(0)
_FREE = np.float32(1 + SHARE_TOLERANCE)
_ROUGH, _MOST_ROUGH, _UNKNOWN = np.float32(ROUGH_TOLERANCE), np.float32(MOST_ROUGH), np.float32(UNKNOWN_ROUGH)
_OFFSET_UNIT, _COST_UNIT = np.float32(OFFSET_UNIT), np.float32(STEP_COST_UNIT)
_COUNTED = np.float32(COUNTED_HEIGHT)


class FootPlaces(NamedTuple):
    """Where feet look for footholds, and their limits.

    Attributes:
        cells: int64 [3, 4, 2, distances, 2], ``hdsp.learning.footprint_geometry.foot_cells``.
        region: int64 [3], largest distance of a foothold from the base along x and along y, and of one whose unevenness
            counts along x.
        longest: int64, longest step in cells.
        limits: float32 [5], of a step: height and clearance, with their tolerance, cost, cost per cell, cost per metre
            of height.
    """

    cells: np.ndarray
    region: np.ndarray
    longest: int
    limits: np.ndarray


@njit(allocates=False, nogil=True)
def foot_way_rows(cells, across, maps, places, goals, rows):
    """Features of the feet on the ways to some goals.

    Args:
        cells: int64 [n], under the bases.
        across: cells along y in the window.
        maps: ``GroundMaps``.
        places: ``FootPlaces``.
        goals: int64 [goals, 4], cell of the goal from the base (x, y), row of ``places.cells``, and whether it lies
            ahead.
        rows: float32 [n * goals, ``FootprintOptions.way_features``], result.
    """
    at_goal, ways = _FEET * FOOT_PLACE, 2 * _FEET * FOOT_PLACE
    for n in range(len(cells)):
        base = cells[n]
        for goal in range(len(goals)):
            first, row = rows[n * len(goals)], rows[n * len(goals) + goal]
            x, y, heading, ahead = goals[goal]
            if goal == 0:
                for foot in range(_FEET):
                    _stand(maps, base, across, places, 0, 0, 0, foot, first[foot * FOOT_PLACE :])
            for k in range(at_goal):
                row[k] = first[k]
            for foot in range(_FEET):
                place, way = row[at_goal + foot * FOOT_PLACE :], row[ways + foot * FOOT_WAY :]
                _stand(maps, base, across, places, heading, x, y, foot, place)
                for k in range(FOOT_WAY):
                    way[k] = _ZERO
                started = first[foot * FOOT_PLACE + 2] > _ZERO
                if ahead and started and place[2] > _ZERO:
                    neutral = places.cells[0, foot, 0, 0, 0]
                    begin = neutral + _offset(first[foot * FOOT_PLACE])
                    end = min(neutral + x + _offset(place[0]), places.region[0])
                    line = base + places.cells[0, foot, 0, 0, 1]
                    _walk(maps, line, across, places, begin, end, way)
            row[ways + _FEET * FOOT_WAY] = np.float32(ahead)
        if rows.shape[1] > WAY_FEATURES:
            _manoeuvres(maps, base, across, places, goals, rows[n * len(goals) : (n + 1) * len(goals)])


@njit(inline="always")
def _offset(feature):
    return np.int64(np.rint(feature * _OFFSET_UNIT))


@njit(allocates=False, nogil=True)
def _stand(maps, base, across, places, heading, x, y, foot, place):
    """Foothold of a foot: its offset, its height relative to the base, and whether there is one."""
    found = places.cells[heading, foot]
    for distance in range(found.shape[1]):
        rough, at = _INFINITE, np.int64(-1)
        side = 0
        for k in range(2):
            i, j = x + found[k, distance, 0], y + found[k, distance, 1]
            if abs(i) > places.region[0] or abs(j) > places.region[1]:
                continue
            cell = base + i * across + j
            if maps.barred[cell] >= _FREE or maps.contact[cell] == -_INFINITE:
                continue
            # Beyond what the network reads, unevenness is unknown and decides nothing.
            own = _UNKNOWN if abs(i) > places.region[2] else min(maps.rough[cell], _MOST_ROUGH)
            if at < 0 or own < rough - _ROUGH:
                rough, at, side = own, cell, k
        if at >= 0:
            place[0] = np.float32(distance if side == 1 else -distance) / _OFFSET_UNIT
            place[1] = relative_height(maps.contact[at], maps.contact[base])
            place[2] = _ONE
            return
    place[0] = place[1] = place[2] = _ZERO


@njit(allocates=False, nogil=True)
def _walk(maps, line, across, places, begin, end, way):
    """Steps of a foot along its line: whether one is too long or high, their number and cost, whether it leads back."""
    if end < begin:
        way[3] = _ONE
        for x in range(end + 1, begin + 1):
            if maps.barred[line + x * across] >= _FREE:
                way[0] = _ONE
        return
    last, low, top = begin, maps.contact[line + begin * across], -_INFINITE
    for x in range(begin + 1, end + 1):
        cell = line + x * across
        own = maps.contact[cell]
        if maps.barred[cell] >= _FREE:
            top = max(top, own)
            continue
        length, rise = x - last, abs(own - low)
        if length > 1:
            clear = max(top, low) - min(own, low)
            if length > places.longest or rise > places.limits[0] or clear > places.limits[1]:
                way[0] = _ONE
            way[1] += _ONE
            price = places.limits[2] + places.limits[3] * np.float32(min(length, COUNTED_LENGTH))
            way[2] += (price + places.limits[4] * min(rise, _COUNTED)) / _COST_UNIT
        last, low, top = x, own, -_INFINITE


@njit(allocates=False, nogil=True)
def _manoeuvres(maps, base, across, places, goals, rows):
    """Features of the manoeuvres away from a base and on to its goals, and of the drives between them."""
    at_goal, end = _FEET * FOOT_PLACE, WAY_FEATURES + MANOEUVRE
    first = rows[0]
    away = first[WAY_FEATURES : WAY_FEATURES + MANOEUVRE]
    begin = _manoeuvre(maps, base, across, places, 0, 0, first, 1, away)
    for goal in range(len(goals)):
        x, y, heading, _ = goals[goal]
        row = rows[goal]
        for k in range(MANOEUVRE):
            row[WAY_FEATURES + k] = away[k]
        for k in range(MANOEUVRE, MANOEUVRE_FEATURES):
            row[WAY_FEATURES + k] = _ZERO
        if heading != 0:
            continue
        behind = _manoeuvre(maps, base, across, places, x, y, row[at_goal:], -1, row[end : end + MANOEUVRE])
        if begin < 0 or behind < 0:
            continue
        far, barred = x - behind - begin, 0
        for k in range(DRIVE_SAMPLES):
            share = k / (DRIVE_SAMPLES - 1)
            i, j = begin + np.int64(np.rint(far * share)), np.int64(np.rint(y * share))
            if not _stands_neutral(maps, base, across, places, i, j):
                barred += 1
        drive = row[end + MANOEUVRE :]
        drive[0] = np.float32(barred) / np.float32(DRIVE_SAMPLES)
        drive[1], drive[2] = np.float32(far) / _OFFSET_UNIT, np.float32(y) / _OFFSET_UNIT


@njit(allocates=False, nogil=True)
def _manoeuvre(maps, base, across, places, x, y, feet, sign, result):
    """Writes the shortest manoeuvre between feet at a base and neutral ones, ahead (sign 1) or behind (-1).

    Returns the distance to the base on neutral feet; -1 = there is none.
    """
    least = 0
    for foot in range(_FEET):
        if feet[foot * FOOT_PLACE + 2] == _ZERO:
            least = places.cells.shape[3]
        elif sign < 0:
            least = max(least, -_offset(feet[foot * FOOT_PLACE]))
    for shift in range(least, places.cells.shape[3]):
        other = x + sign * shift
        if not _stands_neutral(maps, base, across, places, other, y):
            continue
        for k in range(MANOEUVRE):
            result[k] = _ZERO
        for foot in range(_FEET):
            neutral = places.cells[0, foot, 0, 0, 0]
            line = base + places.cells[0, foot, 0, 0, 1] + y
            own = neutral + x + _offset(feet[foot * FOOT_PLACE])
            if sign > 0:
                _walk(maps, line, across, places, own, neutral + other, result)
            else:
                _walk(maps, line, across, places, neutral + other, own, result)
        if result[0] == _ZERO:
            result[0], result[MANOEUVRE - 1] = _ONE, np.float32(shift) / _OFFSET_UNIT
            return shift
    for k in range(MANOEUVRE):
        result[k] = _ZERO
    return -1


@njit(allocates=False, nogil=True)
def _stands_neutral(maps, base, across, places, x, y):
    """Whether all neutral feet have footholds at a base, as far as footholds are seen."""
    for foot in range(_FEET):
        i, j = x + places.cells[0, foot, 0, 0, 0], y + places.cells[0, foot, 0, 0, 1]
        if abs(i) > places.region[0] or abs(j) > places.region[1]:
            return False
        cell = base + i * across + j
        if maps.barred[cell] >= _FREE or maps.contact[cell] == -_INFINITE:
            return False
    return True
