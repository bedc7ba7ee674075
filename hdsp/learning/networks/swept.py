"""Network that samples map features under the robot along the way to each goal."""

import math
from typing import Annotated

import torch
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional

from hdsp.base.settings import NotNegative, checked
from hdsp.learning.learning_settings import HeightEncoding, Width
from hdsp.learning.networks.base import TaskNetwork
from hdsp.learning.networks.goals import GOAL_FEATURES, goal_features
from hdsp.robot.lattice import ABSTRACT_HEADINGS, CELLS_PER_ABSTRACT, PATCH_CELLS, PATCH_CENTER

#: Number of sample points along an axis.
Points = Annotated[int, Field(ge=1, le=20)]


@checked
class SweptOptions:
    """Layer widths and sample points.

    Attributes:
        widths: channels at 72 x 72, 36 x 36 and 18 x 18 cells.
        points: number (along x, along y) of sample points in the robot frame. They start on a grid and move with
            training.
        reach: half the grid's extent (along x, along y), in cells.
        samples: positions along the straight way to the goal, including start and goal.
        hidden: width of the layers after the sampling.
    """

    widths: tuple[Width, Width, Width] = (8, 24, 32)
    points: tuple[Points, Points] = (4, 3)
    reach: tuple[NotNegative, NotNegative] = (14.0, 11.0)
    samples: Annotated[int, Field(ge=2, le=50)] = 5
    hidden: Width = 96


class Swept(TaskNetwork):
    """Three feature maps, sampled at learned points that move along the straight way to the goal.

    The ground under a foot matters in the same manner for every goal and every part of the way. A network on the
    flattened map learns this once for each goal and position; here all share the weights.
    """

    Options = SweptOptions

    def __init__(self, encoding: HeightEncoding, options: SweptOptions):
        super().__init__(encoding)
        fine, middle, coarse = options.widths
        self.shapes = [(width, PATCH_CELLS // step) for width, step in zip(options.widths, (1, 2, 4), strict=True)]
        self.fine = nn.Sequential(_convolution(len(encoding.channels), fine, 5), _convolution(fine, fine, 3))
        self.middle = nn.Sequential(_halving(fine, middle), _convolution(middle, middle, 3))
        self.coarse = nn.Sequential(
            _halving(middle, coarse), _convolution(coarse, coarse, 3), _convolution(coarse, coarse, 3)
        )
        x, y = (torch.linspace(-r, r, n) if n > 1 else torch.zeros(1)
                for r, n in zip(options.reach, options.points, strict=True))  # fmt: skip
        self.points = nn.Parameter(torch.cartesian_prod(x, y))
        self.samples = options.samples
        sampled = len(self.points) * sum(options.widths)
        self.under_robot = nn.Sequential(
            nn.Linear(sampled, options.hidden), nn.ReLU(), nn.Linear(options.hidden, options.hidden)
        )
        self.rest = nn.Sequential(
            nn.Linear(2 * options.hidden + GOAL_FEATURES, options.hidden), nn.ReLU(),
            nn.Linear(options.hidden, options.hidden), nn.ReLU(),
        )  # fmt: skip
        self.heads = nn.Linear(options.hidden, 2)
        # A cost is the cost on flat ground times a terrain factor, so the network learns a product.
        self.goal_cost = nn.Sequential(nn.Linear(GOAL_FEATURES, 64), nn.ReLU(), nn.Linear(64, 1))

    def map_part(self, encoded: Tensor) -> Tensor:
        fine = self.fine(encoded)
        middle = self.middle(fine)
        # Channels innermost: the features at one point are then contiguous.
        levels = [level.permute(0, 2, 3, 1).flatten(1) for level in (fine, middle, self.coarse(middle))]
        return torch.cat(levels, dim=1)

    def goal_part(self, features: Tensor, goals: Tensor) -> tuple[Tensor, Tensor]:
        positions = self.positions(goals)
        under = torch.cat([sample(level, positions) for level in self._levels(features)], dim=-1).flatten(-2)
        way = torch.relu(self.under_robot(under))
        hidden = torch.cat([way.mean(2), way.amax(2), goal_features(goals)], dim=-1)
        excess, logits = self.heads(self.rest(hidden)).unbind(-1)
        return self.goal_cost(goal_features(goals)).squeeze(-1) * (1 + excess), logits

    def _levels(self, features: Tensor) -> list[Tensor]:
        parts = features.split([width * cells * cells for width, cells in self.shapes], dim=1)
        return [part.view(-1, n, n, width) for part, (width, n) in zip(parts, self.shapes, strict=True)]

    def positions(self, goals: Tensor) -> Tensor:
        """Returns the sample points on the way to each goal: [B, G, 3] to [B, G, samples, points, 2].

        Convention: (x, y) in cells from the patch's lower corner; the base starts at the centre of cell (36, 36).
        """
        share = torch.linspace(0, 1, self.samples, device=goals.device)[:, None]
        angle = goals[..., None, None, 2] * share * (2 * math.pi / ABSTRACT_HEADINGS)
        shift = goals[..., None, :2] * share * CELLS_PER_ABSTRACT + (PATCH_CENTER + 0.5)
        x, y = self.points.unbind(-1)
        cos, sin = angle.cos(), angle.sin()
        return torch.stack([cos * x - sin * y + shift[..., :1], sin * x + cos * y + shift[..., 1:]], dim=-1)


def sample(level: Tensor, positions: Tensor) -> Tensor:
    """Samples a feature map [B, n, n, C] bilinearly at positions [B, ..., 2]; returns [B, ..., C].

    The result equals ``grid_sample`` without aligned corners and with border padding. Channels are innermost on both
    sides, which saves copies as large as all samples.

    Convention: positions in patch cells, from the lower corner; each of the n cells spans 72 / n patch cells.
    """
    maps, cells, _, width = level.shape
    at = (positions * (cells / PATCH_CELLS) - 0.5).clamp(0, cells - 1).flatten(1, -2)
    low = at.detach().floor().clamp_max(cells - 2)
    share = at - low
    low = low.long()
    first = low[..., 0] * cells + low[..., 1] + torch.arange(maps, device=level.device)[:, None] * cells * cells
    x, y = share.unbind(-1)
    corners = torch.stack([first, first + 1, first + cells, first + cells + 1], dim=-1)
    weights = torch.stack([(1 - x) * (1 - y), (1 - x) * y, x * (1 - y), x * y], dim=-1)
    # An embedding bag computes this weighted sum of rows without keeping the rows.
    result = functional.embedding_bag(
        corners.view(-1, 4), level.reshape(-1, width), per_sample_weights=weights.view(-1, 4), mode="sum"
    )
    return result.view(*positions.shape[:-1], width)


def _convolution(before: int, after: int, kernel: int) -> nn.Module:
    return nn.Sequential(nn.Conv2d(before, after, kernel, padding=kernel // 2), nn.ReLU())


def _halving(before: int, after: int) -> nn.Module:
    # Kernel side 4 instead of 3: each result cell is then centred on its four input cells.
    return nn.Sequential(nn.Conv2d(before, after, 4, stride=2, padding=1), nn.ReLU())
