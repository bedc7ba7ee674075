"""Where the feet stand at start and goal, and the steps that each of them needs in between."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from hdsp.learning.footprint_geometry import (
    ASIDE,
    COUNTED_HEIGHT,
    COUNTED_LENGTH,
    FEET,
    HEIGHT_TOLERANCE,
    MOST_ROUGH,
    OFFSET_UNIT,
    RELATIVE,
    ROUGH_TOLERANCE,
    SHARE_TOLERANCE,
    STEP_COST_UNIT,
    UNKNOWN_ROUGH,
    FootprintOptions,
    foot_cells,
)
from hdsp.learning.networks.requirements import BARRED, UNEVENNESS
from hdsp.robot.lattice import CELLS_PER_ABSTRACT

#: Unevenness of cells without a foothold.
BLOCKED = 1e6
#: Cell of a foothold before all others, where there is none: no step from there is short enough.
_NOWHERE = -1000.0


class FootWays(nn.Module):
    """Features of the feet on the way to a goal, from footholds alone.

    At a pose each foot takes the foothold nearest to its neutral position, nearly as in T_a->d
    (``hdsp.abstract.transform``); of two at one distance, the one on more even ground. Ahead, a foot rolls along its
    line and steps over what bars it, to the nearest foothold beyond. Whatever the other feet do, a foot on its line
    needs these steps, and the task is hardly feasible if one of them is longer or higher than a step may be.

    The features are approximations, and the network learns the rest: each foot stands alone, without the least
    separation; footholds outside ``region`` are not seen; heights are those of the ground under a foot, also between
    two footholds; steps lead ahead, and an unknown cell on the way may be stepped over.

    Args:
        options: options of the network, with ``foot_ways`` and ``stance``.
    """

    cells: Tensor

    def __init__(self, options: FootprintOptions):
        super().__init__()
        assert options.foot_ways is not None
        self.options, self.rules = options, options.foot_ways
        self.region = options.foot_region
        cells = foot_cells(options)
        self.shape = cells.shape[1:]
        # Floats, because weight averaging would average integers and truncate them; flat, because layouts in memory are
        # for images.
        self.register_buffer("cells", torch.from_numpy(cells).float().flatten(1), persistent=False)

    def ground(self, ground: Tensor, contact: Tensor) -> Tensor:
        """Returns what feet need to know at each cell, [B, 2, nx, ny]: unevenness, and height under a foot.

        Args:
            ground: [B, 5, nx, ny], height ... barred (``requirements``).
            contact: [B, nx, ny], highest ground under a foot, -inf where all of it is unknown.
        """
        free = (ground[:, BARRED] < 1 + SHARE_TOLERANCE) & contact.isfinite()
        rough = torch.where(free, ground[:, UNEVENNESS].expm1().clamp_max(MOST_ROUGH), BLOCKED)
        return torch.stack([rough, contact], dim=1)

    def around(self, ground: Tensor) -> Tensor:
        """Returns the values for ``forward``, [B, values], from ``ground`` within ``region``, [B, 2, nx, ny].

        Unevenness counts as far as the network reads it.
        """
        rough, height = ground.unbind(1)
        far = self.region[0] - self.options.rough_reach
        last = rough.shape[1] - far
        rough = torch.cat([_unknown(rough[:, :far]), rough[:, far:last], _unknown(rough[:, last:])], dim=1)
        return torch.stack([rough, height], dim=1).flatten(1)

    @torch.no_grad()
    def forward(self, ground: Tensor, goals: Tensor) -> Tensor:
        """Returns features, float [B, G, ``WAY_FEATURES``], without gradients.

        Args:
            ground: [B, values], from ``around``.
            goals: [B, G, 3] in abstract steps in the robot frame.
        """
        x, y = self.region
        rough, height = ground.view(-1, 2, 2 * x + 1, 2 * y + 1).unbind(1)
        at = (goals[..., :2] * CELLS_PER_ABSTRACT).round().long()
        here = torch.zeros_like(at[:, :1])
        start = self._feet(rough, height, here, 0)
        goal = self._feet(rough, height, at, 0)
        for heading, sign in ((1, 1), (2, -1)):
            turned = self._feet(rough, height, here, heading)
            turns = (goals[..., 2:].sign() == sign)[..., None]
            goal = torch.where(turns, turned, goal)
        ahead = (goals[..., 2] == 0) & (goals[..., 0] > 0) & (at[..., 1].abs() <= ASIDE)
        ways = self._ways(rough < BLOCKED, height, start, goal, at) * ahead[..., None, None]
        base = height[:, x, y][:, None, None]
        count = goals.shape[1]
        places = [self._place(feet, base).expand(-1, count, -1, -1) for feet in (start, goal)]
        return torch.cat([*(part.flatten(2) for part in (*places, ways)), ahead[..., None].to(height.dtype)], dim=-1)

    def _feet(self, rough: Tensor, height: Tensor, bases: Tensor, heading: int) -> Tensor:
        """Offsets in cells, heights, and whether there are footholds, [B, G, 4, 3], at bases [B, G, 2]."""
        x, y = self.region
        at = bases[:, :, None, None, None] + self.cells[heading].long().view(self.shape)
        inside = (at[..., 0].abs() <= x) & (at[..., 1].abs() <= y)
        index = (at[..., 0].clamp(-x, x) + x) * (2 * y + 1) + at[..., 1].clamp(-y, y) + y
        found = rough.flatten(1).gather(1, index.flatten(1)).view(index.shape)
        found = torch.where(inside, found, BLOCKED)
        behind, ahead = found.unbind(3)
        free = torch.minimum(behind, ahead) < BLOCKED
        distances = torch.arange(free.shape[-1], device=free.device)
        nearest = torch.where(free, distances, len(distances)).amin(-1, keepdim=True)
        exists = nearest < len(distances)
        nearest = nearest.clamp_max(len(distances) - 1)
        behind, ahead = behind.gather(-1, nearest), ahead.gather(-1, nearest)
        chosen = (ahead < behind - ROUGH_TOLERANCE).long()
        cell = index.gather(-1, nearest[..., None, :].expand(*index.shape[:-1], 1)).gather(-2, chosen[..., None])
        tall = height.flatten(1).gather(1, cell.flatten(1)).view(exists.shape)
        offset = torch.where(exists, nearest * (2 * chosen - 1), 0).to(tall.dtype)
        return torch.cat([offset, tall, exists.to(tall.dtype)], dim=-1)

    def _place(self, feet: Tensor, base: Tensor) -> Tensor:
        offset, height, exists = feet.unbind(-1)
        relative = (height - base).nan_to_num(nan=0.0, posinf=0.0, neginf=0.0).clamp(*RELATIVE)
        return torch.stack([offset / OFFSET_UNIT, relative * exists, exists], dim=-1)

    def _ways(self, free: Tensor, height: Tensor, start: Tensor, goal: Tensor, at: Tensor) -> Tensor:
        """Features of each foot's way along x, [B, G, 4, FOOT_WAY]."""
        x, y = self.region
        foot_x, foot_y = self.options.foot
        sides = [y + foot_y, y - foot_y]
        barred = (~free[:, :, sides]).to(height.dtype)
        sums = torch.stack([*self._steps(free[:, :, sides], height[:, :, sides]), barred], dim=-1).cumsum(1)
        result = []
        for k, (ahead, left) in enumerate(FEET):
            neutral = ahead * foot_x + x
            first = start[..., k, 0].long().expand(-1, at.shape[1]) + neutral
            last = (at[..., 0] + goal[..., k, 0].long() + neutral).clamp(0, 2 * x)
            low, high = torch.minimum(first, last), torch.maximum(first, last)
            side = sums[:, :, 0 if left > 0 else 1]
            between = _at(side, high) - _at(side, low)
            back = last < first
            too_far, steps, cost, blocked = between.unbind(-1)
            too_far = torch.where(back, (blocked > 0).to(cost.dtype), too_far.clamp_max(1))
            known = start[..., k, 2] * goal[..., k, 2]
            way = [too_far, torch.where(back, 0.0, steps), torch.where(back, 0.0, cost), back.to(cost.dtype)]
            result.append(torch.stack(way, dim=-1) * known[..., None])
        return torch.stack(result, dim=2)

    def _steps(self, free: Tensor, height: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The steps that end at each cell of some lines [B, nx, lines]: whether too long or high, number, cost."""
        rules = self.rules
        last, low = torch.full_like(height[:, 0], _NOWHERE), torch.zeros_like(height[:, 0])
        top = torch.full_like(low, -torch.inf)
        far, steps, cost = [], [], []
        for x in range(height.shape[1]):
            here, own = free[:, x], height[:, x]
            length, rise = x - last, (own - low).abs()
            step = here & (length > 1)
            clear = torch.maximum(top, low) - torch.minimum(own, low)
            limits = (rules.max_height, rise), (rules.max_clearance, clear)
            over = length > rules.longest
            for limit, value in limits:
                over = over | (value > limit + HEIGHT_TOLERANCE)
            far.append((step & over).to(own.dtype))
            steps.append(step.to(own.dtype))
            price = rules.cost + rules.cost_per_cell * length.clamp_max(COUNTED_LENGTH)
            price = price + rules.cost_per_height * rise.clamp_max(COUNTED_HEIGHT)
            cost.append(torch.where(step, price / STEP_COST_UNIT, 0.0))
            last, low = torch.where(here, float(x), last), torch.where(here, own, low)
            top = torch.where(here, -torch.inf, torch.maximum(top, own))
        return torch.stack(far, dim=1), torch.stack(steps, dim=1), torch.stack(cost, dim=1)


def _unknown(rough: Tensor) -> Tensor:
    return torch.where(rough < BLOCKED, UNKNOWN_ROUGH, rough)


def _at(values: Tensor, index: Tensor) -> Tensor:
    """Values [B, n, K] at index [B, G], [B, G, K]."""
    return values.gather(1, index[..., None].expand(-1, -1, values.shape[-1]))
