"""Robot requirements on the ground at a pose, as shares of the robot's limits."""

import math
from collections.abc import Callable, Sequence
from functools import reduce

import numpy as np
import torch
from torch import Tensor, nn

from hdsp.learning.footprint_geometry import (
    MOST,
    RELATIVE,
    SHARPNESS,
    PoseRequirementOptions,
    requirement_points,
    rotated,
    turn_angles,
)
from hdsp.robot.lattice import cells
from hdsp.terrain.cost_maps import disc_mask

#: Ground channels: height (NaN = unknown), highest and lowest height nearby, unevenness (see ``HeightEncoding``), and
#: ``PoseRequirements.barred``.
HEIGHT, HIGHEST, LOWEST, UNEVENNESS, BARRED = range(5)


class PoseRequirements(nn.Module):
    """Computes pose features: ground measures as shares of the robot's limits.

    The detailed planner checks three conditions at a pose on neutral feet: no edge is close to a foot, nothing rises
    into the body, and, unless the robot drives straight ahead, the feet are level. Each condition compares a measure
    with a limit, which is hard to learn from heights and easy to compute. The features are shares of these limits and
    steep sigmoids around them; the drive cost at the pose is the fourth measure. The network learns everything else,
    including feet away from neutral.

    Args:
        options: robot limits.
    """

    cells: Tensor
    turned_cells: Tensor

    def __init__(self, options: PoseRequirementOptions):
        super().__init__()
        self.options, self.edge = options, options.highest_edge
        self.radius = options.clearance_cells
        groups = requirement_points(options)
        self.groups = [len(group) for group in groups]
        points = np.concatenate(groups)
        # Floats, because weight averaging would average integers and truncate them.
        self.register_buffer("cells", torch.from_numpy(points.round()), persistent=False)
        turned = rotated(points, turn_angles()).round()
        self.register_buffer("turned_cells", torch.from_numpy(turned), persistent=False)

    @torch.compiler.disable  # a compiler has no hypot of whole numbers, which the disc needs
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
        above = (feet - base).nan_to_num(nan=0.0).clamp(*RELATIVE)
        shares = (_told(share) for share in (spread, barred.amax(dim, keepdim=True), body))
        return [above, told(barred), *(part for share in shares for part in share), price.clamp_max(MOST)]


def told(share: Tensor, width: float = SHARPNESS[0]) -> Tensor:
    """Sigmoid step at share 1: from 0 (below) to 1 (above), one half at 1."""
    return torch.sigmoid((share - 1) / width)


def _told(share: Tensor) -> list[Tensor]:
    return [share.clamp_max(MOST), *(told(share, width) for width in SHARPNESS)]
