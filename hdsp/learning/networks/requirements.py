"""Robot requirements on the ground at a pose, as shares of the robot's limits."""

import math
from collections.abc import Callable, Sequence
from functools import reduce

import torch
from torch import Tensor, nn

from hdsp.base.errors import InputError
from hdsp.base.settings import NotNegative, Positive, checked
from hdsp.robot.lattice import cells
from hdsp.robot.robot import Box
from hdsp.terrain.cost_maps import disc_mask

#: Ground channels: height (NaN = unknown), highest and lowest height nearby, unevenness (see ``HeightEncoding``), and
#: ``PoseRequirements.barred``.
HEIGHT, HIGHEST, LOWEST, UNEVENNESS, BARRED = range(5)
#: Signs (x, y) of the feet: front left, rear left, rear right, front right.
FEET = ((1, 1), (-1, 1), (-1, -1), (1, -1))
#: Widths, in shares, of the sigmoids that compare a share with 1.
SHARPNESS = (0.02, 0.2)
#: Shares are clipped at this value.
MOST = 3.0
#: Features per pose: three shares, each with its two sigmoids, and the drive cost.
POSE_FEATURES = 3 * (1 + len(SHARPNESS)) + 1
#: Additional features per foot: the height under it, and whether an edge is too close.
REQUIREMENT_FEATURES = POSE_FEATURES + 2 * len(FEET)


@checked
class PoseRequirementOptions:
    """Robot limits from ``hdsp.robot.robot.Robot``; all lengths in metres.

    Attributes:
        neutral: neutral foot position, along x and along y.
        level: largest height difference among the feet for driving in all directions.
        clearance: distance that feet keep from edges no wheel passes.
        contact_inward: offset, from each foot toward the body, to the ground whose unevenness costs.
        unevenness_cost: drive cost per metre of unevenness.
        boxes: volumes that have to stay free.
        edge: highest edge that a wheel passes; None = from the wheel.
        wheel_radius, rolled_share: as in ``Drive``.
    """

    neutral: tuple[Positive, Positive]
    level: Positive
    clearance: Positive
    contact_inward: NotNegative
    unevenness_cost: NotNegative
    boxes: tuple[Box, ...]
    edge: Positive | None = None
    wheel_radius: Positive | None = None
    rolled_share: Positive | None = None

    @property
    def highest_edge(self) -> float:
        """Highest edge that a wheel passes, m.

        Raises:
            InputError: neither the edge nor the wheel is given.
        """
        if self.edge is not None:
            return self.edge
        if self.wheel_radius is None or self.rolled_share is None:
            raise InputError("model.options.stance.edge is None; need a number, or wheel_radius and rolled_share")
        return self.wheel_radius * self.rolled_share


class PoseRequirements(nn.Module):
    """Computes pose features: ground measures as shares of the robot's limits.

    The detailed planner checks three conditions at a pose on neutral feet: no edge is close to a foot, nothing rises
    into the body, and, unless the robot drives straight ahead, the feet are level. Each condition compares a measure
    with a limit, which is hard to learn from heights and easy to compute. The features are shares of these limits and
    steep sigmoids around them; the drive cost at the pose is the fourth measure. The network learns everything else,
    including feet away from neutral.

    Args:
        options: robot limits.
        radius: window radius, in cells, for the highest ground in ``ground``.
        rotations: headings for ``turned``, radians, [turns].
    """

    cells: Tensor
    turned_cells: Tensor

    def __init__(self, options: PoseRequirementOptions, radius: int, rotations: Tensor):
        super().__init__()
        self.options, self.edge = options, options.highest_edge
        self.radius = math.floor(cells(options.clearance) + 1e-9)
        signs, neutral = torch.tensor(FEET), torch.tensor(options.neutral)
        feet = cells(signs * neutral)
        contacts = cells(signs * (neutral - options.contact_inward))
        bodies = [_covering(box, radius) for box in options.boxes]
        self.groups = [1, len(feet), len(contacts), *map(len, bodies)]
        points = torch.cat([torch.zeros(1, 2), feet, contacts, *bodies])
        cos, sin = rotations.cos()[:, None], rotations.sin()[:, None]
        x, y = points.unbind(-1)
        turned = torch.stack([cos * x - sin * y, sin * x + cos * y], dim=-1)
        # Floats, because weight averaging would average integers and truncate them.
        self.register_buffer("cells", points.round(), persistent=False)
        self.register_buffer("turned_cells", turned.round(), persistent=False)

    def reach(self, travel: int) -> dict[str, int]:
        """Returns, for each encoded channel, the distance in cells from a base within which it is read.

        Args:
            travel: distance in cells from the base to the farthest pose with the start heading.
        """
        straight, turned = (points.split(self.groups, dim=-2) for points in (self.cells, self.turned_cells))
        far = [int(max(a.abs().max() + travel, b.abs().max())) for a, b in zip(straight, turned, strict=True)]
        _, feet, contacts, *bodies = far
        return {"height": max(feet, *bodies), "unevenness": contacts, "edge": feet + self.radius}

    def barred(self, edges: Tensor) -> Tensor:
        """Returns the greatest height difference within foot clearance, as a share of the wheels' limit.

        Args:
            edges: [B, 1, nx, ny], greatest height difference at each cell in metres, inf = unknown.

        Returns:
            [B, 1, nx - 2 radius, ny - 2 radius].
        """
        mask = disc_mask(cells(self.options.clearance))
        nx, ny = edges.shape[-2] - 2 * self.radius, edges.shape[-1] - 2 * self.radius
        parts = (edges[..., i : i + nx, j : j + ny] for i, j in zip(*mask.nonzero(), strict=True))
        return (reduce(torch.maximum, parts) / self.edge).clamp(0.0, MOST)

    def straight(self, ground: Tensor, first: Sequence[int], size: Sequence[int]) -> Tensor:
        """Returns features [B, REQUIREMENT_FEATURES, *size] for poses with the start heading.

        Args:
            ground: [B, 5, nx, ny], height ... barred (``HEIGHT`` to ``BARRED``).
            first: map cell (x, y) under the first base.
            size: number of bases along x and y.
        """
        (x, y), (nx, ny) = first, size

        def at(channel: int, points: Tensor) -> Tensor:
            corners = [(x + i, y + j) for i, j in points.long().tolist()]
            return torch.stack([ground[:, channel, i : i + nx, j : j + ny] for i, j in corners], dim=1)

        return torch.cat(self._features(at, self.cells, 1), dim=1)

    def turned(self, ground: Tensor, centres: Tensor) -> Tensor:
        """Features [B, n, turns, REQUIREMENT_FEATURES] for bases rotated in place at cells ``centres`` [n, 2]."""

        def at(channel: int, points: Tensor) -> Tensor:
            x, y = (centres[:, None, None] + points.long()).unbind(-1)
            return ground[:, channel, x, y]

        return torch.cat(self._features(at, self.turned_cells, -1), dim=-1)

    def _features(self, at: Callable[[int, Tensor], Tensor], points: Tensor, dim: int) -> list[Tensor]:
        base, feet, contacts, *bodies = points.split(self.groups, dim=-2)
        base, feet, barred = at(HEIGHT, base), at(HEIGHT, feet), at(BARRED, feet)
        contacts = at(UNEVENNESS, contacts).expm1()
        highest = feet.nan_to_num(nan=-math.inf).amax(dim, keepdim=True)
        lowest = feet.nan_to_num(nan=math.inf).amin(dim, keepdim=True)
        spread = (highest - lowest).clamp_min(0.0) / self.options.level
        under = torch.fmin(base, feet.mean(dim, keepdim=True))
        body = torch.zeros_like(spread)
        for box, covering in zip(self.options.boxes, bodies, strict=True):
            rise = (at(HIGHEST, covering).amax(dim, keepdim=True) - under).nan_to_num(nan=0.0, neginf=0.0)
            body = torch.maximum(body, rise / box.above)
        price = self.options.unevenness_cost * (contacts.amax(dim, keepdim=True) + contacts.sum(dim, keepdim=True))
        above = (feet - base).nan_to_num(nan=0.0).clamp(-0.5, 0.8)
        shares = (_told(share) for share in (spread, barred.amax(dim, keepdim=True), body))
        return [above, told(barred), *(part for share in shares for part in share), price.clamp_max(MOST)]


def told(share: Tensor, width: float = SHARPNESS[0]) -> Tensor:
    """Sigmoid step at share 1: from 0 (below) to 1 (above), one half at 1."""
    return torch.sigmoid((share - 1) / width)


def _told(share: Tensor) -> list[Tensor]:
    return [share.clamp_max(MOST), *(told(share, width) for width in SHARPNESS)]


def _covering(box: Box, radius: int) -> Tensor:
    """Points [n, 2] in cells whose squares with this radius cover a box and little else."""
    spans = ((box.x_min, box.x_max), (-box.half_width, box.half_width))
    axes = []
    for low, high in spans:
        low, high = math.ceil(cells(low)), math.floor(cells(high))  # cells with their centre inside
        low, high = min(low + radius, (low + high) // 2), max(high - radius, (low + high) // 2)
        axes.append(torch.linspace(low, high, math.ceil((high - low) / (2 * radius + 1)) + 1))
    return torch.cartesian_prod(*axes)
