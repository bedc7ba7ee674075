"""Network without strides: dilated convolutions, then max pooling over squares."""

from dataclasses import dataclass

from torch import Tensor, nn

from hdsp.base.errors import InputError
from hdsp.learning.encoding import HeightEncoding
from hdsp.learning.networks.base import TaskNetwork
from hdsp.learning.networks.dense import DenseTrunk
from hdsp.learning.networks.goals import GOAL_FEATURES, goal_features
from hdsp.robot.lattice import PATCH_CELLS


@dataclass(frozen=True)
class DilatedOptions:
    """Layer widths and reach.

    Attributes:
        widths: channels per convolution. Use multiples of 16: otherwise oneDNN's bfloat16 gradients for dilated
            convolutions are NaN.
        kernels: kernel sides in cells.
        dilations: cells between neighbouring kernel taps.
        pool: side in cells of the max pooling squares.
        hidden: width of the layers that see the goal.
    """

    widths: tuple[int, ...] = (16, 32, 32, 32)
    kernels: tuple[int, ...] = (5, 3, 3, 3)
    dilations: tuple[int, ...] = (1, 2, 4, 8)
    pool: int = 8
    hidden: int = 128

    def __post_init__(self):
        if not len(self.widths) == len(self.kernels) == len(self.dilations) > 0:
            raise InputError(
                f"model.options: widths {list(self.widths)}, kernels {list(self.kernels)} and dilations "
                f"{list(self.dilations)} need one entry for each convolution"
            )
        if min(self.kernels + self.dilations) < 1 or self.pool < 1 or self.cells() < 1:
            raise InputError(
                f"model.options: kernels {list(self.kernels)}, dilations {list(self.dilations)} and pool {self.pool} "
                f"leave nothing of a patch of {PATCH_CELLS} cells"
            )

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
