"""Encoding of a height patch as network input.

The encoding is part of the network and is saved with it, so training and inference treat heights and unknown cells
alike.
"""

import math
from functools import reduce

import torch
from torch import Tensor
from torch.nn import functional

from hdsp.learning.learning_settings import HeightEncoding


def encode(encoding: HeightEncoding, heights: Tensor) -> Tensor:
    """Encodes patches.

    Args:
        encoding: settings.
        heights: float [B, 1, nx, ny], metres, NaN = unknown.

    Returns:
        float [B, len(channels), nx, ny] without NaN.

    Convention: the base stands on cell (nx // 2, ny // 2). If this cell is unknown, the reference is zero.
    """
    if encoding.reference == "base":
        base = heights[..., heights.shape[-2] // 2, heights.shape[-1] // 2].nan_to_num(nan=0.0)
        heights = heights - base[..., None, None]
    unknown, known = heights.isnan(), heights
    heights = heights.nan_to_num(nan=encoding.unknown or 0.0).clamp(*encoding.clip)
    encoded = {"height": heights * encoding.scale, "unknown": unknown.to(heights.dtype)}
    if "edge" in encoding.channels:
        # Unknown cells without a height are edges, independent of the ground around them.
        edge = _bounded(encoding, greatest_difference(heights if encoding.unknown is not None else known))
        encoded["edge"] = torch.where(unknown, 1.0, edge) if encoding.unknown is None else edge
    for channel, axis in (("slope_x", -2), ("slope_y", -1)):
        if channel in encoding.channels:
            encoded[channel] = _bounded(encoding, slope(known, axis)).nan_to_num(nan=0.0)
    if "unevenness" in encoding.channels:
        footholds = greatest_difference(highest_nearby(known, encoding.unevenness_contact))
        encoded["unevenness"] = cone_sum(footholds, encoding.unevenness_radius).log1p()
    if len(encoding.channels) == 1:
        return encoded[encoding.channels[0]]
    return torch.cat([encoded[channel] for channel in encoding.channels], dim=1)


def slope(heights: Tensor, axis: int) -> Tensor:
    """Difference between the next and the previous cell along an axis; same shape [B, 1, nx, ny], zero at the rim."""
    inner = heights.shape[axis] - 2
    difference = heights.narrow(axis, 2, inner) - heights.narrow(axis, 0, inner)
    return functional.pad(difference, (0, 0, 1, 1) if axis == -2 else (1, 1, 0, 0))


def cone_sum(values: Tensor, radius: int) -> Tensor:
    """Sum over cells within a radius, weighted by 1 - distance / radius; same shape [B, 1, nx, ny].

    Cells beyond the rim count as zero.
    """
    weights = _cone(radius, values.device)
    with torch.autocast(values.device.type, enabled=False):  # costs need the digits
        return functional.conv2d(values.float(), weights[None, None], padding=radius - 1)


@torch.compiler.disable  # a compiler would take whole numbers, for which it has no hypot, and other roundings
def _cone(radius: int, device: torch.device) -> Tensor:
    """Weights 1 - distance / radius, [2 radius - 1, 2 radius - 1]."""
    along = torch.arange(1 - radius, radius, dtype=torch.float32, device=device)
    return (1 - torch.hypot(along[:, None], along) / radius).clamp_min(0)


def highest_nearby(heights: Tensor, reach: int) -> Tensor:
    """Highest known cell up to ``reach`` cells away along x and y; same shape [B, 1, nx, ny], NaN cells stay NaN."""
    if not reach:
        return heights
    highest = functional.pad(heights.nan_to_num(nan=-math.inf), (reach,) * 4, value=-math.inf)
    for axis in (-2, -1):
        length = highest.shape[axis] - 2 * reach
        highest = reduce(torch.maximum, [highest.narrow(axis, start, length) for start in range(2 * reach + 1)])
    return torch.where(heights.isnan(), heights, highest)


def greatest_difference(heights: Tensor) -> Tensor:
    """Greatest height difference between each cell and its eight neighbours; same shape [B, 1, nx, ny].

    Cells beyond the rim and NaN cells do not count as neighbours; the result at NaN cells is zero.
    """
    # Max pooling gives the same result, but takes three times as long on the CPU.
    padded = functional.pad(heights, (1, 1, 1, 1), mode="replicate")
    highest, lowest = padded.nan_to_num(nan=-math.inf), padded.nan_to_num(nan=math.inf)
    for axis in (-2, -1):
        length = highest.shape[axis] - 2
        highest = reduce(torch.maximum, [highest.narrow(axis, start, length) for start in range(3)])
        lowest = reduce(torch.minimum, [lowest.narrow(axis, start, length) for start in range(3)])
    return torch.maximum(highest - heights, heights - lowest).nan_to_num(nan=0.0)


def _bounded(encoding: HeightEncoding, difference: Tensor) -> Tensor:
    return difference / (difference.abs() + encoding.edge_scale)
