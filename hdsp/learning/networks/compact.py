"""Smaller, faster network: strided residual stages, and a goal gate on the map features."""

from typing import Annotated, Self

import torch
from pydantic import Field, model_validator
from torch import Tensor, nn

from hdsp.base.settings import Natural, checked, fault
from hdsp.learning.learning_settings import HeightEncoding, Width
from hdsp.learning.networks.base import TaskNetwork
from hdsp.learning.networks.goals import GOAL_FEATURES, goal_features


@checked
class CompactOptions:
    """Layer widths.

    Attributes:
        widths: channels per stage; each stage halves the resolution, the first works at 36 x 36 cells.
        blocks: residual blocks per stage.
        map_features: channels after the reduction that precedes flattening.
        hidden: layer width behind the goal.
    """

    widths: Annotated[tuple[Width, ...], Field(min_length=1, max_length=5)] = (32, 48, 64)
    blocks: tuple[Annotated[Natural, Field(le=100)], ...] = (1, 1, 1)
    map_features: Width = 24
    hidden: Width = 256

    @model_validator(mode="after")
    def _check(self) -> Self:
        if len(self.widths) != len(self.blocks):
            raise fault("blocks", self.blocks, f"as many entries as widths, {list(self.widths)}")
        return self


class Compact(TaskNetwork):
    """Residual stages with batch normalisation; a goal scales and shifts the hidden map features (FiLM).

    The published network adds map and goal, so a product ("this obstacle matters for that goal") arises only in later
    layers. The gate gives this product directly: one hidden layer after it is enough.
    """

    Options = CompactOptions

    def __init__(self, encoding: HeightEncoding, options: CompactOptions):
        super().__init__(encoding)
        stages: list[nn.Module] = []
        before, cells = len(encoding.channels), 72
        for stage, (width, blocks) in enumerate(zip(options.widths, options.blocks, strict=True)):
            kernel = 5 if stage == 0 else 3
            stages += [
                nn.Conv2d(before, width, kernel, stride=2, padding=kernel // 2, bias=False),
                nn.BatchNorm2d(width),
                nn.ReLU(),
            ]
            stages += [ResidualBlock(width) for _ in range(blocks)]
            before, cells = width, (cells + 1) // 2
        self.trunk = nn.Sequential(*stages, nn.Conv2d(before, options.map_features, 1), nn.Flatten())
        self.of_map = nn.Linear(options.map_features * cells * cells, options.hidden)
        self.of_goal = nn.Sequential(nn.Linear(GOAL_FEATURES, 64), nn.ReLU(), nn.Linear(64, 2 * options.hidden))
        self.rest = nn.Sequential(nn.ReLU(), nn.Linear(options.hidden, 128), nn.ReLU())
        self.heads = nn.Linear(128, 2)

    def map_part(self, encoded: Tensor) -> Tensor:
        return self.of_map(self.trunk(encoded))

    def goal_part(self, features: Tensor, goals: Tensor) -> tuple[Tensor, Tensor]:
        scale, shift = self.of_goal(goal_features(goals)).chunk(2, dim=-1)
        cost, logits = self.heads(self.rest(features[:, None, :] * (1 + scale) + shift)).unbind(-1)
        return cost, logits


class ResidualBlock(nn.Module):
    """Two 3 x 3 convolutions with an identity shortcut."""

    def __init__(self, width: int):
        super().__init__()
        last = nn.BatchNorm2d(width)
        self.inner = nn.Sequential(
            nn.Conv2d(width, width, 3, padding=1, bias=False), nn.BatchNorm2d(width), nn.ReLU(),
            nn.Conv2d(width, width, 3, padding=1, bias=False), last,
        )  # fmt: skip
        # Each block starts as the identity, so depth does not hinder the first epochs.
        nn.init.zeros_(last.weight)

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(x + self.inner(x))
