"""How a patch of heights becomes the input of a network.

The encoding is part of the network and is saved with it, so inference cannot treat heights or unknown cells differently
from training.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import reduce
from typing import Any, Literal

import torch
from torch import Tensor
from torch.nn import functional

from hdsp.errors import InputError
from hdsp.learning.settings import settings_from

CHANNELS = ("height", "edge")


@dataclass(frozen=True)
class HeightEncoding:
    """Treatment of heights; a pure function of one patch.

    Attributes:
        reference: what heights are relative to. ``base``: the height of the cell the base stands on, so that a robot on
            a platform sees what one on the floor sees. ``none``: the map's own zero (the published treatment); only
            this one lets a network be evaluated densely.
        unknown: height in metres, after the reference was taken off, of unknown (NaN) cells.
        clip: range in metres to which heights are limited. The published data tops out at 1.5 m.
        scale: factor on the clipped heights.
        channels: what the network sees. ``height``: the heights treated as above. ``edge``: e / (e + edge_scale) for
            the greatest height difference e of a cell to its eight neighbours, in [0, 1). The costs of the detailed
            planner are built from that difference, and this spares the network learning it.
        edge_scale: height difference in metres at which ``edge`` is one half.
    """

    reference: Literal["none", "base"] = "none"
    unknown: float = 1.5
    clip: tuple[float, float] = (-1.5, 1.5)
    scale: float = 1.0
    channels: tuple[str, ...] = ("height",)
    edge_scale: float = 0.1

    def __post_init__(self):
        if not self.clip[0] < self.clip[1]:
            raise InputError(f"encoding.clip: lower end {self.clip[0]} is not below upper end {self.clip[1]}")
        if not self.channels or any(channel not in CHANNELS for channel in self.channels):
            raise InputError(f"encoding.channels: {list(self.channels)} has to be a choice of {', '.join(CHANNELS)}")
        if not self.edge_scale > 0:
            raise InputError(f"encoding.edge_scale: {self.edge_scale} is not above 0")

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
        heights = heights.nan_to_num(nan=self.unknown).clamp(*self.clip)
        encoded = {"height": heights * self.scale}
        if "edge" in self.channels:
            edge = greatest_difference(heights)
            encoded["edge"] = edge / (edge + self.edge_scale)
        if len(self.channels) == 1:
            return encoded[self.channels[0]]
        return torch.cat([encoded[channel] for channel in self.channels], dim=1)


def greatest_difference(heights: Tensor) -> Tensor:
    """Greatest height difference of each cell to its eight neighbours, same shape [B, 1, nx, ny]; none beyond the
    rim."""
    # Pooling would say the same in fewer words and take three times as long on the CPU.
    highest = lowest = functional.pad(heights, (1, 1, 1, 1), mode="replicate")
    for axis in (-2, -1):
        length = highest.shape[axis] - 2
        highest = reduce(torch.maximum, [highest.narrow(axis, start, length) for start in range(3)])
        lowest = reduce(torch.minimum, [lowest.narrow(axis, start, length) for start in range(3)])
    return torch.maximum(highest - heights, heights - lowest)
