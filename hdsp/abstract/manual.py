"""Manual abstraction: hand-tuned costs from coarse terrain features; the baseline in the paper's Table I.

It follows level 3 in Klamt & Behnke, ICRA 2018: a 3D robot state, 10 cm cells, a few features per cell and a few
constants set by hand. It shares neither code nor constants with that work.

Cell features: height range (largest minus smallest height, over the cell and a rim of one height map cell), mean
height, largest height, and class:

- *drivable*: no edge blocks a wheel;
- *step*: a foot can step over the edge;
- *wall*: the edge is higher, or the ground is unknown.

Rules for a robot with neutral feet:

- A state is *blocked* if ground rises into the body, which lies above the plane through the ground under the neutral
  feet (`hdsp.detailed.base_pose`), or if a foot finds no drivable cell within a small reach ahead and behind.
- An action is feasible if no state on its way is blocked and each foot crosses drivable cells. On an action (nearly)
  straight ahead or back, a foot may also cross step cells.
- The action costs its flat-ground cost, raised in proportion to the mean height range below and around the robot, plus
  a constant for each stepping foot.

Unknown to this abstraction: an edge's place inside a cell, other foot configurations, and all details beyond the
classes. The constants come from reasoning and a few maps; they were not fitted, and no test set was used.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from hdsp.abstract.abstract_costs import FlatCosts, Region, checked_mask, checked_region, checked_tasks
from hdsp.abstract.manual_kernels import CoarseGround, CoarsePoseCells, Goals, Known, filled, find_costs
from hdsp.abstract.oracle import CostKind
from hdsp.base.gradual import Steps, finished
from hdsp.base.settings import NotNegative, checked
from hdsp.robot.lattice import (
    ABSTRACT_ACTIONS,
    ABSTRACT_ANCHOR,
    ABSTRACT_HEADINGS,
    CELLS_PER_ABSTRACT,
    N_ABSTRACT_ACTIONS,
    PATCH_CENTER,
    abstract_shape,
    abstract_steps,
    abstract_steps_to_world,
    heading_angle,
    robot_frame_goals,
    rotation,
)
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.rounding import height_tolerance


@checked
class ManualSettings:
    """Hand-set constants; conf/abstraction/manual.yaml explains their values.

    Attributes:
        unevenness_cost: rise in the cost factor per metre of mean height range.
        margin: width (m) of the border around the feet's rectangle in which ground counts as uneven for the robot.
        step_cost: cost of one foot's step over an edge.
        step_deviation: largest deviation (rad) from straight ahead or straight back for a stepping action.
        foot_reach: distance (m) ahead of and behind the neutral position within which a foot may find a drivable cell.
    """

    unevenness_cost: NotNegative = 12.0
    margin: NotNegative = 0.2
    step_cost: NotNegative = 0.1
    step_deviation: NotNegative = 0.3
    foot_reach: NotNegative = 0.1


class Features(NamedTuple):
    """Coarse terrain, each [..., nx, ny] over 10 cm cells; NaN = unknown."""

    height_range: np.ndarray
    ground: np.ndarray
    top: np.ndarray


class ManualCosts:
    """Manual abstraction for one robot. Implements `LocalCosts` and `TaskPredictor`.

    Edges build on planning costs of flat ground, predictions on label costs.
    """

    def __init__(
        self, robot: Robot | str, settings: ManualSettings | None = None, kind: CostKind | str = CostKind.PLANNING
    ):
        """Sets up the abstraction.

        Args:
            robot: a robot, or what `Robot.load` takes.
            settings: hand-set constants.
            kind: kind of costs of the edges.

        Raises:
            InputError: the kind is unknown.
        """
        self.robot = Robot.load(robot)
        self.settings = settings or ManualSettings()
        self._flat = FlatCosts(self.robot, kind)

    def __repr__(self) -> str:
        return f"ManualCosts({self.robot.name})"

    def edges(self, height_map: HeightMap, region: Region | None = None, mask: np.ndarray | None = None) -> np.ndarray:
        """See `AbstractCosts.edges`."""
        return finished(self.edge_steps(height_map, region, mask))

    def edge_steps(
        self, height_map: HeightMap, region: Region | None = None, mask: np.ndarray | None = None
    ) -> Steps[np.ndarray]:
        """See `GradualCosts.edge_steps`."""
        first_x, first_y, end_x, end_y = checked_region(height_map, region)
        shape = (ABSTRACT_HEADINGS, end_x - first_x, end_y - first_y)
        wanted = np.ones(shape, bool) if mask is None else checked_mask(mask, shape)
        # The region is enlarged by the reach of its states.
        reach, end = self._reach(), abstract_shape(height_map.shape)
        low = max(first_x - reach, 0), max(first_y - reach, 0)
        features = _features_in(height_map.heights, (*low, end_x + reach, end_y + reach))
        ground = _ground(features, self.robot, int(np.abs(self._cells.body).max(initial=0)))
        known = Known.nothing(*features.ground.shape)
        yield
        edges = np.full((*shape, N_ABSTRACT_ACTIONS), np.inf, np.float32)
        end_of_map = end[0] - low[0], end[1] - low[1]
        for heading in range(ABSTRACT_HEADINGS):
            states = np.argwhere(wanted[heading])
            places, costs = states + (first_x - low[0], first_y - low[1]), edges[heading][wanted[heading]]
            actions = np.arange(N_ABSTRACT_ACTIONS) + heading * N_ABSTRACT_ACTIONS
            find_costs(
                ground, self._cells, known, heading, places, end_of_map, self._actions, actions, *self._prices, costs
            )
            edges[heading][wanted[heading]] = costs
            yield
        return edges

    def affected(self, changed: np.ndarray) -> np.ndarray:
        """See `LocalCosts.affected`: a square around the changed cells, for all headings."""
        from scipy.ndimage import maximum_filter  # half a second to import

        changed, size, reach = np.asarray(changed, bool), CELLS_PER_ABSTRACT, self._reach()
        nx, ny = abstract_shape(changed.shape)
        result = np.zeros((ABSTRACT_HEADINGS, nx, ny), bool)
        if changed.any():
            # Only ground around the change is looked at.
            (low_x, end_x), (low_y, end_y) = (_span(np.asarray(changed.any(axis=axis)), reach) for axis in (1, 0))
            part = changed[low_x * size : end_x * size, low_y * size : end_y * size]
            # A cell's height range covers one height map cell beyond it.
            near = maximum_filter(part, 3, mode="constant", cval=False)
            end_x, end_y = min(end_x, nx), min(end_y, ny)
            near = near[: (end_x - low_x) * size, : (end_y - low_y) * size]
            touched = near.reshape(end_x - low_x, size, end_y - low_y, size).any(axis=(1, 3))
            seen = maximum_filter(touched, 2 * reach + 1, mode="constant", cval=False)
            result[:, low_x:end_x, low_y:end_y] = seen
        return result

    def _reach(self) -> int:
        """Largest distance, in 10 cm cells, between a state and a cell that affects its actions."""
        return _margin_cells(self._pose_reach()) + int(np.abs(ABSTRACT_ACTIONS[:, :2]).max())

    def _pose_reach(self) -> float:
        """Largest distance (m) between the base and ground that affects a pose."""
        feet = np.abs(self.robot.neutral_feet()).max(axis=0)
        corners = [(max(abs(box.x_min), abs(box.x_max)), box.half_width) for box in self.robot.body.boxes]
        corners += [feet + self.settings.margin, feet + (self.settings.foot_reach, 0.0)]
        return max(math.hypot(*corner) for corner in corners)

    def predict(self, patches: np.ndarray, goals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `TaskPredictor.predict`.

        For a patch cut at heading 0 the result equals `edges`; at other headings the coarse cells lie differently.
        """
        goals = checked_tasks(patches, goals)
        # The robot's place in its patch block equals its place in its abstract cell on a map.
        center, first = divmod(PATCH_CENTER - ABSTRACT_ANCHOR, CELLS_PER_ABSTRACT)
        features = coarse_features(np.asarray(patches, np.float32)[:, first:, first:])
        distinct, which = np.unique(goals.reshape(-1, 3), axis=0, return_inverse=True)
        which = which.reshape(goals.shape[:2])
        tables = self._goals(distinct, distinct, self._flat.costs(distinct))
        cost, place = np.full(goals.shape[:2], np.inf, np.float32), np.array([[center, center]])
        for index, chosen in enumerate(which):
            ground = _ground(Features(*(values[index] for values in features)), self.robot, None)
            known, row = Known.nothing(*ground.tops.shape), cost[index : index + 1]
            find_costs(ground, self._cells, known, 0, place, ground.tops.shape, tables, chosen, *self._prices, row)
        return np.isfinite(cost), cost

    @cached_property
    def _cells(self) -> CoarsePoseCells:
        robot, settings = self.robot, self.settings
        feet, reach = robot.neutral_feet(), np.array([settings.foot_reach, 0.0])
        length, width = np.abs(feet).max(axis=0)
        under, around, body, places = [], [], [], []
        for heading in range(ABSTRACT_HEADINGS):
            rotated = rotation(float(heading_angle(heading, ABSTRACT_HEADINGS)))
            under.append([[_cell(rotated @ place) for place in (foot, foot + reach, foot - reach)] for foot in feet])
            longer, wider = length + settings.margin, width + settings.margin
            around.append(_cells_in(-longer, longer, wider, rotated))
            below = [(box.above, _cells_in(box.x_min, box.x_max, box.half_width, rotated)) for box in robot.body.boxes]
            body.append([cell for _, each in below for cell in each])
            places.append([(*_place(cell, rotated), above) for above, each in below for cell in each])
        limits = np.array([length, width, *robot.slope.steepest()])
        feet_cells, (near, nears), (low, lows) = np.array(under), filled(around, 2, np.int64), filled(body, 2, np.int64)
        at = filled(places, 3, np.float64)[0]
        farthest = [
            [max(abs(x) for x, _, _ in each), max(abs(y) for _, y, _ in each), min(z for *_, z in each)]
            if each
            else [0.0, 0.0, math.inf]
            for each in places
        ]
        return CoarsePoseCells(feet_cells, near, nears, low, at, lows, np.array(farthest), limits)

    @cached_property
    def _actions(self) -> Goals:
        """All actions, heading by heading."""
        goals = np.concatenate([robot_frame_goals(heading) for heading in range(ABSTRACT_HEADINGS)])
        return self._goals(np.tile(ABSTRACT_ACTIONS, (ABSTRACT_HEADINGS, 1)), goals, self._flat.edge_table.ravel())

    def _goals(self, moves: np.ndarray, goals: np.ndarray, flat: np.ndarray) -> Goals:
        """Tables of goals [n, 3] with ``moves`` [n, 3] in the map frame and costs [n] on flat ground."""
        met, counts = filled([_cells_on_the_way(dx, dy) for dx, dy, _ in moves.tolist()], 2, np.int64)
        deviation = np.abs(np.arctan2(goals[:, 1], goals[:, 0]))
        along = np.minimum(deviation, np.pi - deviation) <= self.settings.step_deviation
        turns = np.rint(moves[:, 2]).astype(np.int64)
        return Goals(met, counts, turns, along & (goals[:, 2] == 0), np.ascontiguousarray(flat, np.float32))

    @cached_property
    def _prices(self) -> tuple[np.float32, float]:
        return np.float32(self.settings.unevenness_cost), float(self.settings.step_cost)


def coarse_features(heights: np.ndarray) -> Features:
    """Features for all whole 10 cm cells in height maps.

    Args:
        heights: float32 [..., nx, ny], metres, NaN = unknown; coarse cells are blocks of 4 x 4 from cell (0, 0) on.
    """
    size = CELLS_PER_ABSTRACT
    nx, ny = heights.shape[-2] // size, heights.shape[-1] // size
    around = [(0, 0)] * (heights.ndim - 2)
    rimmed = np.pad(heights, [*around, (1, 1), (1, 1)], constant_values=np.nan)
    windows = sliding_window_view(rimmed, (size + 2, size + 2), axis=(-2, -1))
    windows = windows[..., : nx * size : size, : ny * size : size, :, :]
    blocks = windows[..., 1:-1, 1:-1]
    # A block with an unknown cell is unknown ground: its mean is NaN. fmax and fmin ignore NaN.
    ground = blocks.mean(axis=(-2, -1))
    largest, least = np.fmax.reduce(windows, axis=(-2, -1)), np.fmin.reduce(windows, axis=(-2, -1))
    return Features(largest - least, ground, np.fmax.reduce(blocks, axis=(-2, -1)))


def _features_in(heights: np.ndarray, region: Region) -> Features:
    """Features of a map, cut to a region; the region may end beyond the map."""
    # Height ranges take in a rim of one height map cell, which the cut adds as a coarse cell.
    low = [max(at - 1, 0) for at in region[:2]]
    part = tuple(
        slice(first * CELLS_PER_ABSTRACT, (end + 1) * CELLS_PER_ABSTRACT)
        for first, end in zip(low, region[2:], strict=True)
    )
    x, y = (slice(at - first, end - first) for at, first, end in zip(region[:2], low, region[2:], strict=True))
    return Features(*(values[x, y] for values in coarse_features(heights[part])))


def _ground(features: Features, robot: Robot, reach: int | None) -> CoarseGround:
    """Terrain for kernels, with the highest ground within ``reach`` cells; None leaves it unbounded."""
    ranges, wall, edge = features.height_range, np.float32(robot.step.max_height), np.float32(robot.drive.highest_edge)
    rounding = height_tolerance(features.top)
    walls = np.isnan(features.ground) | (ranges > wall + rounding)
    tops, heights = np.ascontiguousarray(features.top), np.ascontiguousarray(features.ground)
    near = np.full_like(tops, np.inf)
    if reach is not None:
        from scipy.ndimage import maximum_filter  # half a second to import

        known = np.where(np.isnan(tops), np.float32(-np.inf), tops)
        near = maximum_filter(known, 2 * reach + 1, mode="constant", cval=-np.inf)
    return CoarseGround(walls, ranges > edge + rounding, np.nan_to_num(ranges), tops, heights, near)


def _cells_on_the_way(dx: float, dy: float) -> list[tuple[int, int]]:
    """Distinct start, middle and end cells, relative to the start, for a move by (dx, dy) cells."""
    middle = {(x, y) for x in _nearest_to(dx / 2) for y in _nearest_to(dy / 2)}
    return list(dict.fromkeys([(0, 0), *sorted(middle), (round(dx), round(dy))]))


def _nearest_to(value: float) -> set[int]:
    """Nearest integer, or both integers at a tie, so that left and right are equivalent."""
    return {int(np.ceil(value - 0.5)), int(np.floor(value + 0.5))}


def _cells_in(x_min: float, x_max: float, half_width: float, rotated: np.ndarray) -> list[tuple[int, int]]:
    """Relative cells with their centres in a robot-frame rectangle (m), rotated by the matrix ``rotated``."""
    reach = math.ceil(_in_cells(math.hypot(max(abs(x_min), abs(x_max)), half_width)))
    cells = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1).T
    x, y = (cells @ rotated).T
    least, most, half = (_in_cells(length) for length in (x_min, x_max, half_width))
    inside = (x >= least - 1e-9) & (x <= most + 1e-9) & (np.abs(y) <= half + 1e-9)
    return [tuple(cell) for cell in cells[inside].tolist()]


def _cell(position: np.ndarray) -> tuple[int, int]:
    """Relative cell at a position in metres from the base cell's centre; ties go outward."""
    scaled = abstract_steps([*position, 0.0])[:2]
    x, y = np.copysign(np.floor(np.abs(scaled) + 0.5 + 1e-9), scaled).astype(int).tolist()
    return x, y


def _place(cell: tuple[int, int], rotated: np.ndarray) -> list[float]:
    """Place of a relative cell in the robot frame, m."""
    return abstract_steps_to_world([*(rotated.T @ cell), 0.0])[:2].tolist()


def _span(rows: np.ndarray, reach: int) -> tuple[int, int]:
    """First and end coarse row within ``reach`` of marked height map rows, and one more on each side; not before 0."""
    at = np.flatnonzero(rows)
    return max(int(at[0]) // CELLS_PER_ABSTRACT - reach - 1, 0), int(at[-1]) // CELLS_PER_ABSTRACT + reach + 2


def _in_cells(length: float) -> float:
    return float(abstract_steps((length, 0.0, 0.0))[0])


def _margin_cells(reach: float) -> int:
    return math.ceil(_in_cells(reach)) + 1
