"""Kernels that encode the ground of a window as ``hdsp.learning.encoding`` and the footprint network do.

Convention: windows are float32 [nx, ny]; NaN = unknown. Values at the rim, as far as a kernel reads neighbours, are
wrong or zero; callers leave room around the cells that they use.
"""

import numpy as np

from hdsp.base.jit import njit

_NAN = np.float32(np.nan)
_INFINITE = np.float32(np.inf)


@njit(nogil=True)
def extreme(values, radius, sign):
    """Highest (sign 1) or lowest (sign -1) known value within a square around each cell; -sign * inf without any."""
    nx, ny = values.shape
    along = np.full((nx, ny), -_INFINITE, np.float32)
    result = np.full((nx, ny), -_INFINITE, np.float32)
    size = 2 * radius + 1
    for i in range(nx):
        for k in range(size):
            for j in range(ny - size + 1):
                value = sign * values[i, j + k]
                # A comparison with NaN is false.
                along[i, j + radius] = value if value > along[i, j + radius] else along[i, j + radius]
    for i in range(radius, nx - radius):
        for k in range(-radius, radius + 1):
            for j in range(ny):
                value = along[i + k, j]
                result[i, j] = value if value > result[i, j] else result[i, j]
        for j in range(ny):
            result[i, j] = sign * result[i, j]
    return result


@njit(nogil=True)
def greatest_difference(heights):
    """Greatest difference between each cell and its known neighbours; zero at unknown cells."""
    highest, lowest = extreme(heights, 1, np.float32(1)), extreme(heights, 1, np.float32(-1))
    nx, ny = heights.shape
    result = np.zeros((nx, ny), np.float32)
    for i in range(1, nx - 1):
        for j in range(1, ny - 1):
            own = heights[i, j]
            if not np.isnan(own):
                result[i, j] = max(highest[i, j] - own, own - lowest[i, j])
    return result


@njit(nogil=True)
def trunk_channels(heights, differences, scale, kinds):
    """Channels of the first convolution, float32 [nx * ny, kinds].

    Args:
        heights: window.
        differences: ``greatest_difference``.
        scale: difference at which a bounded channel is one half.
        kinds: int64, 0 = unknown, 1 = edge, 2 = slope along x, 3 = slope along y.
    """
    nx, ny = heights.shape
    result = np.zeros((nx * ny, len(kinds)), np.float32)
    for k in range(len(kinds)):
        kind = kinds[k]
        for i in range(1, nx - 1):
            for j in range(1, ny - 1):
                cell = i * ny + j
                unknown = np.isnan(heights[i, j])
                if kind == 0:
                    result[cell, k] = np.float32(unknown)
                elif kind == 1:
                    result[cell, k] = np.float32(1) if unknown else _bounded(differences[i, j], scale)
                else:
                    difference = (
                        heights[i + 1, j] - heights[i - 1, j] if kind == 2 else heights[i, j + 1] - heights[i, j - 1]
                    )
                    if not np.isnan(difference):
                        result[cell, k] = _bounded(difference, scale)
    return result


@njit(inline="always")
def _bounded(difference, scale):
    return difference / (np.abs(difference) + scale)


@njit(nogil=True)
def weighted_sum(values, offsets, weights):
    """Sum over cells at offsets int64 [n, 2] with weights float32 [n]; zero at the rim, as far as offsets reach."""
    nx, ny = values.shape
    result = np.zeros((nx, ny), np.float32)
    reach = np.abs(offsets).max()
    for i in range(reach, nx - reach):
        row = result[i, reach : ny - reach]
        for k in range(len(offsets)):
            weight, first = weights[k], reach + offsets[k, 1]
            others = values[i + offsets[k, 0], first : first + len(row)]
            for j in range(len(row)):
                row[j] += weight * others[j]
    return result


@njit(nogil=True)
def barred_shares(heights, differences, scale, offsets, limit, most):
    """Greatest difference at the offsets int64 [n, 2] around each cell, as a share of a limit, at most ``most``."""
    nx, ny = heights.shape
    edges = np.empty((nx, ny), np.float32)
    one, least = np.float32(1), np.float32(1e-6)
    for i in range(nx):
        for j in range(ny):
            # Through the bounded channel and back, as the network reads it.
            bounded = one if np.isnan(heights[i, j]) else _bounded(differences[i, j], scale)
            edges[i, j] = scale * bounded / max(one - bounded, least)
    result = np.zeros((nx, ny), np.float32)
    reach = np.abs(offsets).max()
    for i in range(reach, nx - reach):
        row = result[i, reach : ny - reach]
        for k in range(len(offsets)):
            first = reach + offsets[k, 1]
            others = edges[i + offsets[k, 0], first : first + len(row)]
            for j in range(len(row)):
                row[j] = max(row[j], others[j])
        for j in range(len(row)):
            row[j] = min(row[j] / limit, most)
    return result


@njit(nogil=True)
def told(shares, width):
    """Sigmoid step at share 1, see ``hdsp.learning.networks.requirements.told``."""
    result = np.empty_like(shares)
    for i in range(shares.shape[0]):
        for j in range(shares.shape[1]):
            result[i, j] = step(shares[i, j], width)
    return result


@njit(inline="always")
def step(share, width):
    """Sigmoid step of one share."""
    return np.float32(1) / (np.float32(1) + np.exp((np.float32(1) - share) / width))
