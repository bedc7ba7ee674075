"""The paper's network, as published by its authors."""

from typing import Self

from pydantic import model_validator
from torch import Tensor, nn

from hdsp.base.settings import Count, checked, fault
from hdsp.learning.learning_settings import HeightEncoding
from hdsp.learning.networks.base import MapGoalLinear, TaskNetwork
from hdsp.learning.networks.dense import DenseTrunk
from hdsp.robot.lattice import PATCH_CELLS


@checked
class Klamt2019Options:
    """Options; the defaults are the published architecture.

    Attributes:
        padded: zero padding in the first two convolutions, as published. Without padding, a patch's feature map has 5 x
            5 cells instead of 7 x 7, and all patches share one dense map (``networks.dense``).
        kernels: kernel sides in cells of the first four convolutions. The published sides correspond to neighbouring
            cells (3), a foot's distance from edges on both sides (7), the step length (14), and 4.
    """

    padded: bool = True
    kernels: tuple[Count, Count, Count, Count] = (3, 7, 14, 4)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.padded and not self.kernels[0] % 2 == self.kernels[1] % 2 == 1:
            raise fault("kernels", self.kernels, "odd numbers for the first two, which are padded")
        if self.cells() < 1:
            raise fault("kernels", self.kernels, f"kernels that leave some of {PATCH_CELLS} cells")
        return self

    def cells(self) -> int:
        """Returns the side of a patch's feature map."""
        seen = self.kernels[2:] if self.padded else self.kernels
        left = PATCH_CELLS - sum(kernel - 1 for kernel in seen)
        return (left // 2 - 2) // 2 - 6


class Klamt2019(TaskNetwork):
    """Eight convolutions, two poolings, five fully connected layers, two heads; 1,154,561 parameters as published.

    Source: Klamt & Behnke 2019, network architecture figure, and the authors' published layer list. The feasibility
    head returns the logit; its sigmoid is the published output.
    """

    Options = Klamt2019Options

    def __init__(self, encoding: HeightEncoding, options: Klamt2019Options):
        super().__init__(encoding)
        first, second, third, fourth = options.kernels
        around = int(options.padded)
        self.trunk = nn.Sequential(
            nn.Conv2d(len(encoding.channels), 3, first, padding=first // 2 * around), nn.ReLU(),
            nn.Conv2d(3, 5, second, padding=second // 2 * around), nn.ReLU(),
            nn.Conv2d(5, 28, third), nn.ReLU(),
            nn.Conv2d(28, 31, fourth), nn.ReLU(), nn.MaxPool2d(2),
            nn.Conv2d(31, 34, 3), nn.ReLU(), nn.MaxPool2d(2),
            nn.Conv2d(34, 36, 3), nn.ReLU(),
            nn.Conv2d(36, 38, 3), nn.ReLU(),
            nn.Conv2d(38, 40, 3), nn.ReLU(),
            nn.Flatten(),
        )  # fmt: skip
        self.fc1 = MapGoalLinear(40 * options.cells() ** 2, 3, 500)
        self.rest = nn.Sequential(
            nn.ReLU(),
            nn.Linear(500, 150), nn.ReLU(),
            nn.Linear(150, 50), nn.ReLU(),
            nn.Linear(50, 20), nn.ReLU(),
        )  # fmt: skip
        self.heads = nn.Linear(20, 2)

    def dense_trunk(self) -> DenseTrunk:
        return DenseTrunk(self.trunk)

    def map_part(self, encoded: Tensor) -> Tensor:
        return self.trunk(encoded)

    def goal_part(self, features: Tensor, goals: Tensor) -> tuple[Tensor, Tensor]:
        cost, logits = self.heads(self.rest(self.fc1(features, goals))).unbind(-1)
        return cost, logits
