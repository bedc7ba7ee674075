"""Evaluation of the footprint network without torch.

The network is evaluated in windows of a map, for all robot poses that share a heading. Every feature is computed once
for each cell, and only at cells that some pose needs: kernels gather the inputs of a layer, one row for each cell, and
the layer is a product of matrices. A result depends on the cells around its pose alone, not on the window, to the last
bit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.gradual import Steps, finished
from hdsp.base.settings import load_settings
from hdsp.learning.footprint_geometry import (
    GROUND_RADIUS,
    LINE_RADIUS,
    MOST,
    NEAR_RADIUS,
    REACH,
    SAMPLES,
    SHARPNESS,
    FootprintOptions,
    farthest_read,
    read_reach,
)
from hdsp.learning.inference.foot_way_kernels import foot_way_rows
from hdsp.learning.inference.footprint_layers import FootprintLayers
from hdsp.learning.inference.gather_kernels import (
    GroundMaps,
    PoseCells,
    feet_rows,
    gather,
    gather_words,
    ground_rows,
    interpolate,
    mark,
    spread,
    store_poses,
    way_rows,
)
from hdsp.learning.inference.ground_kernels import (
    barred_shares,
    extreme,
    greatest_difference,
    told,
    trunk_channels,
    weighted_sum,
)
from hdsp.learning.inference.kept_features import ALONG, LOCAL, POSE, KeptFeatures, KeptPlace, WindowFeatures, not_kept
from hdsp.learning.inference.pose_table import CORNERS, PoseTable, Ways, goal_cells, goal_features, numbers, square
from hdsp.learning.judgements import Judgements
from hdsp.learning.learning_settings import ModelSettings
from hdsp.robot.lattice import PATCH_CELLS, PATCH_CENTER, cells
from hdsp.terrain.cost_maps import disc_mask
from hdsp.terrain.scenes import CATEGORIES, random_map

#: Cells of a window around the bases, on each side.
MARGIN = PATCH_CENTER
#: Poses judged at once.
POSES_AT_ONCE = 192
#: Such parts in a step.
PARTS = 8
#: Largest feature with a code of its own, relative to the largest one on random ground of all published categories.
CLIPPED = 1.25
#: Bases whose goals are judged together.
STATES = 64
#: Patches evaluated in one window.
STACK = 16
#: Channels of the first convolution, as ``trunk_channels`` numbers them.
_KINDS = ("unknown", "edge", "slope_x", "slope_y")
#: Sets of goals whose constants are kept; one for each heading, and as many mirrored.
_KEPT = 32


def engine_options(settings: ModelSettings) -> FootprintOptions | None:
    """Returns the options of a network that the engine evaluates, None for any other network.

    The engine evaluates footprint networks with a stance and dilations, whose patches have all the cells that the
    network reads.
    """
    encoding = settings.encoding
    if settings.architecture != "footprint" or encoding.reference != "none" or encoding.unknown is not None:
        return None
    options = load_settings(FootprintOptions, settings.options, "model.options")
    if (
        options.stance is None
        or not options.dilations
        or not {"height", "unknown", "edge", "unevenness"} <= set(encoding.channels)
    ):
        return None
    return options if farthest_read(encoding, options) < PATCH_CELLS - PATCH_CENTER else None


class FootprintEngine:
    """Footprint network with its weights.

    With codes, the largest layer, which reads the local features under a whole footprint, multiplies features of 8 bits
    with weights of 7 bits. The value of a code follows from the largest feature on some random ground (``CLIPPED``).
    Everything else is float32 in any case.

    Args:
        settings: model settings with ``engine_options``.
        tensors: the weights, by their names in the network.
        codes: whether the largest layer computes with codes.

    Attributes:
        code: value of one code; None without codes.
        reach: int64 [2], distances from a base along x and y, in cells, beyond which no height has an effect.

    Raises:
        InputError: a weight is missing, or has another shape.
        ModuleNotFoundError: ONNX Runtime is not installed.
    """

    def __init__(self, settings: ModelSettings, tensors: Mapping[str, np.ndarray], codes: bool = True):
        options = engine_options(settings)
        if options is None or options.stance is None:
            raise InputError(f"model {settings.architecture}: the evaluation without torch knows no such network")
        self.settings = settings
        self.options, self.stance, self.encoding = options, options.stance, settings.encoding
        self.reach = read_reach(self.encoding, options)
        self.table = PoseTable(options)
        self._goals: dict[bytes, _Goals] = {}
        self._kinds = np.array([_KINDS.index(c) for c in self.encoding.channels if c in _KINDS], np.int64)
        self._cone = self._unevenness_cone()
        self._clearance = np.argwhere(disc_mask(cells(self.stance.clearance))) - self.stance.clearance_cells
        self.layers = FootprintLayers(options, len(self._kinds), tensors)
        self.features, self._of_goal = self.layers.features, self.layers.of_goal
        self.code: float | None = None
        if codes:
            self.code = self._calibrated()
        self._pose, self._start, self._judge = (
            self.layers.of_pose(self.code),
            self.layers.of_start(),
            self.layers.of_goals(),
        )

    def _unevenness_cone(self) -> tuple[np.ndarray, np.ndarray]:
        radius = self.encoding.unevenness_radius
        offsets = square(radius - 1)
        x, y = offsets.T.astype(np.float32)
        weights = np.maximum(1 - np.hypot(x, y) / np.float32(radius), 0).astype(np.float32)
        return offsets[weights > 0], weights[weights > 0]

    def __reduce__(self) -> tuple:
        return FootprintEngine, (self.settings, self.layers.weights, self.code is not None)

    def _calibrated(self) -> float:
        """Returns the value of a code for the last local features, from the largest one on random ground."""
        largest, side = 0.0, PATCH_CELLS + 2 * MARGIN
        bases = numbers(np.argwhere(np.ones((PATCH_CELLS, PATCH_CELLS), bool)) + MARGIN, side)
        known = self._known_features(side * side)
        needed, local = self._needed(side, bases, self.table.context, known), known.local
        for category in CATEGORIES:
            channels = self._ground(random_map(1, category, 0, cells=side).heights)[1]
            finished(self._near_and_local(channels, needed, side, local))
            largest = max(largest, float(local[needed.local[-1]].max()))
        # Rounded, because the last bits of the features depend on the processor.
        return max(math.ceil(16 * CLIPPED * largest), 1) / 16 / 255

    def new_memory(self, shape: tuple[int, int]) -> KeptFeatures:
        """Returns a place for the features of a map with ``shape`` cells, empty."""
        local = sum(self.options.dilations) + NEAR_RADIUS + 1  # an edge lies between two cells
        line = LINE_RADIUS + NEAR_RADIUS + 1
        return KeptFeatures(shape, np.array([(local, local), (line, line), self.reach - REACH]))

    def evaluate(
        self, heights: np.ndarray, bases: np.ndarray, goals: np.ndarray, place: KeptPlace | None = None
    ) -> Iterator[tuple[slice, Judgements] | None]:
        """Evaluates the goals of some bases in a window, in short steps.

        Args:
            heights: float32 [nx, ny], metres, NaN = unknown.
            bases: int64 [n, 2], cells of ``heights`` under the bases, with ``MARGIN`` cells beyond, on each side.
            goals: float32 [G, 3] in abstract steps in the robot frame.
            place: place of the window in a map whose features are kept; None = none are kept.

        Yields:
            None some times in each layer of the whole window. Then, for each group of bases, its slice of ``bases``,
            and the judgements, [m, G].
        """
        to = self._known(goals)
        across = heights.shape[1]
        cells = numbers(bases, across)
        known = self._known_features(heights.size)
        needed = self._needed(across, cells, to.poses, known, place)
        maps, channels = self._ground(heights)

        yield None
        near = yield from self._near_and_local(channels, needed, across, known.local)
        yield None
        line_offsets = numbers(square(LINE_RADIUS), across)[:: 2 * LINE_RADIUS + 1]
        yield from self.layers.line.convolve(near, needed.line, line_offsets, 2 * LINE_RADIUS + 1, known.line)
        yield None
        yield from self._poses(known.local, maps, needed.poses, self.table.straight(across), known.poses)
        if place is not None:
            place.keep(across, (needed.local[-1], needed.line, needed.poses), known)
        yield None
        local, line, poses = known
        turned, turned_lower = self.table.turned(across), numbers(self.table.lower, across)
        context = numbers(self.table.context, across)
        along, profile, footholds = (
            numbers(at, across) for at in (self.table.along, self.table.profile, self.table.footholds)
        )
        of_feet = len(along) * line.shape[1] + 2 * len(profile) + len(footholds)
        corners = numbers(to.ways.lower[:, :, None] + CORNERS, across)
        for start in range(0, len(cells), STATES):
            part = cells[start : start + STATES]
            of_turns = self._turned(local, across, maps, part, turned, turned_lower)
            around = np.empty((len(part), len(context) * self.features), np.float32)
            gather(poses.ravel(), self.features, part, context, self.features, around)
            feet = np.empty((len(part), of_feet), np.float32)
            feet_rows(part, line, maps, along, profile, footholds, feet)
            (known,) = self._start.run(None, {"context rows": around, "feet rows": feet, "start": poses[part]})
            rows = np.empty((len(part) * len(goals), SAMPLES * self.features), np.float32)
            way_rows(part, poses, of_turns, corners, to.ways.weights, to.ways.turning, rows)
            inputs = {"rows": rows, "start": known, "goals": to.constant}
            if self.table.feet is not None:
                inputs["foot ways"] = np.empty((len(rows), self.options.way_features), np.float32)
                foot_way_rows(part, across, maps, self.table.feet, to.feet, inputs["foot ways"])
                inputs["goals of steps"] = to.of_steps
            (judged,) = self._judge.run(None, inputs)
            excess, logits, *planning_excess = np.moveaxis(judged.reshape(len(part), len(goals), -1), 2, 0)
            costs = [flat * (1 + more) for flat, more in zip(to.costs, (excess, *planning_excess), strict=True)]
            yield slice(start, start + STATES), Judgements(costs[0], logits, *costs[1:])

    def patches(self, patches: np.ndarray, goals: np.ndarray) -> Judgements:
        """Returns judgements [n, G] for patches [n, 72, 72] and goals [n, G, 3]."""
        result = Judgements.empty(goals.shape[:2], self.options.planning)
        distinct, which = np.unique(goals.reshape(len(goals), -1), axis=0, return_inverse=True)
        for kind in range(len(distinct)):
            members = np.flatnonzero(which.reshape(-1) == kind)
            for start in range(0, len(members), STACK):
                part = members[start : start + STACK]
                # One below another: no value that a base needs depends on cells beyond its patch.
                bases = np.full((len(part), 2), PATCH_CENTER)
                bases[:, 0] += PATCH_CELLS * np.arange(len(part))
                heights = patches[part].reshape(-1, PATCH_CELLS)
                for group in self.evaluate(heights, bases, np.ascontiguousarray(goals[part[0]])):
                    if group is not None:
                        result.store(part[group[0]], group[1])
        return result

    def _known(self, goals: np.ndarray) -> _Goals:
        key = goals.tobytes()
        if key not in self._goals:
            if len(self._goals) >= _KEPT:
                self._goals.clear()
            features, weights = goal_features(goals), self.layers.weights
            hidden = features @ weights["goal_cost.0.weight"].T + weights["goal_cost.0.bias"]
            costs = np.maximum(hidden, 0) @ weights["goal_cost.2.weight"].T + weights["goal_cost.2.bias"]
            ways = Ways.to(goals)
            poses = np.unique(np.concatenate([self.table.context, ways.cells()]), axis=0)
            of_steps = features @ self.layers.of_step_goal
            self._goals[key] = _Goals(ways, poses, costs.T, features @ self._of_goal, goal_cells(goals), of_steps)
        return self._goals[key]

    def _known_features(self, size: int) -> WindowFeatures:
        """Places for the features of a window with ``size`` cells."""
        kind, width = np.float32 if self.code is None else np.uint8, self.options.width
        widths = (width, kind), (width, np.float32), (self.features, np.float32)
        return WindowFeatures(*(np.empty((size, channels), kind) for channels, kind in widths))

    def _needed(
        self, across: int, cells: np.ndarray, read: np.ndarray, known: WindowFeatures, place: KeptPlace | None = None
    ) -> _Needed:
        """Finds the cells at which some base needs a feature that is not kept, layer by layer.

        Args:
            across: cells along y.
            cells: int64 [n], under the bases.
            read: int64 [n, 2], poses with the start heading that a base reads, relative to it.
            known: receives kept features.
            place: as for ``evaluate``.
        """
        poses, local, line = np.zeros((3, len(known.local)), bool)
        mark(poses, cells, numbers(read, across))
        found_poses = not_kept(poses, POSE, known.poses, across, place)
        _spread_square(poses, self.options.taps, self.options.spacing, across, local)
        mark(local, cells, numbers(self.table.turned_local, across))
        mark(line, cells, numbers(self.table.along, across))
        found_line = not_kept(line, ALONG, known.line, across, place)
        found_local = [not_kept(local, LOCAL, known.local, across, place)]
        marks = [local]
        for dilation in self.options.dilations[::-1]:
            marks.append(np.zeros_like(local))
            _spread_square(marks[-2], (3, 3), dilation, across, marks[-1])
        near, *before = marks[:0:-1]
        side = 2 * LINE_RADIUS + 1
        _spread_square(line, (side, side), 1, across, near)
        return _Needed(found_poses, found_line, np.flatnonzero(near), [*map(np.flatnonzero, before), *found_local])

    def _ground(self, heights: np.ndarray) -> tuple[GroundMaps, np.ndarray]:
        """Encodes the ground; also returns the channels of the first convolution."""
        encoding, stance, one = self.encoding, self.stance, np.float32(1)
        scale = np.float32(encoding.edge_scale)
        differences = greatest_difference(heights)
        channels = trunk_channels(heights, differences, scale, self._kinds)
        footholds = differences
        if contact := encoding.unevenness_contact:
            highest = extreme(heights, contact, one)
            footholds = greatest_difference(np.where(np.isnan(heights), heights, highest))
        rough = weighted_sum(footholds, *self._cone)
        low, high = map(np.float32, encoding.clip)
        height = np.clip(heights, low, high) * np.float32(encoding.scale)
        nearby = [extreme(height, GROUND_RADIUS, one), extreme(height, GROUND_RADIUS, -one), np.log1p(rough)]
        barred = barred_shares(
            heights, differences, scale, self._clearance, np.float32(stance.highest_edge), np.float32(MOST)
        )
        is_barred = told(barred, np.float32(SHARPNESS[0]))
        contact_height = extreme(height, contact, one) if self.options.foot_ways else np.empty(0)
        maps = rough, barred, is_barred, contact_height
        flat = (np.ascontiguousarray(values.ravel(), np.float32) for values in maps)
        return GroundMaps(height.ravel(), np.stack(nearby, axis=-1).reshape(-1, len(nearby)), *flat), channels

    def _near_and_local(
        self, channels: np.ndarray, needed: _Needed, across: int, result: np.ndarray
    ) -> Steps[np.ndarray]:
        """Computes the last local features, or their codes; returns features of the first convolution."""
        offsets = numbers(square(NEAR_RADIUS), across)[:: 2 * NEAR_RADIUS + 1]
        size, last = len(channels), len(self.layers.local) - 1
        local = near = np.empty((size, self.options.width), np.float32)
        yield from self.layers.near.convolve(channels, needed.near, offsets, 2 * NEAR_RADIUS + 1, near)
        for k, (layer, dilation) in enumerate(zip(self.layers.local, self.options.dilations, strict=True)):
            to = result if k == last else np.empty_like(near)
            yield
            yield from layer.convolve(
                local, needed.local[k], numbers(square(dilation, dilation), across), 1, to, self.code
            )
            local = to
        return near

    def _poses(
        self, local: np.ndarray, maps: GroundMaps, at: np.ndarray, cells: PoseCells, poses: np.ndarray
    ) -> Steps[None]:
        """Computes features of the poses with the start heading at some cells, float32 [cells, features]."""
        taps, channels = cells.taps[0], local.shape[1]
        words = local.reshape(-1).view(np.uint64) if local.dtype == np.uint8 and channels % 8 == 0 else None
        rows, ground = self._pose_rows(min(len(at), POSES_AT_ONCE), local.dtype)
        for number, start in enumerate(range(0, len(at), POSES_AT_ONCE), 1):
            part = at[start : start + POSES_AT_ONCE]
            inputs = rows[: len(part)]
            if words is None:
                gather(local.reshape(-1), channels, part, taps, channels, inputs)
            else:
                gather_words(words, channels // 8, part, taps, inputs.view(np.uint64))
            ground_rows(part, maps, cells, ground[: len(part)])
            store_poses(self._judged_poses(inputs, ground[: len(part)]), ground, part, poses)
            if number % PARTS == 0:
                yield

    def _turned(
        self,
        local: np.ndarray,
        across: int,
        maps: GroundMaps,
        bases: np.ndarray,
        cells: PoseCells,
        lower: np.ndarray,
    ) -> np.ndarray:
        """Features of the poses of turns, float32 [n, turns, features]."""
        turns = len(lower)
        poses = np.empty((len(bases) * turns, self.features), np.float32)
        rows, ground = self._pose_rows(len(poses), local.dtype)
        rounds = np.float32(0 if self.code is None else 0.5)
        interpolate(local.reshape(-1), local.shape[1], across, bases, lower, self.table.weights, rounds, rows)
        ground_rows(bases, maps, cells, ground)
        store_poses(self._judged_poses(rows, ground), ground, np.arange(len(poses)), poses)
        return poses.reshape(len(bases), turns, self.features)

    def _pose_rows(self, count: int, kind: np.dtype) -> tuple[np.ndarray, np.ndarray]:
        """Empty rows for ``count`` poses: local features or codes, and ground."""
        taps = self.options.taps[0] * self.options.taps[1]
        ground = np.empty((count, self.layers.ground_features), np.float32)
        return np.empty((count, taps * self.options.width), kind), ground

    def _judged_poses(self, local: np.ndarray, ground: np.ndarray) -> np.ndarray:
        return self._pose.run(None, {"local": local, "ground": ground})[0]


class _Goals(NamedTuple):
    """Constants of goals.

    Attributes:
        ways: ways to the goals.
        poses: int64 [n, 2], poses with the start heading that a base reads, relative to it.
        costs: float32 [1 or 2, G], costs without excess, for planning last.
        constant: float32 [G, head], part of the goals in the first layer.
        feet: int64 [G, 4], see ``foot_way_rows``.
        of_steps: float32 [G, steps], part of the goals in the layer that judges the feet's ways.
    """

    ways: Ways
    poses: np.ndarray
    costs: np.ndarray
    constant: np.ndarray
    feet: np.ndarray
    of_steps: np.ndarray


class _Needed(NamedTuple):
    """Cells, int64 [n], at which poses, line features, first and further local features are needed."""

    poses: np.ndarray
    line: np.ndarray
    near: np.ndarray
    local: list[np.ndarray]


def _spread_square(marks: np.ndarray, sides: tuple[int, int], step: int, across: int, result: np.ndarray) -> None:
    """Marks a rectangle of cells, ``step`` apart, around each marked cell."""
    along_x, along_y = ((np.arange(side) - side // 2) * step for side in sides)
    row = np.zeros_like(marks)
    spread(marks, along_y, row)
    spread(row, along_x * across, result)
