"""The goal as a map: its feet are painted beside the heights, and convolutions see both."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from hdsp.learning.encoding import HeightEncoding
from hdsp.learning.networks.base import TaskNetwork
from hdsp.robot.lattice import ABSTRACT_HEADINGS, CELLS_PER_ABSTRACT, PATCH_CELLS, PATCH_CENTER

#: Side of the feature maps that goals are painted on, and cells of a patch that one of theirs spans.
SIDE, SPAN = PATCH_CELLS // 2, 2


@dataclass(frozen=True)
class GoalMapOptions:
    """Widths of the network.

    Attributes:
        widths: channels at 36 x 36, 18 x 18 and 9 x 9 cells. Only the first are computed once per map.
        feet: where the front left foot stands (x, y), in cells from the base; the others mirror it.
        hidden: width of the layer behind the convolutions.
    """

    widths: tuple[int, int, int] = (16, 32, 48)
    feet: tuple[float, float] = (13.0, 10.0)
    hidden: int = 96


class GoalMap(TaskNetwork):
    """Convolutions over features of the map and two channels in which the feet at the goal are painted, front and rear.

    Goals and terrain meet where they are, and nothing has to be learned about coordinates. In return all but the first
    layer is evaluated for each goal, 22 times for a patch.
    """

    def __init__(self, encoding: HeightEncoding, options: GoalMapOptions):
        super().__init__(encoding)
        first, second, third = options.widths
        self.trunk = nn.Sequential(
            nn.Conv2d(len(encoding.channels), first, 5, stride=2, padding=2), nn.ReLU(),
            nn.Conv2d(first, first, 3, padding=1), nn.ReLU(), nn.Flatten(),
        )  # fmt: skip
        # One convolution over both, apart so that the part of the map is computed once.
        self.of_map = nn.Conv2d(first, second, 4, stride=2, padding=1)
        self.of_goal = nn.Conv2d(2, second, 4, stride=2, padding=1, bias=False)
        self.rest = nn.Sequential(
            nn.ReLU(),
            nn.Conv2d(second, third, 4, stride=2, padding=1), nn.ReLU(), nn.Flatten(),
            nn.Linear(third * (SIDE // 4) ** 2, options.hidden), nn.ReLU(),
        )  # fmt: skip
        self.heads = nn.Linear(options.hidden, 2)
        x, y = options.feet
        self.register_buffer("feet", torch.tensor([(x, y), (x, -y), (-x, y), (-x, -y)]), persistent=False)

    def map_part(self, encoded: Tensor) -> Tensor:
        return self.trunk(encoded)

    def goal_part(self, features: Tensor, goals: Tensor) -> tuple[Tensor, Tensor]:
        of_map = self.of_map(features.view(len(features), -1, SIDE, SIDE))
        painted = self.paint(goals)
        of_goal = self.of_goal(painted.flatten(0, 1)).unflatten(0, painted.shape[:2])
        both = (of_map[:, None] + of_goal).flatten(0, 1)
        cost, logits = self.heads(self.rest(both)).view(len(features), -1, 2).unbind(-1)
        return cost, logits

    def paint(self, goals: Tensor) -> Tensor:
        """Front and rear feet of the robot at its goals: [B, G, 3] to [B, G, 2, 36, 36].

        A foot counts one in all, shared among the four cells around it. Feet beyond the patch are not painted.
        """
        angle = goals[..., None, 2] * (2 * math.pi / ABSTRACT_HEADINGS)
        x, y = self.feet.unbind(-1)
        cos, sin = angle.cos(), angle.sin()
        turned = torch.stack([cos * x - sin * y, sin * x + cos * y], dim=-1)
        feet = turned + goals[..., None, :2] * CELLS_PER_ABSTRACT + (PATCH_CENTER + 0.5)
        centers = torch.arange(SIDE, device=goals.device) + 0.5
        share = (1 - (feet[..., None] / SPAN - centers).abs()).clamp_min(0)  # [B, G, 4 feet, x and y, 36]
        along_x, along_y = share.unflatten(-3, (2, 2)).unbind(-2)
        return torch.einsum("bgcfi,bgcfj->bgcij", along_x, along_y)
