"""Encoding of a height patch as network input.

The encoding is part of the network and is saved with it, so training and inference treat heights and unknown cells
alike.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import reduce
from typing import Any, Literal

import torch
from torch import Tensor
from torch.nn import functional

from hdsp.base.errors import InputError
from hdsp.learning.network_settings import settings_from

#: Input channels, and the distance in cells at which each reads heights (unevenness: in addition to its radius).
CHANNELS = {"height": 0, "edge": 1, "slope_x": 1, "slope_y": 1, "unknown": 0, "unevenness": 1}


@dataclass(frozen=True)
class HeightEncoding:
    """Height encoding; a pure function of one patch.

    Attributes:
        reference: zero level. ``base``: height of the cell under the base, so that a robot on a platform and a
            robot on the floor see the same. ``none``: the map's own zero (published treatment); a network can be
            evaluated densely only with ``none``.
        unknown: height in metres for unknown (NaN) cells, relative to the reference. None: unknown cells have no
            height; there ``edge`` is 1 and ``height`` is 0, and they add nothing to their neighbours' differences.
        clip: height range in metres. The published data reaches up to 1.5 m.
        scale: factor on the clipped heights.
        channels: network inputs. ``height``: heights treated as above. ``edge``: e / (e + edge_scale) in [0, 1), where
            e is the greatest height difference between a cell and its eight neighbours; detailed costs are built from
            e, so the network need not learn it. ``slope_x``, ``slope_y``: d / (|d| + edge_scale) in (-1, 1), where d is
            the height difference between the two neighbours along an axis. ``unevenness``: log(1 + S), where S sums the
            greatest height differences over all cells within ``unevenness_radius``, weighted by 1 - distance / radius;
            foot costs consist of this sum. ``unknown``: 1 where the height is unknown.
        edge_scale: height difference in metres at which ``edge`` is one half.
        unevenness_radius: in cells.
    """

    reference: Literal["none", "base"] = "none"
    unknown: float | None = 1.5
    clip: tuple[float, float] = (-1.5, 1.5)
    scale: float = 1.0
    channels: tuple[str, ...] = ("height",)
    edge_scale: float = 0.1
    unevenness_radius: int = 12

    def __post_init__(self):
        if not self.clip[0] < self.clip[1]:
            raise InputError(f"encoding.clip: lower end {self.clip[0]} is not below upper end {self.clip[1]}")
        if not self.channels or any(channel not in CHANNELS for channel in self.channels):
            raise InputError(f"encoding.channels: {list(self.channels)} has to be a choice of {', '.join(CHANNELS)}")
        if not self.edge_scale > 0:
            raise InputError(f"encoding.edge_scale: {self.edge_scale} is not above 0")
        if self.unevenness_radius < 1:
            raise InputError(f"encoding.unevenness_radius: {self.unevenness_radius} is below 1")

    @classmethod
    def from_config(cls, config: Mapping[str, Any] | None) -> "HeightEncoding":
        """Builds an encoding from the ``encoding`` part of a model configuration.

        Raises:
            InputError: a key is unknown or a value is wrong.
        """
        return settings_from(cls, config, "model.encoding")

    def to_dict(self) -> dict[str, Any]:
        """Returns a plain mapping for ``from_config``."""
        return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()}

    def is_local(self) -> bool:
        """Returns whether each encoded cell depends on its own height alone, independent of the patch around it."""
        return self.reference == "none" and self.channels == ("height",)

    def radius(self, channel: str) -> int:
        """Returns the distance in cells, along x or y, within which an encoded cell reads heights."""
        return CHANNELS[channel] + (self.unevenness_radius - 1 if channel == "unevenness" else 0)

    def __call__(self, heights: Tensor) -> Tensor:
        """Encodes patches.

        Args:
            heights: float [B, 1, nx, ny], metres, NaN = unknown.

        Returns:
            float [B, len(channels), nx, ny] without NaN.

        Convention: the base stands on cell (nx // 2, ny // 2). If this cell is unknown, the reference is zero.
        """
        if self.reference == "base":
            base = heights[..., heights.shape[-2] // 2, heights.shape[-1] // 2].nan_to_num(nan=0.0)
            heights = heights - base[..., None, None]
        unknown, known = heights.isnan(), heights
        heights = heights.nan_to_num(nan=self.unknown or 0.0).clamp(*self.clip)
        encoded = {"height": heights * self.scale, "unknown": unknown.to(heights.dtype)}
        if "edge" in self.channels:
            # Unknown cells without a height are edges, independent of the ground around them.
            edge = greatest_difference(heights if self.unknown is not None else known)
            encoded["edge"] = (
                torch.where(unknown, 1.0, self._bounded(edge)) if self.unknown is None else self._bounded(edge)
            )
        for channel, axis in (("slope_x", -2), ("slope_y", -1)):
            if channel in self.channels:
                encoded[channel] = self._bounded(slope(known, axis)).nan_to_num(nan=0.0)
        if "unevenness" in self.channels:
            encoded["unevenness"] = cone_sum(greatest_difference(known), self.unevenness_radius).log1p()
        if len(self.channels) == 1:
            return encoded[self.channels[0]]
        return torch.cat([encoded[channel] for channel in self.channels], dim=1)

    def _bounded(self, difference: Tensor) -> Tensor:
        return difference / (difference.abs() + self.edge_scale)


def slope(heights: Tensor, axis: int) -> Tensor:
    """Difference between the next and the previous cell along an axis; same shape [B, 1, nx, ny], zero at the rim."""
    inner = heights.shape[axis] - 2
    difference = heights.narrow(axis, 2, inner) - heights.narrow(axis, 0, inner)
    return functional.pad(difference, (0, 0, 1, 1) if axis == -2 else (1, 1, 0, 0))


def cone_sum(values: Tensor, radius: int) -> Tensor:
    """Sum over cells within a radius, weighted by 1 - distance / radius; same shape [B, 1, nx, ny].

    Cells beyond the rim count as zero.
    """
    along = torch.arange(1 - radius, radius, dtype=torch.float32, device=values.device)
    weights = (1 - torch.hypot(along[:, None], along) / radius).clamp_min(0)
    with torch.autocast(values.device.type, enabled=False):  # costs need the digits
        return functional.conv2d(values.float(), weights[None, None], padding=radius - 1)


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
