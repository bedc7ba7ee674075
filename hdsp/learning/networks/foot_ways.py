"""Where the feet stand at start and goal, and the steps that each of them needs in between."""

from __future__ import annotations

from functools import reduce

import torch
from torch import Tensor, nn
from torch.nn import functional

from hdsp.learning.footprint_geometry import (
    ASIDE,
    COUNTED_HEIGHT,
    COUNTED_LENGTH,
    DRIVE_SAMPLES,
    FEET,
    HEIGHT_TOLERANCE,
    MANOEUVRE,
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

    The robot drives in all directions only on neutral feet. With ``FootWayOptions.manoeuvres``, the features tell the
    shortest manoeuvre that brings all feet to neutral ahead of the start, the shortest one from neutral feet behind the
    goal to the footholds there, and the drive between both. The base only shifts ahead; bodies may collide; goals that
    turn have no manoeuvre at their end.

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
        """Returns features, float [B, G, ``FootprintOptions.way_features``], without gradients.

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
        free = rough < BLOCKED
        sums = torch.stack([*self._steps(free, height), (~free).to(height.dtype)], dim=-1).cumsum(1)
        ways = self._ways(sums, start, goal, at) * ahead[..., None, None]
        base = height[:, x, y][:, None, None]
        count = goals.shape[1]
        places = [self._place(feet, base).expand(-1, count, -1, -1) for feet in (start, goal)]
        found = [*(part.flatten(2) for part in (*places, ways)), ahead[..., None].to(height.dtype)]
        if self.rules.manoeuvres:
            found.append(self._manoeuvres(free, sums, start, goal, at, goals[..., 2] == 0))
        return torch.cat(found, dim=-1)

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

    def _ways(self, sums: Tensor, start: Tensor, goal: Tensor, at: Tensor) -> Tensor:
        """Features of each foot's way along x, [B, G, 4, FOOT_WAY]."""
        x, y = self.region
        foot_x, foot_y = self.options.foot
        result = []
        for k, (ahead, left) in enumerate(FEET):
            neutral = ahead * foot_x + x
            first = start[..., k, 0].long().expand(-1, at.shape[1]) + neutral
            last = (at[..., 0] + goal[..., k, 0].long() + neutral).clamp(0, 2 * x)
            known = start[..., k, 2] * goal[..., k, 2]
            result.append(_walked(sums[:, :, y + left * foot_y], first, last) * known[..., None])
        return torch.stack(result, dim=2)

    def _manoeuvres(
        self, free: Tensor, sums: Tensor, start: Tensor, goal: Tensor, at: Tensor, straight: Tensor
    ) -> Tensor:
        """Features of both manoeuvres and the drive between them, [B, G, ``MANOEUVRE_FEATURES``]."""
        x, y = self.region
        neutral = self._neutral(free).flatten(1)
        shifts = torch.arange(self.cells[0].numel() // (2 * 2 * len(FEET)), device=at.device)
        away, _ = self._manoeuvre(neutral, sums, torch.zeros_like(at[:, :1]), start, shifts, leaves=True)
        to, found = self._manoeuvre(neutral, sums, at, goal, shifts, leaves=False)
        away = away.expand(-1, at.shape[1], -1)
        begin, end = ((part[..., -1] * OFFSET_UNIT).round() for part in (away, to))
        way = torch.stack([at[..., 0] - end - begin, at[..., 1].to(begin.dtype)], dim=-1)
        share = torch.linspace(0, 1, DRIVE_SAMPLES, device=at.device)[:, None]
        cells = (way[..., None, :] * share).round()
        cells = cells + torch.stack([begin, torch.zeros_like(begin)], dim=-1)[..., None, :]
        i, j = ((cells[..., k].long() + n).clamp(0, 2 * n) for k, n in enumerate((x, y)))
        over = neutral.gather(1, (i * (2 * y + 1) + j).flatten(1)).view(i.shape)
        barred = (~over).to(begin.dtype).mean(-1, keepdim=True)
        drive = torch.cat([barred, way / OFFSET_UNIT], dim=-1) * (away[..., :1] * found[..., None])
        return torch.cat([away, torch.cat([to, drive], dim=-1) * straight[..., None]], dim=-1)

    def _neutral(self, free: Tensor) -> Tensor:
        """Whether all neutral feet have footholds, [B, nx, ny], for bases at all cells."""
        x, y = self.options.foot
        nx, ny = free.shape[1:]
        wide = functional.pad(free, (y, y, x, x))
        parts = [wide[:, x + i * x : x + i * x + nx, y + j * y : y + j * y + ny] for i, j in FEET]
        return reduce(torch.logical_and, parts)

    def _manoeuvre(
        self, neutral: Tensor, sums: Tensor, at: Tensor, feet: Tensor, shifts: Tensor, leaves: bool
    ) -> tuple[Tensor, Tensor]:
        """The shortest manoeuvre between feet at bases and neutral feet, ahead of them if it leaves, behind if not.

        Args:
            neutral: bool [B, nx * ny], from ``_neutral``.
            sums: [B, nx, ny, 4], steps up to each cell.
            at: int64 [B, G, 2], cells of the bases.
            feet: [B, G, 4, 3], from ``_feet`` at these bases.
            shifts: int64 [n], distances to the base on neutral feet.
            leaves: whether it leads from the feet to neutral ones.

        Returns:
            features: [B, G, MANOEUVRE].
            found: float [B, G], whether there is one.
        """
        x, y = self.region
        foot_x, foot_y = self.options.foot
        across = 2 * y + 1
        base_x, base_y = at[..., 0, None] + (shifts if leaves else -shifts), at[..., 1, None]  # [B, G, n], [B, G, 1]
        inside = base_x.abs() <= x
        over = (base_x.clamp(-x, x) + x) * across + base_y + y
        stands = feet[..., 2].amin(-1, keepdim=True) > 0  # as "all" of numbers, which has no type in ONNX
        possible = inside & neutral.gather(1, over.flatten(1)).view(over.shape) & stands
        walked = torch.zeros((*over.shape, MANOEUVRE), dtype=sums.dtype, device=sums.device)
        lines = sums.flatten(1, 2)
        for k, (ahead, left) in enumerate(FEET):
            own = at[..., 0, None] + feet[..., k, 0, None].long() + ahead * foot_x + x
            other = base_x + ahead * foot_x + x
            first, last = (n.clamp(0, 2 * x) for n in ((own, other) if leaves else (other, own)))
            row = base_y + left * foot_y + y
            first, last = torch.broadcast_tensors(first, last)
            walked = walked + _walked(lines, first * across + row, last * across + row)
            if not leaves:
                possible = possible & (shifts >= -feet[..., k, 0, None])
        possible = possible & (walked[..., 0] == 0)
        least = torch.where(possible, shifts, len(shifts)).amin(-1, keepdim=True)
        found = (least < len(shifts)).to(sums.dtype)
        least = least.clamp_max(len(shifts) - 1)
        of_least = walked.gather(2, least[..., None].expand(-1, -1, -1, MANOEUVRE))[:, :, 0]
        features = torch.cat([found, of_least[..., 1:3], least.to(sums.dtype) / OFFSET_UNIT], dim=-1) * found
        return features, found[..., 0]

    def _steps(self, free: Tensor, height: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The steps that end at each cell of all lines [B, nx, ny]: whether too long or high, number, cost."""
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


def _walked(sums: Tensor, first: Tensor, last: Tensor) -> Tensor:
    """Features of a foot's way from one cell to another, [B, ..., FOOT_WAY].

    Args:
        sums: [B, cells, 4], steps too far, steps, their cost, and barred cells, up to each cell.
        first, last: int64 [B, ...].
    """
    low, high = torch.minimum(first, last), torch.maximum(first, last)
    too_far, steps, cost, blocked = (_at(sums, high) - _at(sums, low)).unbind(-1)
    back = last < first
    too_far = torch.where(back, (blocked > 0).to(cost.dtype), too_far.clamp_max(1))
    return torch.stack([too_far, torch.where(back, 0.0, steps), torch.where(back, 0.0, cost), back.to(cost.dtype)], -1)


def _at(values: Tensor, index: Tensor) -> Tensor:
    """Values [B, n, K] at index [B, ...], [B, ..., K]."""
    found = values.gather(1, index.flatten(1)[..., None].expand(-1, -1, values.shape[-1]))
    return found.view(*index.shape, values.shape[-1])
