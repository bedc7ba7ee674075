"""Network that judges the robot's footprint at every pose on the way to a goal; dense, on any floor level."""

import math
from collections.abc import Sequence
from functools import reduce

import torch
from torch import Tensor, nn
from torch.nn import functional

from hdsp.base.errors import InputError
from hdsp.learning.footprint_geometry import (
    CONTEXT_STEP,
    FEET,
    GROUND_RADIUS,
    LINE,
    LINE_RADIUS,
    NEAR_RADIUS,
    POSE_FEATURES,
    POSES,
    PROFILE,
    REACH,
    RELATIVE,
    REQUIREMENT_FEATURES,
    SAMPLES,
    FootprintOptions,
    farthest_read,
    footprint_taps,
    requirement_reach,
    turn_angles,
)
from hdsp.learning.learning_settings import HeightEncoding
from hdsp.learning.networks.base import TaskNetwork
from hdsp.learning.networks.foot_ways import FootWays
from hdsp.learning.networks.goals import GOAL_FEATURES, goal_features
from hdsp.learning.networks.requirements import BARRED, HEIGHT, HIGHEST, LOWEST, PoseRequirements, told
from hdsp.robot.lattice import CELLS_PER_ABSTRACT, PATCH_CELLS, PATCH_CENTER

#: Rows around the right line of feet and around the left line, within the strip that holds both lines.
SIDES = (slice(2 * LINE_RADIUS + 1), slice(-2 * LINE_RADIUS - 1, None))


class Footprint(TaskNetwork):
    """Local features, gathered over the robot's footprint at each pose on a way.

    Detailed costs depend on the ground under feet and body at each pose, in the same manner for every goal and every
    part of a way. So one layer judges the footprint at all positions within reach (a convolution with the robot's
    size), and at rotated poses for goals that turn. ``requirements.PoseRequirements`` adds features for the robot's
    requirements at each pose. A small network then judges the footprint sequence on the straight way to a goal,
    together with a summary of all footprints around it. ``foot_ways.FootWays`` adds where the feet stand at start and
    goal, and the steps in between.

    The network uses no padding and only height differences, so it can be evaluated densely and on any floor level.
    """

    taps: Tensor
    turns: Tensor

    Options = FootprintOptions

    def __init__(self, encoding: HeightEncoding, options: FootprintOptions):
        super().__init__(encoding)
        width, hidden = options.width, options.hidden
        names = encoding.channels
        if "height" not in names:
            raise InputError(f"model.encoding.channels: {list(names)} lacks height, which the footprint network needs")
        # The trunk reads differences, and the height itself only if there is no other channel.
        self.trunk_channels = [i for i, c in enumerate(names) if c not in ("height", "unevenness")]
        self.trunk_channels = self.trunk_channels or [names.index("height")]
        self.ground_channels = 3 if "unevenness" in names else 2
        self.tapped = slice(HIGHEST, HIGHEST + self.ground_channels)
        self.options = options
        self.foot = options.foot
        self.near = nn.Sequential(nn.Conv2d(len(self.trunk_channels), width, 2 * NEAR_RADIUS + 1), nn.ReLU())
        layers: list[nn.Module] = []
        for dilation in options.dilations:
            layers += [nn.Conv2d(width, width, 3, dilation=dilation), nn.ReLU()]
        self.local = nn.Sequential(*layers)
        self.radius = sum(options.dilations)
        self.margins = tuple(n // 2 * options.spacing for n in options.taps)
        self.of_local = nn.Conv2d(width, hidden, options.taps, dilation=options.spacing)
        of_ground = self.ground_channels * math.prod(options.taps) + (REQUIREMENT_FEATURES if options.stance else 0)
        self.of_ground = nn.Linear(of_ground, hidden, bias=False)
        self.footprint = nn.Linear(hidden, options.features)
        #: Features per pose: its footprint features and, with a stance, the unchanged stance features.
        self.pose_features = options.features + (POSE_FEATURES if options.stance else 0)
        self.context = nn.Linear(len(range(0, POSES, CONTEXT_STEP)) ** 2 * self.pose_features, options.context)
        self.of_line = nn.Sequential(nn.Conv2d(width, width, 2 * LINE_RADIUS + 1), nn.ReLU())
        footholds = PROFILE[-1] - PROFILE[0] + 1 if options.stance else 0
        self.feet = nn.Linear(4 * (len(LINE) * width + len(PROFILE) * 2 + footholds), options.feet)
        way = (SAMPLES + 2) * self.pose_features + options.context + options.feet + GOAL_FEATURES
        self.rest = nn.Sequential(
            nn.Linear(way, options.head), nn.ReLU(), nn.Linear(options.head, options.head // 2), nn.ReLU()
        )
        self.foot_ways = FootWays(options) if options.foot_ways else None
        judged = options.head // 2
        if options.foot_ways:
            seen = judged + options.way_features + GOAL_FEATURES
            self.steps = nn.Sequential(
                nn.Linear(seen, options.steps), nn.ReLU(), nn.Linear(options.steps, options.steps), nn.ReLU()
            )
            judged += options.steps
        # Excess of the label's cost, logit, excess of the cost for planning.
        self.heads = nn.Linear(judged, 1 + options.costs)
        self.goal_cost = nn.Sequential(nn.Linear(GOAL_FEATURES, 64), nn.ReLU(), nn.Linear(64, options.costs))
        self.predicts_planning_cost = options.planning
        self.register_buffer("taps", torch.from_numpy(footprint_taps(options)), persistent=False)
        self.register_buffer("turns", torch.from_numpy(turn_angles()), persistent=False)
        self.requirements = None
        if options.stance:
            if not {"unknown", "edge", "unevenness"} <= set(names):
                raise InputError(f"model.encoding.channels: {list(names)}; stance needs unknown, edge and unevenness")
            self.requirements = PoseRequirements(options.stance)
            required = max(int(far.max()) for far in requirement_reach(options.stance).values())
            reach = max(required, self.foot[0] + PROFILE[-1] + self.requirements.radius)
            if reach >= PATCH_CENTER:
                raise InputError(f"model.options.stance: looks {reach} cells far, but a patch has {PATCH_CENTER}")

    def map_part(self, encoded: Tensor) -> Tensor:
        near, ground = self._first(encoded)
        # Local features only at judged footprints, line features only along the two lines of feet.
        x, y = (PATCH_CENTER - REACH - n for n in self.margins)
        local = self.local(_cut(near, x - self.radius, y - self.radius))
        under = _cut(ground, x, y)
        centre = torch.tensor([[PATCH_CENTER, PATCH_CENTER]], device=encoded.device)
        required = self._required(ground, [PATCH_CENTER - NEAR_RADIUS - REACH] * 2, (POSES, POSES))
        straight = self._footprints(local, under, required).permute(0, 2, 3, 1).flatten(1)
        turned = self._turned(local, under, centre - torch.tensor([x, y], device=centre.device)).flatten(1)
        first = PATCH_CENTER - self.foot[0] - LINE[-1]
        aside = PATCH_CENTER - self.foot[1] - LINE_RADIUS
        strips = (_cut(near, first - LINE_RADIUS, aside)[..., side] for side in SIDES)
        line = torch.cat([self.of_line(strip) for strip in strips], dim=-1)
        at = self._line_cells(centre)
        at = torch.stack([at[..., 0] - first, (at[..., 1] > PATCH_CENTER).long()], dim=-1)
        parts = [straight, turned, self._feet(line, at, ground, centre - NEAR_RADIUS)[:, 0]]
        if self.foot_ways:
            x, y = (PATCH_CENTER - n for n in self.foot_ways.region)
            known = self.foot_ways.ground(ground, self._contact(encoded))
            parts.append(self.foot_ways.around(_cut(known, x, y)))
        return torch.cat(parts, dim=1)

    def dense_trunk(self) -> "FootprintTrunk":
        return FootprintTrunk(self)

    def is_dense(self) -> bool:
        # Dense evaluation is exact if no value read in a patch depends on cells beyond its rim.
        far = farthest_read(self.encoding, self.options)
        return self.encoding.reference == "none" and far < PATCH_CELLS - PATCH_CENTER

    def _first(self, encoded: Tensor) -> tuple[Tensor, Tensor]:
        """Common inputs, at all cells at least NEAR_RADIUS cells from the rim.

        Returns:
            features: [B, width, ...].
            ground: [B, 3 to 5, ...]: the cell's height (NaN = unknown), the highest and the lowest height nearby, the
                unevenness if it is a channel, and ``barred`` with pose requirements.
        """
        names = self.encoding.channels
        near = self.near(encoded[:, self.trunk_channels])
        height = encoded[:, names.index("height"), None].float()
        unknown = torch.zeros_like(height, dtype=torch.bool)
        if "unknown" in names:
            unknown = encoded[:, names.index("unknown"), None] > 0
        highest = _highest(height.masked_fill(unknown, -math.inf), 2 * GROUND_RADIUS + 1)
        lowest = -_highest((-height).masked_fill(unknown, -math.inf), 2 * GROUND_RADIUS + 1)
        inner = slice(NEAR_RADIUS, -NEAR_RADIUS)
        own = height.masked_fill(unknown, math.nan)[..., inner, inner]
        unevenness = [encoded[:, i, None, inner, inner].float() for i, name in enumerate(names) if name == "unevenness"]
        barred = []
        if self.requirements:
            bounded = encoded[:, names.index("edge"), None].float()
            edges = self.requirements.barred(self.encoding.edge_scale * bounded / (1 - bounded).clamp_min(1e-6))
            # Nothing reads the rim cells that are cut or padded here.
            rim = self.requirements.radius - NEAR_RADIUS
            barred = [functional.pad(edges, [rim] * 4) if rim >= 0 else edges[..., -rim:rim, -rim:rim]]
        return near, torch.cat([own, highest, lowest, *unevenness, *barred], dim=1)

    def _contact(self, encoded: Tensor) -> Tensor:
        """Highest ground under a foot at all cells of ``_first``, [B, ...]; -inf where all of it is unknown."""
        names, radius = self.encoding.channels, self.encoding.unevenness_contact
        height = encoded[:, names.index("height")].float()
        known = height.masked_fill(encoded[:, names.index("unknown")] > 0, -math.inf)
        rim = radius - NEAR_RADIUS
        return _highest(functional.pad(known, [rim] * 4, value=-math.inf), 2 * radius + 1)

    def _line_cells(self, bases: Tensor, offsets: tuple[int, ...] = LINE) -> Tensor:
        """Cells [n, 4, offsets, 2] ahead of the four feet and behind them, for bases [n, 2]."""
        feet = bases[:, None] + bases.new_tensor([(i * self.foot[0], j * self.foot[1]) for i, j in FEET])
        along = torch.stack([bases.new_tensor(offsets), bases.new_zeros(len(offsets))], dim=-1)
        return feet[:, :, None] + along

    def _feet(self, line: Tensor, at: Tensor, ground: Tensor, bases: Tensor) -> Tensor:
        """Ground summary ahead of the feet and behind them, [B, n, feet].

        Reads line features at cells ``at`` [n, 4, offsets, 2] and the ground around ``bases`` [n, 2].
        """
        profile = self._line_cells(bases, PROFILE)
        seen = line[:, :, at[..., 0], at[..., 1]].permute(0, 2, 3, 4, 1).flatten(2)
        heights = ground[:, HIGHEST : LOWEST + 1, profile[..., 0], profile[..., 1]].permute(0, 2, 3, 4, 1)
        base = ground[:, HEIGHT, bases[:, 0], bases[:, 1]][:, :, None, None, None]
        parts = [seen.float(), _relative(heights, base).flatten(2)]
        if self.requirements:
            x, y = self._line_cells(bases, tuple(range(PROFILE[0], PROFILE[-1] + 1))).unbind(-1)
            parts.append(told(ground[:, BARRED, x, y]).flatten(2))
        return torch.relu(self.feet(torch.cat(parts, dim=-1)))

    def _required(self, ground: Tensor, first: Sequence[int], size: Sequence[int]) -> Tensor | None:
        return self.requirements.straight(ground, first, size) if self.requirements else None

    def _footprints(self, local: Tensor, ground: Tensor, required: Tensor | None) -> Tensor:
        """Footprints [B, pose features, mx, my] at all positions whose taps lie within the maps."""
        taps, spacing = self.options.taps, self.options.spacing
        of_local = self.of_local(local)
        mx, my = of_local.shape[-2:]
        x, y = self.margins
        base = ground[:, HEIGHT, None, x : x + mx, y : y + my]
        tapped = [
            ground[:, self.tapped, i * spacing : i * spacing + mx, j * spacing : j * spacing + my]
            for i in range(taps[0])
            for j in range(taps[1])
        ]
        seen = torch.stack(tapped, dim=1)
        of_ground = torch.cat([_relative(seen[:, :, :2], base[:, None]), seen[:, :, 2:]], dim=2).flatten(1, 2)
        if required is not None:
            of_ground = torch.cat([of_ground, required], dim=1)
        hidden = torch.relu(of_local + functional.conv2d(of_ground, self.of_ground.weight[:, :, None, None]))
        weight, bias = self.footprint.weight[:, :, None, None], self.footprint.bias
        judged = torch.relu(functional.conv2d(hidden, weight, bias))
        return judged if required is None else torch.cat([judged, required[:, -POSE_FEATURES:].to(judged)], dim=1)

    def _turned(self, local: Tensor, ground: Tensor, centres: Tensor) -> Tensor:
        """Footprints [B, n, turns, pose features] for bases rotated in place at cells ``centres`` [n, 2]."""
        cos, sin = self.turns.cos()[:, None], self.turns.sin()[:, None]
        x, y = self.taps.unbind(-1)
        positions = centres[:, None, None, :] + torch.stack([cos * x - sin * y, sin * x + cos * y], dim=-1)
        near = positions.round().long()
        seen = ground[:, self.tapped, near[..., 0], near[..., 1]].permute(0, 2, 3, 4, 1)
        base = ground[:, HEIGHT, centres[:, 0], centres[:, 1]][:, :, None, None, None]
        of_ground = torch.cat([_relative(seen[..., :2], base), seen[..., 2:]], dim=-1).flatten(3)
        weight = self.of_local.weight.flatten(2).permute(0, 2, 1).flatten(1)
        of_local = functional.linear(_interpolated(local, positions).flatten(-2), weight, self.of_local.bias)
        if self.requirements:
            required = self.requirements.turned(ground, centres)
            of_ground = torch.cat([of_ground, required], dim=-1)
        judged = torch.relu(self.footprint(torch.relu(of_local + self.of_ground(of_ground))))
        return torch.cat([judged, required[..., -POSE_FEATURES:].to(judged)], dim=-1) if self.requirements else judged

    def goal_part(self, features: Tensor, goals: Tensor) -> tuple[Tensor, ...]:
        width = self.pose_features
        goals = goals.expand(features.shape[0], -1, -1)
        sizes = [POSES * POSES * width, 2 * (SAMPLES - 1) * width, self.options.feet]
        if self.foot_ways:
            sizes.append(features.shape[1] - sum(sizes))
        straight, turned, feet, *footholds = features.split(sizes, dim=1)
        straight = straight.reshape(-1, POSES, POSES, width)
        turned = turned.reshape(-1, 2, SAMPLES - 1, width)
        share = torch.linspace(0, 1, SAMPLES, device=goals.device)[1:, None]
        positions = (goals[..., None, :2] * (share * CELLS_PER_ABSTRACT) + REACH).clamp(0, POSES - 1)
        way = _interpolated_each(straight, positions)
        turning = goals[..., 2] != 0
        chosen = torch.where((goals[..., 2] > 0)[..., None, None], turned[:, None, 0], turned[:, None, 1])
        way = torch.where(turning[..., None, None], chosen, way)
        start = straight[:, None, REACH, REACH].expand(-1, goals.shape[1], -1)
        way = torch.cat([start[:, :, None], way], dim=2)
        around = torch.relu(self.context(straight[:, ::CONTEXT_STEP, ::CONTEXT_STEP].flatten(1)))
        around = torch.cat([around, feet], dim=1)[:, None].expand(-1, goals.shape[1], -1)
        known = goal_features(goals)
        seen = torch.cat([way.flatten(2), way.mean(2), way.amax(2), around, known], dim=-1)
        judged = self.rest(seen)
        if self.foot_ways:
            steps = self.steps(torch.cat([judged, self.foot_ways(footholds[0], goals), known], dim=-1))
            judged = torch.cat([judged, steps], dim=-1)
        excess, logits, *planning_excess = self.heads(judged).unbind(-1)
        cost, *planning_cost = self.goal_cost(known).unbind(-1)
        result = cost * (1 + excess), logits
        return (*result, planning_cost[0] * (1 + planning_excess[0])) if planning_cost else result


class FootprintTrunk:
    """Dense evaluation for ``Footprint``, see ``networks.dense.DenseEvaluation``."""

    exact = True
    margin = 0

    def __init__(self, network: Footprint):
        self.network = network

    def __call__(self, encoded: Tensor) -> tuple[Tensor, ...]:
        """Returns local features, the ground under them, footprints, line features, all ground, and with foot ways that
        of footholds.

        Each part covers all cells of ``encoded`` [1, channels, nx, ny] with sufficient surroundings.
        """
        network, inner = self.network, slice(self.network.radius, -self.network.radius)
        near, ground = network._first(encoded)
        local, under = network.local(near), ground[..., inner, inner]
        # Cells first: the features at one cell are then contiguous and copied in one piece.
        size = [n - 2 * margin for n, margin in zip(under.shape[-2:], network.margins, strict=True)]
        required = network._required(ground, [network.radius + margin for margin in network.margins], size)
        straight = network._footprints(local, under, required)[0].permute(1, 2, 0).contiguous()
        dense = local.float(), under, straight.float(), network.of_line(near).float(), ground
        if network.foot_ways is None:
            return dense
        return *dense, network.foot_ways.ground(ground, network._contact(encoded))

    def windows(self, dense: tuple[Tensor, ...], corners: Tensor) -> Tensor:
        """Returns features [n, F], as ``map_part`` does, for patches with lower corners [n, 2]."""
        local, under, straight, line, ground, *footholds = dense
        network = self.network
        bases = corners + (PATCH_CENTER - NEAR_RADIUS)
        turned = network._turned(local, under, bases - network.radius)[0]
        feet = network._feet(line, network._line_cells(bases - LINE_RADIUS), ground, bases)[0]
        first_x, first_y = (bases - network.radius - REACH - corners.new_tensor(network.margins)).unbind(1)
        inside = torch.arange(POSES, device=corners.device)
        width = straight.shape[1]
        index = ((first_x * width + first_y)[:, None, None] + inside[:, None] * width + inside).flatten()
        windows = straight.flatten(0, 1)[index].view(len(corners), POSES, POSES, -1)
        parts = [windows.flatten(1), turned.flatten(1), feet]
        if network.foot_ways:
            x, y = ((torch.arange(2 * n + 1, device=corners.device) - n) for n in network.foot_ways.region)
            at = bases[:, 0, None, None] + x[:, None], bases[:, 1, None, None] + y
            parts.append(network.foot_ways.around(footholds[0][0][:, at[0], at[1]].transpose(0, 1)))
        return torch.cat(parts, dim=1)


def _cut(maps: Tensor, x: int, y: int) -> Tensor:
    """Cuts a rectangle around the base from maps without the outer NEAR_RADIUS cells of a patch.

    The base stands on patch cell (36, 36); the rectangle spans patch cells (x, y) to (72 - x, 72 - y).
    """
    first_x, first_y = x - NEAR_RADIUS, y - NEAR_RADIUS
    span_x, span_y = (2 * (PATCH_CENTER - n) + 1 for n in (x, y))
    return maps[..., first_x : first_x + span_x, first_y : first_y + span_y]


def _relative(heights: Tensor, base: Tensor) -> Tensor:
    """Heights relative to the ground at the base, clipped to ``RELATIVE``; unknown heights become 0.

    Beyond this range the ground is higher than the body or deeper than a foot reaches, and differences no longer
    matter.
    """
    return (heights - base).nan_to_num(nan=0.0, posinf=0.0, neginf=0.0).clamp(*RELATIVE)


def _highest(values: Tensor, window: int) -> Tensor:
    """Maximum over a square window at every cell with a whole window, [B, C, nx - window + 1, ...]."""
    for axis in (-2, -1):
        length = values.shape[axis] - window + 1
        parts = [values.narrow(axis, start, length) for start in range(window)]
        values = parts[0]
        for part in parts[1:]:
            values = torch.maximum(values, part)
    return values


def _interpolated(maps: Tensor, positions: Tensor) -> Tensor:
    """Samples maps [B, C, nx, ny] bilinearly at shared positions [..., 2]; returns [B, ..., C]."""
    low = positions.detach().floor()
    share = positions - low
    i, j = low.long().unbind(-1)
    x, y = share.to(maps.dtype).unbind(-1)
    corners = ((0, 0, (1 - x) * (1 - y)), (0, 1, (1 - x) * y), (1, 0, x * (1 - y)), (1, 1, x * y))
    rows = maps.permute(0, 2, 3, 1)
    return reduce(torch.add, (rows[:, i + a, j + b] * weight[..., None] for a, b, weight in corners))


def _interpolated_each(maps: Tensor, positions: Tensor) -> Tensor:
    """Samples maps [B, nx, ny, C] bilinearly at each map's own positions [B, ..., 2]; returns [B, ..., C]."""
    cells = maps.shape[1]
    at = positions.flatten(1, -2)
    low = at.floor().clamp_max(cells - 2)
    x, y = (at - low).unbind(-1)
    first = low[..., 0].long() * cells + low[..., 1].long()
    rows = maps.flatten(1, 2)

    def corner(step: int) -> Tensor:
        return rows.gather(1, (first + step)[..., None].expand(-1, -1, maps.shape[-1]))

    weights = ((0, (1 - x) * (1 - y)), (1, (1 - x) * y), (cells, x * (1 - y)), (cells + 1, x * y))
    result = reduce(torch.add, (corner(step) * weight[..., None] for step, weight in weights))
    return result.view(*positions.shape[:-1], maps.shape[-1])
