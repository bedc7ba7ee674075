"""The network of the paper, as the authors published it."""

from dataclasses import dataclass

from torch import Tensor, nn

from hdsp.learning.encoding import HeightEncoding
from hdsp.learning.networks.base import MapGoalLinear, TaskNetwork
from hdsp.learning.networks.dense import DenseTrunk


@dataclass(frozen=True)
class Klamt2019Options:
    """The published architecture has nothing to choose, but a twin of it can be evaluated densely.

    Attributes:
        padded: zero padding in the first two convolutions, as published. Without it the feature map of a patch has
            5 x 5 cells instead of 7 x 7, and is part of the same map for all patches (``networks.dense``).
    """

    padded: bool = True


class Klamt2019(TaskNetwork):
    """Eight convolutions, two poolings, five fully connected layers, two heads; 1,154,561 parameters as published.

    Source: Klamt & Behnke 2019, figure of the network architecture, and the authors' published layer list. The
    feasibility head gives the logit; its sigmoid is the published output.
    """

    def __init__(self, encoding: HeightEncoding, options: Klamt2019Options):
        super().__init__(encoding)
        first, second, cells = (1, 3, 7) if options.padded else (0, 0, 5)
        self.trunk = nn.Sequential(
            nn.Conv2d(len(encoding.channels), 3, 3, padding=first), nn.ReLU(),
            nn.Conv2d(3, 5, 7, padding=second), nn.ReLU(),
            nn.Conv2d(5, 28, 14), nn.ReLU(),
            nn.Conv2d(28, 31, 4), nn.ReLU(), nn.MaxPool2d(2),
            nn.Conv2d(31, 34, 3), nn.ReLU(), nn.MaxPool2d(2),
            nn.Conv2d(34, 36, 3), nn.ReLU(),
            nn.Conv2d(36, 38, 3), nn.ReLU(),
            nn.Conv2d(38, 40, 3), nn.ReLU(),
            nn.Flatten(),
        )  # fmt: skip
        self.fc1 = MapGoalLinear(40 * cells * cells, 3, 500)
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
