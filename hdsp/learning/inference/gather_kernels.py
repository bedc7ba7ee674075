"""Kernels that find the cells of a window that the network needs, and gather the inputs of its layers.

Convention: a window's cells are numbered x * ny + y, and maps are [cells, channels] or [cells]. Offsets are differences
of cell numbers. Rows are the inputs of a layer, one row for each product with its weights.
"""

from typing import NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.learning.footprint_geometry import MOST, POSE_FEATURES, RELATIVE, SHARPNESS
from hdsp.learning.inference.ground_kernels import step

_LOW, _HIGH = np.float32(RELATIVE[0]), np.float32(RELATIVE[1])
_MOST = np.float32(MOST)
_NARROW, _WIDE = np.float32(SHARPNESS[0]), np.float32(SHARPNESS[1])
_ZERO = np.float32(0)
_HALF, _LARGEST = np.float32(0.5), np.float32(255)
_INFINITE = np.float32(np.inf)


@njit(allocates=False, nogil=True)
def mark(marks, cells, offsets):
    """Sets ``marks`` at all offsets around some cells."""
    for cell in cells:
        for offset in offsets:
            marks[cell + offset] = True


@njit(allocates=False, nogil=True)
def spread(marks, offsets, result):
    """Sets ``result`` at all offsets around the marked cells; the marks leave room for the offsets."""
    reach = np.int64(0)
    for offset in offsets:
        reach = max(reach, abs(offset))
    count = len(marks) - 2 * reach
    for offset in offsets:
        source, target = marks[reach : reach + count], result[reach + offset : reach + offset + count]
        for k in range(count):
            target[k] |= source[k]


@njit(allocates=False, nogil=True)
def gather(flat, channels, cells, offsets, run, rows):
    """Copies pieces of ``run`` values, one for each offset, side by side into a row for each cell.

    Args:
        flat: float32 [cells * channels].
        channels: values of a cell.
        cells: int64 [n].
        offsets: int64, where the pieces begin, in cells.
        run: values in a piece; a piece may hold several neighbouring cells.
        rows: float32 [n, >= offsets * run], result.
    """
    for n in range(len(cells)):
        at = 0
        for k in range(len(offsets)):
            first = (cells[n] + offsets[k]) * channels
            piece, target = flat[first : first + run], rows[n, at : at + run]
            for c in range(run):
                target[c] = piece[c]
            at += run


@njit(allocates=False, nogil=True)
def store(rows, cells, values):
    """Writes rows [n, channels] to their cells in a map [cells, channels]."""
    for n in range(len(cells)):
        target, row = values[cells[n]], rows[n]
        for c in range(len(row)):
            target[c] = row[c]


@njit(allocates=False, nogil=True)
def store_codes(rows, cells, code, values):
    """Writes rows [n, channels] to their cells in a map of codes, uint8; ``code`` is the value of one code."""
    scale = np.float32(1) / code
    for n in range(len(cells)):
        target, row = values[cells[n]], rows[n]
        for c in range(len(row)):
            target[c] = np.uint8(np.int32(min(row[c] * scale + _HALF, _LARGEST)))


@njit(allocates=False, nogil=True)
def gather_words(words, count, cells, offsets, rows):
    """Copies pieces of ``count`` words, one for each offset, side by side into a row for each cell.

    Args:
        words: uint64 [cells * count].
        count: words of a cell.
        cells, offsets: as for ``gather``.
        rows: uint64 [n, offsets * count], result.
    """
    for n in range(len(cells)):
        at = 0
        for k in range(len(offsets)):
            first = (cells[n] + offsets[k]) * count
            if count == 4:  # the usual width; a loop of four takes three times as long
                rows[n, at] = words[first]
                rows[n, at + 1] = words[first + 1]
                rows[n, at + 2] = words[first + 2]
                rows[n, at + 3] = words[first + 3]
            else:
                for c in range(count):
                    rows[n, at + c] = words[first + c]
            at += count


@njit(allocates=False, nogil=True)
def store_poses(judged, ground, cells, poses):
    """Writes the features of poses, the last values of their ground (``POSE_FEATURES``), and zeros, to ``poses``."""
    features = judged.shape[1]
    for n in range(len(cells)):
        target, row = poses[cells[n]], judged[n]
        for c in range(features):
            target[c] = row[c]
        for c in range(POSE_FEATURES):
            target[features + c] = ground[n, ground.shape[1] - POSE_FEATURES + c]
        for c in range(features + POSE_FEATURES, len(target)):
            target[c] = _ZERO


@njit(inline="always")
def relative_height(height, base):
    """Height relative to the base, within ``RELATIVE``; zero where one of them is unknown."""
    difference = height - base
    return min(max(difference, _LOW), _HIGH) if abs(difference) < _INFINITE else _ZERO


@njit(allocates=False, nogil=True)
def relative_ground(ground, height, base, offsets, row):
    """Highest and lowest ground relative to the base, and further channels, at each offset of a footprint.

    Args:
        ground: float32 [cells, channels], highest, lowest, and others.
        height: float32 [cells].
        base: cell under the base.
        offsets: int64 [taps].
        row: float32 [taps * channels], result.
    """
    channels = ground.shape[1]
    own = height[base]
    for k in range(len(offsets)):
        cell = base + offsets[k]
        row[channels * k] = relative_height(ground[cell, 0], own)
        row[channels * k + 1] = relative_height(ground[cell, 1], own)
        for c in range(2, channels):
            row[channels * k + c] = ground[cell, c]


class PoseCells(NamedTuple):
    """Offsets that the features of a pose read, int64 [turns, n]; one turn for poses with the start heading.

    Attributes:
        taps: footprint points.
        feet, contacts: the feet, and the ground whose unevenness costs.
        body: points of all boxes.
        ends: int64 [boxes], end of each box in ``body``.
        limits: float32, level, cost of unevenness, and each box's free height.
    """

    taps: np.ndarray
    feet: np.ndarray
    contacts: np.ndarray
    body: np.ndarray
    ends: np.ndarray
    limits: np.ndarray


class GroundMaps(NamedTuple):
    """Ground of a window, float32.

    Attributes:
        height: [cells], NaN = unknown.
        nearby: [cells, 2 or 3], highest and lowest ground nearby, and the channel ``unevenness``.
        rough: [cells], unevenness in metres.
        barred: [cells], greatest difference within the clearance of a foot, as a share of the highest edge.
        is_barred: [cells], its sigmoid step.
        contact: [cells], highest ground under a foot, -inf = all of it is unknown; empty if no feature reads it.
    """

    height: np.ndarray
    nearby: np.ndarray
    rough: np.ndarray
    barred: np.ndarray
    is_barred: np.ndarray
    contact: np.ndarray


@njit(allocates=False, nogil=True)
def requirements(maps, base, poses, turn, row):
    """Requirement features at a pose, see ``hdsp.learning.networks.requirements.PoseRequirements``.

    Args:
        maps: ``GroundMaps``.
        base: cell under the base.
        poses: ``PoseCells``.
        turn: index of the turn.
        row: float32 [18], result.
    """
    own = maps.height[base]
    feet, contacts, body = poses.feet[turn], poses.contacts[turn], poses.body[turn]
    count = len(feet)
    highest, lowest, mean, near = -_INFINITE, _INFINITE, _ZERO, _ZERO
    for k in range(count):
        foot = base + feet[k]
        at = maps.height[foot]
        highest = at if at > highest else highest
        lowest = at if at < lowest else lowest
        mean += at
        near = max(near, maps.barred[foot])
        row[k] = relative_height(at, own)
        row[count + k] = maps.is_barred[foot]
    mean /= np.float32(count)
    level = max(highest - lowest, _ZERO) / poses.limits[0]
    under = own
    if not mean >= own:  # also where the ground under the base or under a foot is unknown
        under = own if np.isnan(mean) else mean
    rise, first = _ZERO, 0
    for box in range(len(poses.ends)):
        top = -_INFINITE
        for k in range(first, poses.ends[box]):
            at = maps.nearby[base + body[k], 0]
            top = at if at > top else top
        first = poses.ends[box]
        if top - under > _ZERO:
            rise = max(rise, (top - under) / poses.limits[2 + box])
    greatest, total = -_INFINITE, _ZERO
    for k in range(len(contacts)):
        at = maps.rough[base + contacts[k]]
        greatest = max(greatest, at)
        total += at
    at = 2 * count
    for share in (level, near, rise):
        row[at] = min(share, _MOST)
        row[at + 1] = step(share, _NARROW)
        row[at + 2] = step(share, _WIDE)
        at += 3
    row[at] = min(poses.limits[1] * (greatest + total), _MOST)


@njit(allocates=False, nogil=True)
def ground_rows(cells, maps, poses, rows):
    """Ground and requirement features of the poses of some bases.

    Args:
        cells: int64 [n], under the bases.
        maps: ``GroundMaps``.
        poses: ``PoseCells``.
        rows: float32 [n * turns, ground features + requirement features], result.
    """
    turns = len(poses.taps)
    seen = poses.taps.shape[1] * maps.nearby.shape[1]
    for n in range(len(cells)):
        for turn in range(turns):
            row = rows[n * turns + turn]
            relative_ground(maps.nearby, maps.height, cells[n], poses.taps[turn], row[:seen])
            requirements(maps, cells[n], poses, turn, row[seen:])


@njit(allocates=False, nogil=True)
def interpolate(flat, channels, across, cells, corners, weights, rounds, rows):
    """Features between the cells of a map, side by side, for the poses of turns.

    Args:
        flat: float32 [cells * channels], or codes, uint8, with codes as result.
        channels: values of a cell.
        across: cells along y in the window.
        cells: int64 [n], under the bases.
        corners: int64 [turns, taps], offsets of the lower cell of each footprint point.
        weights: float32 [turns, taps, 4], of that cell, its neighbour along y, along x, along both.
        rounds: float32, 0.5 for codes, else 0.
        rows: [n * turns, taps * channels], of the same kind, result.
    """
    turns, points = corners.shape
    for n in range(len(cells)):
        for turn in range(turns):
            row = rows[n * turns + turn]
            for k in range(points):
                first = (cells[n] + corners[turn, k]) * channels
                near, far = flat[first:], flat[first + across * channels :]
                low, aside = near[:channels], near[channels : 2 * channels]
                ahead, beyond = far[:channels], far[channels : 2 * channels]
                a, b = weights[turn, k, 0], weights[turn, k, 1]
                c, d = weights[turn, k, 2], weights[turn, k, 3]
                target = row[k * channels : (k + 1) * channels]
                for i in range(channels):
                    target[i] = (
                        np.float32(low[i]) * a
                        + np.float32(aside[i]) * b
                        + np.float32(ahead[i]) * c
                        + np.float32(beyond[i]) * d
                        + rounds
                    )


@njit(allocates=False, nogil=True)
def feet_rows(cells, line, maps, along, profile, footholds, rows):
    """Ground ahead of the feet and behind them: line features, relative heights, barred footholds.

    Args:
        cells: int64 [n], under the bases.
        line: float32 [cells, channels].
        maps: ``GroundMaps``.
        along, profile, footholds: int64, offsets, all feet in one.
        rows: float32 [n, line features + heights + footholds], result.
    """
    channels = line.shape[1]
    for n in range(len(cells)):
        base, row = cells[n], rows[n]
        own = maps.height[base]
        for k in range(len(along)):
            seen, target = line[base + along[k]], row[k * channels : (k + 1) * channels]
            for c in range(channels):
                target[c] = seen[c]
        at = len(along) * channels
        for k in range(len(profile)):
            row[at] = relative_height(maps.nearby[base + profile[k], 0], own)
            row[at + 1] = relative_height(maps.nearby[base + profile[k], 1], own)
            at += 2
        for k in range(len(footholds)):
            row[at] = maps.is_barred[base + footholds[k]]
            at += 1


@njit(allocates=False, nogil=True)
def way_rows(cells, poses, turned, corners, weights, turning, rows):
    """Pose features on the way to each goal after the start, and the greatest feature over the whole way.

    Args:
        cells: int64 [n], under the bases.
        poses: float32 [cells, features].
        turned: float32 [n, turns, features].
        corners: int64 [goals, samples, 4], offsets of the cells around each pose.
        weights: float32 [goals, samples, 4], of these cells; a cell with weight zero is not read.
        turning: int64 [goals], first turn of a goal that turns, -1 = none.
        rows: float32 [n * goals, (samples + 1) * features], result.
    """
    goals, samples = corners.shape[:2]
    features = poses.shape[1]
    for n in range(len(cells)):
        start = poses[cells[n]]
        for goal in range(goals):
            row = rows[n * goals + goal]
            greatest = row[samples * features : (samples + 1) * features]
            for c in range(features):
                greatest[c] = start[c]
            for s in range(samples):
                target = row[s * features : (s + 1) * features]
                if turning[goal] >= 0:
                    pose = turned[n, turning[goal] + s]
                    for c in range(features):
                        target[c] = pose[c]
                else:
                    for c in range(features):
                        target[c] = _ZERO
                    for k in range(4):
                        weight = weights[goal, s, k]
                        if weight != _ZERO:
                            pose = poses[cells[n] + corners[goal, s, k]]
                            for c in range(features):
                                target[c] += weight * pose[c]
                for c in range(features):
                    greatest[c] = max(greatest[c], target[c])
