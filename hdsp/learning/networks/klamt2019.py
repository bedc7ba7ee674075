"""The network of the paper, as the authors published it."""

from dataclasses import dataclass

from torch import Tensor, nn

from hdsp.learning.encoding import HeightEncoding
from hdsp.learning.networks.base import MapGoalLinear, TaskNetwork


@dataclass(frozen=True)
class Klamt2019Options:
    """The published architecture has nothing to choose."""


class Klamt2019(TaskNetwork):
    """Eight convolutions, two poolings, five fully connected layers, two heads; 1,154,561 parameters.

    Source: Klamt & Behnke 2019, figure of the network architecture, and the authors' published layer list. The
    feasibility head gives the logit; its sigmoid is the published output.
    """

    def __init__(self, encoding: HeightEncoding, options: Klamt2019Options):
        super().__init__(encoding)
        self.trunk = nn.Sequential(
            nn.Conv2d(len(encoding.channels), 3, 3, padding=1), nn.ReLU(),
            nn.Conv2d(3, 5, 7, padding=3), nn.ReLU(),
            nn.Conv2d(5, 28, 14), nn.ReLU(),
            nn.Conv2d(28, 31, 4), nn.ReLU(), nn.MaxPool2d(2),
            nn.Conv2d(31, 34, 3), nn.ReLU(), nn.MaxPool2d(2),
            nn.Conv2d(34, 36, 3), nn.ReLU(),
            nn.Conv2d(36, 38, 3), nn.ReLU(),
            nn.Conv2d(38, 40, 3), nn.ReLU(),
            nn.Flatten(),
        )  # fmt: skip
        self.fc1 = MapGoalLinear(40 * 7 * 7, 3, 500)
        self.rest = nn.Sequential(
            nn.ReLU(),
            nn.Linear(500, 150), nn.ReLU(),
            nn.Linear(150, 50), nn.ReLU(),
            nn.Linear(50, 20), nn.ReLU(),
        )  # fmt: skip
        self.heads = nn.Linear(20, 2)

    def map_part(self, encoded: Tensor) -> Tensor:
        return self.trunk(encoded)

    def goal_part(self, features: Tensor, goals: Tensor) -> tuple[Tensor, Tensor]:
        cost, logits = self.heads(self.rest(self.fc1(features, goals))).unbind(-1)
        return cost, logits
