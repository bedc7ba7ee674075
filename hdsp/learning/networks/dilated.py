"""Network without strides: dilated convolutions, then max pooling over squares."""

from typing import Annotated, Self

from pydantic import Field, model_validator
from torch import Tensor, nn

from hdsp.base.settings import Count, checked, fault
from hdsp.learning.learning_settings import HeightEncoding, Width
from hdsp.learning.networks.base import TaskNetwork
from hdsp.learning.networks.dense import DenseTrunk
from hdsp.learning.networks.goals import GOAL_FEATURES, goal_features
from hdsp.robot.lattice import PATCH_CELLS


@checked
class DilatedOptions:
    """Layer widths and reach.

    Attributes:
        widths: channels per convolution. Use multiples of 16: otherwise oneDNN's bfloat16 gradients for dilated
            convolutions are NaN.
        kernels: kernel sides in cells.
        dilations: cells between neighbouring kernel taps.
        pool: side in cells of the max pooling squares.
        hidden: layer width behind the goal.
    """

    widths: Annotated[tuple[Width, ...], Field(min_length=1, max_length=20)] = (16, 32, 32, 32)
    kernels: tuple[Count, ...] = (5, 3, 3, 3)
    dilations: tuple[Count, ...] = (1, 2, 4, 8)
    pool: Count = 8
    hidden: Width = 128

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name in ("kernels", "dilations"):
            if len(values := getattr(self, name)) != len(self.widths):
                raise fault(name, values, f"as many entries as widths, {list(self.widths)}")
        if self.cells() < 1:
            others = f"with dilations {list(self.dilations)} and pool {self.pool}"
            raise fault("kernels", self.kernels, f"kernels that {others} fit a patch of {PATCH_CELLS} cells")
        return self

    def cells(self) -> int:
        """Returns the side of a patch's feature map."""
        seen = sum(dilation * (kernel - 1) for kernel, dilation in zip(self.kernels, self.dilations, strict=True))
        return (PATCH_CELLS - seen) // self.pool


class Dilated(TaskNetwork):
    """Convolutions with growing dilation, so that few weights see far; a goal gates the pooled features.

    Every layer works at full resolution without padding, so whole maps are evaluated densely where the encoding allows
    it. Max pooling keeps the worst value in each neighbourhood.
    """

    Options = DilatedOptions

    def __init__(self, encoding: HeightEncoding, options: DilatedOptions):
        super().__init__(encoding)
        layers: list[nn.Module] = []
        before = len(encoding.channels)
        for width, kernel, dilation in zip(options.widths, options.kernels, options.dilations, strict=True):
            layers += [nn.Conv2d(before, width, kernel, dilation=dilation), nn.ReLU()]
            before = width
        self.trunk = nn.Sequential(*layers, nn.MaxPool2d(options.pool), nn.Flatten())
        self.of_map = nn.Linear(before * options.cells() ** 2, options.hidden)
        self.of_goal = nn.Sequential(nn.Linear(GOAL_FEATURES, 64), nn.ReLU(), nn.Linear(64, 2 * options.hidden))
        self.rest = nn.Sequential(nn.ReLU(), nn.Linear(options.hidden, 64), nn.ReLU())
        self.heads = nn.Linear(64, 2)

    def dense_trunk(self) -> DenseTrunk:
        return DenseTrunk(self.trunk)

    def map_part(self, encoded: Tensor) -> Tensor:
        return self.trunk(encoded)

    def goal_part(self, features: Tensor, goals: Tensor) -> tuple[Tensor, Tensor]:
        scale, shift = self.of_goal(goal_features(goals)).chunk(2, dim=-1)
        cost, logits = self.heads(self.rest(self.of_map(features)[:, None, :] * (1 + scale) + shift)).unbind(-1)
        return cost, logits
