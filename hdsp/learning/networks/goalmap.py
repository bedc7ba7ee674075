"""Network with the goal as a map: goal feet are painted beside the heights, and convolutions see both."""

import math
from typing import Annotated

import torch
from pydantic import Field
from torch import Tensor, nn

from hdsp.base.settings import checked
from hdsp.learning.learning_settings import HeightEncoding, Width
from hdsp.learning.networks.base import TaskNetwork
from hdsp.robot.lattice import ABSTRACT_HEADINGS, CELLS_PER_ABSTRACT, PATCH_CELLS, PATCH_CENTER

#: Side of the feature maps with painted goals, and patch cells per feature cell along one axis.
SIDE, SPAN = PATCH_CELLS // 2, 2


Offset = Annotated[float, Field(ge=0, le=PATCH_CENTER)]


@checked
class GoalMapOptions:
    """Layer widths.

    Attributes:
        widths: channels at 36 x 36, 18 x 18 and 9 x 9 cells. Only the first are computed once per map.
        feet: position (x, y) of the front left foot, in cells from the base; the other feet mirror it.
        hidden: width of the layer after the convolutions.
    """

    widths: tuple[Width, Width, Width] = (16, 32, 48)
    feet: tuple[Offset, Offset] = (13.0, 10.0)
    hidden: Width = 96


class GoalMap(TaskNetwork):
    """Convolutions over map features and two painted channels: front feet and rear feet at the goal.

    Goal and terrain meet in the same cells, so the network has no coordinates to learn. In return, all layers after the
    first stage run once per goal, 22 times per patch.
    """

    feet: Tensor

    Options = GoalMapOptions

    def __init__(self, encoding: HeightEncoding, options: GoalMapOptions):
        super().__init__(encoding)
        first, second, third = options.widths
        self.trunk = nn.Sequential(
            nn.Conv2d(len(encoding.channels), first, 5, stride=2, padding=2), nn.ReLU(),
            nn.Conv2d(first, first, 3, padding=1), nn.ReLU(), nn.Flatten(),
        )  # fmt: skip
        # One convolution over both inputs, split so that its map part runs once per map.
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
        of_map = self.of_map(features.unflatten(1, (-1, SIDE, SIDE)))
        painted = self.paint(goals)
        maps, count = goals.shape[0], goals.shape[1]
        of_goal = self.of_goal(painted.flatten(0, 1))
        of_goal = of_goal.view(maps, count, *of_goal.shape[1:])
        both = (of_map[:, None] + of_goal).flatten(0, 1)
        cost, logits = self.heads(self.rest(both)).view(maps, count, 2).unbind(-1)
        return cost, logits

    def paint(self, goals: Tensor) -> Tensor:
        """Paints the robot's feet at its goals: [B, G, 3] to [B, G, 2, 36, 36], front and rear feet.

        Each foot has weight 1, shared bilinearly among the four cells around it. Feet beyond the patch are not painted.
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
