"""What a robot asks of the ground at a pose, each as a share of what it can bear."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from hdsp.base.errors import InputError
from hdsp.robot.lattice import RESOLUTION
from hdsp.terrain.cost_maps import disc_mask

#: Signs of the four feet: (along x, along y).
FEET = ((1, 1), (-1, 1), (-1, -1), (1, -1))
#: How sharply a share is told from 1: with a width of these parts of it.
SHARPNESS = (0.02, 0.2)
#: Shares above this are all alike.
MOST = 3.0
#: Known of a pose: three shares, each with its sharp forms, and what driving there costs.
POSE_FEATURES = 3 * (1 + len(SHARPNESS)) + 1
#: Besides: the height under each foot, and whether an edge is too close to it.
STANCE_FEATURES = POSE_FEATURES + 2 * len(FEET)


@dataclass(frozen=True)
class StanceOptions:
    """What a robot asks of the ground; the values of its ``hdsp.robot.robot.Robot``, all lengths in metres.

    Attributes:
        neutral: where its neutral feet are, along x and along y.
        level: most that the heights of the feet may differ for driving in all directions.
        edge: most height difference between neighbouring cells that a wheel passes.
        clearance: of feet from cells with more than that.
        contact_inward: how far from the foot, toward the body, is the ground whose unevenness it pays for.
        unevenness_cost: what driving costs more per metre of unevenness.
        boxes: those which have to stay free, with ``above``, ``x_min``, ``x_max`` and ``half_width``.
    """

    neutral: tuple[float, float]
    level: float
    edge: float
    clearance: float
    contact_inward: float
    unevenness_cost: float
    boxes: tuple[dict, ...]

    def __post_init__(self):
        for name in ("level", "edge", "clearance"):
            if not getattr(self, name) > 0:
                raise InputError(f"model.options.stance.{name}: {getattr(self, name)} has to be > 0")
        if not min(self.neutral) > 0:
            raise InputError(f"model.options.stance.neutral: {list(self.neutral)} have to be > 0")
        keys = {"above", "x_min", "x_max", "half_width"}
        for box in self.boxes:
            if set(box) != keys or min(box["above"], box["half_width"], box["x_max"] - box["x_min"]) <= 0:
                raise InputError(
                    f"model.options.stance.boxes: {box} needs {', '.join(sorted(keys))}, and all sizes > 0"
                )


class Stance(nn.Module):
    """Features of poses: how near the ground there comes to what a robot can bear.

    The detailed planner asks three things of a pose on neutral feet: that no edge is close to a foot, that nothing
    rises into the body, and, unless it drives straight ahead, that the feet are on one level. Each is a comparison
    with a limit, hard to learn from heights, easy to compute: here they are shares of their limits, and sharp steps at
    them. The price of driving at a pose is the fourth. All else, and where feet leave neutral, is left to the network.

    Args:
        options: the robot's limits.
        radius: of the ground, in cells, whose highest point ``ground`` has.
        rotations: headings of ``turned`` in radians, [turns].
    """

    def __init__(self, options: StanceOptions, radius: int, rotations: Tensor):
        super().__init__()
        self.options = options
        self.radius = math.floor(options.clearance / RESOLUTION + 1e-9)
        signs, neutral = torch.tensor(FEET), torch.tensor(options.neutral)
        feet = signs * neutral / RESOLUTION
        contacts = signs * (neutral - options.contact_inward) / RESOLUTION
        bodies = [_covering(box, radius) for box in options.boxes]
        self.groups = [1, len(feet), len(contacts), *map(len, bodies)]
        points = torch.cat([torch.zeros(1, 2), feet, contacts, *bodies])
        cos, sin = rotations.cos()[:, None], rotations.sin()[:, None]
        x, y = points.unbind(-1)
        turned = torch.stack([cos * x - sin * y, sin * x + cos * y], dim=-1)
        # Not integers: averaging of weights would average and truncate them.
        self.register_buffer("cells", points.round(), persistent=False)
        self.register_buffer("turned_cells", turned.round(), persistent=False)

    def reach(self, travel: int) -> dict[str, int]:
        """Cells from a base at which it looks at encoded channels, where straight poses are ``travel`` cells away."""
        straight, turned = (cells.split(self.groups, dim=-2) for cells in (self.cells, self.turned_cells))
        far = [int(max(a.abs().max() + travel, b.abs().max())) for a, b in zip(straight, turned, strict=True)]
        _, feet, contacts, *bodies = far
        return {"height": max(feet, *bodies), "unevenness": contacts, "edge": feet + self.radius}

    def barred(self, edges: Tensor) -> Tensor:
        """Of the greatest height differences in metres [B, 1, nx, ny], inf where unknown: the greatest within a foot's
        clearance as a share of what wheels pass, [B, 1, nx - 2 radius, ...]."""
        mask = disc_mask(self.options.clearance / RESOLUTION)
        nx, ny = edges.shape[-2] - 2 * self.radius, edges.shape[-1] - 2 * self.radius
        result = None
        for i, j in zip(*mask.nonzero(), strict=True):
            part = edges[..., i : i + nx, j : j + ny]
            result = part if result is None else torch.maximum(result, part)
        return (result / self.options.edge).clamp(0.0, MOST)

    def straight(self, ground: Tensor, first: Sequence[int], size: Sequence[int]) -> Tensor:
        """Features [B, STANCE_FEATURES, *size] of unturned poses at ``size`` bases from cell ``first`` of a map.

        Args:
            ground: [B, 4, nx, ny]: heights (NaN = unknown), the highest around, unevenness (of ``HeightEncoding``), and
                ``barred``.
        """
        (x, y), (nx, ny) = first, size

        def at(channel: int, cells: Tensor) -> Tensor:
            corners = [(x + i, y + j) for i, j in cells.long().tolist()]
            return torch.stack([ground[:, channel, i : i + nx, j : j + ny] for i, j in corners], dim=1)

        return torch.cat(self._features(at, self.cells, 1), dim=1)

    def turned(self, ground: Tensor, centres: Tensor) -> Tensor:
        """The same of bases at cells ``centres`` [n, 2], turned on the spot: [B, n, turns, STANCE_FEATURES]."""

        def at(channel: int, cells: Tensor) -> Tensor:
            x, y = (centres[:, None, None] + cells.long()).unbind(-1)
            return ground[:, channel, x, y]

        return torch.cat(self._features(at, self.turned_cells, -1), dim=-1)

    def _features(self, at, cells: Tensor, dim: int) -> list[Tensor]:
        base, feet, contacts, *bodies = cells.split(self.groups, dim=-2)
        base, feet, barred = at(0, base), at(0, feet), at(3, feet)
        contacts = at(2, contacts).expm1()
        highest = feet.nan_to_num(nan=-math.inf).amax(dim, keepdim=True)
        lowest = feet.nan_to_num(nan=math.inf).amin(dim, keepdim=True)
        spread = (highest - lowest).clamp_min(0.0) / self.options.level
        under = torch.fmin(base, feet.mean(dim, keepdim=True))
        body = torch.zeros_like(spread)
        for box, points in zip(self.options.boxes, bodies, strict=True):
            rise = (at(1, points).amax(dim, keepdim=True) - under).nan_to_num(nan=0.0, neginf=0.0) / box["above"]
            body = torch.maximum(body, rise)
        price = self.options.unevenness_cost * (contacts.amax(dim, keepdim=True) + contacts.sum(dim, keepdim=True))
        above = (feet - base).nan_to_num(nan=0.0).clamp(-0.5, 0.8)
        shares = (_told(share) for share in (spread, barred.amax(dim, keepdim=True), body))
        return [above, told(barred), *(part for share in shares for part in share), price.clamp_max(MOST)]


def told(share: Tensor, width: float = SHARPNESS[0]) -> Tensor:
    """Whether a share is above 1: 0 to 1, one half at 1."""
    return torch.sigmoid((share - 1) / width)


def _told(share: Tensor) -> list[Tensor]:
    return [share.clamp_max(MOST), *(told(share, width) for width in SHARPNESS)]


def _covering(box: Mapping[str, float], radius: int) -> Tensor:
    """Points [n, 2] in cells such that squares of a radius about them cover a box and little else."""
    spans = ((box["x_min"], box["x_max"]), (-box["half_width"], box["half_width"]))
    axes = []
    for low, high in spans:
        low, high = math.ceil(low / RESOLUTION), math.floor(high / RESOLUTION)  # cells with their centre inside
        low, high = min(low + radius, (low + high) // 2), max(high - radius, (low + high) // 2)
        axes.append(torch.linspace(low, high, math.ceil((high - low) / (2 * radius + 1)) + 1))
    return torch.cartesian_prod(*axes)
