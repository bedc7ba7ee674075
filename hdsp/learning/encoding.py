"""How a patch of heights becomes the input of a network.

The encoding is part of the network and is saved with it, so inference cannot treat heights or unknown cells differently
from training.
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

#: What a network can see, and how many cells beyond its own a cell of each depends on; unevenness: besides its radius.
CHANNELS = {"height": 0, "edge": 1, "slope_x": 1, "slope_y": 1, "unknown": 0, "unevenness": 1}


@dataclass(frozen=True)
class HeightEncoding:
    """Treatment of heights; a pure function of one patch.

    Attributes:
        reference: what heights are relative to. ``base``: the height of the cell the base stands on, so that a robot on
            a platform sees what one on the floor sees. ``none``: the map's own zero (the published treatment); only
            this one lets a network be evaluated densely.
        unknown: height in metres, after the reference was taken off, of unknown (NaN) cells. None: they have no height;
            ``edge`` is 1 there, their neighbours differ from known cells only, and ``height`` is 0.
        clip: range in metres to which heights are limited. The published data tops out at 1.5 m.
        scale: factor on the clipped heights.
        channels: what the network sees. ``height``: the heights treated as above. ``edge``: e / (e + edge_scale) for
            the greatest height difference e of a cell to its eight neighbours, in [0, 1). The costs of the detailed
            planner are built from that difference, and this spares the network learning it. ``slope_x``, ``slope_y``:
            the difference d between the two neighbours along an axis, as d / (|d| + edge_scale), in (-1, 1).
            ``unevenness``: log(1 + S) of the sum S over all cells within ``unevenness_radius`` of their greatest
            height differences, weighted by 1 - distance / radius: what the costs of feet consist of.
            ``unknown``: 1 where the height is unknown.
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
        """From the ``encoding`` part of a model configuration.

        Raises:
            InputError: on unknown keys or wrong values.
        """
        return settings_from(cls, config, "model.encoding")

    def to_dict(self) -> dict[str, Any]:
        """Plain mapping that ``from_config`` reads back."""
        return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()}

    def is_local(self) -> bool:
        """Whether each encoded cell depends on that cell alone, and not on the patch it is seen in."""
        return self.reference == "none" and self.channels == ("height",)

    def radius(self, channel: str) -> int:
        """How many cells away, along x or y, what a cell of the encoded map depends on may lie."""
        return CHANNELS[channel] + (self.unevenness_radius - 1 if channel == "unevenness" else 0)

    def __call__(self, heights: Tensor) -> Tensor:
        """Encodes patches.

        Args:
            heights: float [B, 1, nx, ny], metres, NaN = unknown.

        Returns:
            float [B, len(channels), nx, ny] without NaN.

        Convention: the base stands on cell (nx // 2, ny // 2). Where that cell is unknown, zero is the reference.
        """
        if self.reference == "base":
            base = heights[..., heights.shape[-2] // 2, heights.shape[-1] // 2].nan_to_num(nan=0.0)
            heights = heights - base[..., None, None]
        unknown, known = heights.isnan(), heights
        heights = heights.nan_to_num(nan=self.unknown or 0.0).clamp(*self.clip)
        encoded = {"height": heights * self.scale, "unknown": unknown.to(heights.dtype)}
        if "edge" in self.channels:
            # Without a height, unknown cells are edges by themselves, whatever the height of the ground around them.
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
    """Height of the next cell along an axis less that of the one before, same shape [B, 1, nx, ny]; zero at the rim."""
    inner = heights.shape[axis] - 2
    difference = heights.narrow(axis, 2, inner) - heights.narrow(axis, 0, inner)
    return functional.pad(difference, (0, 0, 1, 1) if axis == -2 else (1, 1, 0, 0))


def cone_sum(values: Tensor, radius: int) -> Tensor:
    """Sum over the cells within a radius, weighted by 1 - distance / radius; same shape [B, 1, nx, ny], zero beyond the
    rim."""
    along = torch.arange(1 - radius, radius, dtype=torch.float32, device=values.device)
    weights = (1 - torch.hypot(along[:, None], along) / radius).clamp_min(0)
    with torch.autocast(values.device.type, enabled=False):  # costs need the digits
        return functional.conv2d(values.float(), weights[None, None], padding=radius - 1)


def greatest_difference(heights: Tensor) -> Tensor:
    """Greatest height difference of each cell to its eight neighbours, same shape [B, 1, nx, ny]; none beyond the rim,
    none to cells that are NaN, and zero there."""
    # Pooling would say the same in fewer words and take three times as long on the CPU.
    padded = functional.pad(heights, (1, 1, 1, 1), mode="replicate")
    highest, lowest = padded.nan_to_num(nan=-math.inf), padded.nan_to_num(nan=math.inf)
    for axis in (-2, -1):
        length = highest.shape[axis] - 2
        highest = reduce(torch.maximum, [highest.narrow(axis, start, length) for start in range(3)])
        lowest = reduce(torch.minimum, [lowest.narrow(axis, start, length) for start in range(3)])
    return torch.maximum(highest - heights, heights - lowest).nan_to_num(nan=0.0)
