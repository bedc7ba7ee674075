"""A network that looks where the robot goes: map features sampled under the robot along the way to each goal."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from hdsp.errors import InputError
from hdsp.lattice import ABSTRACT_HEADINGS, CELLS_PER_ABSTRACT, PATCH_CELLS, PATCH_CENTER
from hdsp.learning.encoding import HeightEncoding
from hdsp.learning.networks.base import TaskNetwork
from hdsp.learning.networks.goals import GOAL_FEATURES, goal_features


@dataclass(frozen=True)
class SweptOptions:
    """Widths of the network.

    Attributes:
        widths: channels of the feature maps at 72 x 72, 36 x 36 and 18 x 18 cells.
        points: number (along x, along y) of points in the robot frame at which features are sampled. They start on a
            grid and move with training.
        reach: half the extent (along x, along y) of that grid, in cells.
        samples: positions along the straight way to the goal, start and goal included.
        hidden: width of the layers behind the sampling.
    """

    widths: tuple[int, ...] = (8, 24, 32)
    points: tuple[int, int] = (4, 3)
    reach: tuple[float, float] = (14.0, 11.0)
    samples: int = 5
    hidden: int = 96

    def __post_init__(self):
        if len(self.widths) != 3:
            raise InputError(f"model.options.widths: {list(self.widths)} has to have 3 entries")
        if self.samples < 2 or min(self.points) < 1:
            raise InputError(f"model.options: samples {self.samples} below 2 or points {list(self.points)} below 1")


class Swept(TaskNetwork):
    """Three feature maps, sampled at learned points that are carried along the straight way to the goal.

    What stands under a foot on its way matters in the same manner for every goal and every part of the way. A network
    on the flattened map has to learn that once for each goal and position; here the weights are shared among them.
    """

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
        # Costs are those of flat ground times what the terrain adds, so they are learned as a product.
        self.goal_cost = nn.Sequential(nn.Linear(GOAL_FEATURES, 64), nn.ReLU(), nn.Linear(64, 1))

    def map_part(self, encoded: Tensor) -> Tensor:
        fine = self.fine(encoded)
        middle = self.middle(fine)
        return torch.cat([level.flatten(1) for level in (fine, middle, self.coarse(middle))], dim=1)

    def goal_part(self, features: Tensor, goals: Tensor) -> tuple[Tensor, Tensor]:
        maps, tasks = goals.shape[:2]
        grid = self.positions(goals).flatten(1, 2) / (PATCH_CELLS / 2)
        sampled = []
        parts = features.split([width * cells * cells for width, cells in self.shapes], dim=1)
        for part, (width, cells) in zip(parts, self.shapes, strict=True):
            level = part.view(maps, width, cells, cells)
            sampled.append(functional.grid_sample(level, grid, padding_mode="border", align_corners=False))
        under = torch.cat(sampled, dim=1)  # [B, channels, G * samples, points]
        under = under.view(maps, under.shape[1], tasks, self.samples, -1).permute(0, 2, 3, 1, 4).flatten(3)
        way = torch.relu(self.under_robot(under))
        hidden = torch.cat([way.mean(2), way.amax(2), goal_features(goals)], dim=-1)
        excess, logits = self.heads(self.rest(hidden)).unbind(-1)
        return self.goal_cost(goal_features(goals)).squeeze(-1) * (1 + excess), logits

    def positions(self, goals: Tensor) -> Tensor:
        """Where the points are on the way to each goal: [B, G, 3] to [B, G, samples, points, 2].

        Convention: in cells from the centre of the patch as ``grid_sample`` counts, last axis (y, x). The base is half
        a cell beyond the centre, because it stands at the centre of cell 36 of 72.
        """
        share = torch.linspace(0, 1, self.samples, device=goals.device)[:, None]
        angle = goals[..., None, None, 2] * share * (2 * math.pi / ABSTRACT_HEADINGS)
        shift = goals[..., None, :2] * share * CELLS_PER_ABSTRACT + (PATCH_CENTER + 0.5 - PATCH_CELLS / 2)
        x, y = self.points.unbind(-1)
        cos, sin = angle.cos(), angle.sin()
        return torch.stack([sin * x + cos * y + shift[..., 1:], cos * x - sin * y + shift[..., :1]], dim=-1)


def _convolution(before: int, after: int, kernel: int) -> nn.Module:
    return nn.Sequential(
        nn.Conv2d(before, after, kernel, padding=kernel // 2, bias=False), nn.BatchNorm2d(after), nn.ReLU()
    )


def _halving(before: int, after: int) -> nn.Module:
    # Four wide and not three, so that each cell of the result is centred on the four cells it stands for.
    convolution = nn.Conv2d(before, after, 4, stride=2, padding=1, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(after), nn.ReLU())
