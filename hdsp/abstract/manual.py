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
from functools import reduce
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from hdsp.abstract.abstract_costs import FlatCosts, Region, checked_region, checked_tasks, close_exits, close_states
from hdsp.abstract.oracle import CostKind
from hdsp.base.gradual import Steps, finished
from hdsp.base.settings import NotNegative, checked
from hdsp.robot.lattice import (
    ABSTRACT_ACTIONS,
    ABSTRACT_ANCHOR,
    ABSTRACT_HEADINGS,
    CELLS_PER_ABSTRACT,
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

_LONGEST = int(np.abs(ABSTRACT_ACTIONS[:, :2]).max())  # move of an action, abstract cells


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


class _PoseTerrain(NamedTuple):
    """Terrain at poses, each [...]; one row per foot where noted."""

    blocked: np.ndarray
    on_step: np.ndarray  # [4, ...]
    on_wall: np.ndarray
    unevenness: np.ndarray


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

    def edges(self, height_map: HeightMap, region: Region | None = None, mask: np.ndarray | None = None) -> np.ndarray:
        """See `AbstractCosts.edges`."""
        return finished(self.edge_steps(height_map, region, mask))

    def edge_steps(
        self, height_map: HeightMap, region: Region | None = None, mask: np.ndarray | None = None
    ) -> Steps[np.ndarray]:
        """See `GradualCosts.edge_steps`."""
        first_x, first_y, end_x, end_y = checked_region(height_map, region)
        reach = self._reach()
        # The region is enlarged by the reach of its states.
        low_x, low_y = max(first_x - reach, 0), max(first_y - reach, 0)
        features = _features_in(height_map.heights, (low_x, low_y, end_x + reach, end_y + reach))
        poses = []
        for heading in range(ABSTRACT_HEADINGS):
            poses.append(self._poses(features, heading))
            yield
        edges = np.empty((ABSTRACT_HEADINGS, *features.ground.shape, len(ABSTRACT_ACTIONS)), np.float32)
        for heading in range(ABSTRACT_HEADINGS):
            wrapped = _take(poses[heading], _wrapped)
            for action, goal in enumerate(robot_frame_goals(heading)):
                dx, dy, turn = ABSTRACT_ACTIONS[action].tolist()
                # Values from the other side belong to actions off the map, closed below, or to states outside the
                # region.
                met = [_take(wrapped, _moved, x, y) for x, y in _cells_on_the_way(dx, dy)]
                if turn:
                    met.append(poses[(heading + turn) % ABSTRACT_HEADINGS])
                edges[heading, :, :, action] = self._cost(self._flat.edge_table[heading, action], goal, met)
            yield
        edges = np.ascontiguousarray(edges[:, first_x - low_x : end_x - low_x, first_y - low_y : end_y - low_y])
        close_states(edges, mask)
        close_exits(edges, height_map, region)
        return edges

    def affected(self, changed: np.ndarray) -> np.ndarray:
        """See `LocalCosts.affected`: a square around the changed cells, for all headings."""
        from scipy.ndimage import maximum_filter  # half a second to import

        size = CELLS_PER_ABSTRACT
        nx, ny = abstract_shape(np.shape(changed))
        # A cell's height range covers one height map cell beyond it.
        near = maximum_filter(np.asarray(changed, bool), 3, mode="constant", cval=False)
        touched = near[: nx * size, : ny * size].reshape(nx, size, ny, size).any(axis=(1, 3))
        seen = maximum_filter(touched, 2 * self._reach() + 1, mode="constant", cval=False)
        return np.repeat(seen[None], ABSTRACT_HEADINGS, axis=0)

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
        poses = {turn: self._poses(features, turn) for turn in {0, *(round(turn) for turn in distinct[:, 2].tolist())}}
        cost = np.empty(goals.shape[:2], np.float32)
        for index, goal in enumerate(distinct):
            dx, dy, turn = goal.tolist()
            met = [_take(poses[0], _one_cell, center + x, center + y) for x, y in _cells_on_the_way(dx, dy)]
            if turn:
                met.append(_take(poses[round(turn)], _one_cell, center, center))
            cost = np.where(which == index, self._cost(self._flat.costs(goal), goal, met)[:, None], cost)
        return np.isfinite(cost), cost.astype(np.float32)

    def _cost(self, flat: np.ndarray, goal: np.ndarray, met: list[_PoseTerrain]) -> np.ndarray:
        """Costs [...] for `goal` (robot frame, abstract steps) through poses [...]; inf = infeasible.

        ``flat`` is its cost on flat ground.
        """
        settings = self.settings
        dx, dy, turn = goal
        deviation = abs(np.arctan2(dy, dx))
        may_step = turn == 0 and min(deviation, np.pi - deviation) <= settings.step_deviation
        stepping = np.any([poses.on_step for poses in met], axis=0)
        infeasible = np.any([poses.blocked for poses in met], axis=0)
        infeasible |= np.any([poses.on_wall for poses in met], axis=(0, 1))
        if not may_step:
            infeasible |= stepping.any(axis=0)
        uneven = np.mean([poses.unevenness for poses in met], axis=0)
        cost = flat * (1 + settings.unevenness_cost * uneven)
        return np.where(infeasible, np.inf, cost + settings.step_cost * stepping.sum(axis=0))

    def _poses(self, features: Features, heading: int) -> _PoseTerrain:
        """Terrain under the robot with its base in each cell, at one heading (index of 16)."""
        robot, settings = self.robot, self.settings
        rotated = rotation(float(heading_angle(heading, ABSTRACT_HEADINGS)))
        margin = _Margin(features, self._pose_reach())

        walls = margin.of(_is_wall(features, robot), outside=True)
        edges = margin.of(features.height_range > robot.drive.highest_edge, outside=True)
        ranges = margin.of(np.nan_to_num(features.height_range), outside=0.0)
        tops = margin.of(features.top, outside=np.nan)

        feet = robot.neutral_feet()
        ground, ahead, left = self._ground_plane(margin.of(features.ground, outside=np.nan), margin, rotated)
        blocked = np.zeros(features.ground.shape, bool)
        for box in robot.body.boxes:
            for cell in _cells_in(box.x_min, box.x_max, box.half_width, rotated):
                x, y, _ = abstract_steps_to_world([*(rotated.T @ cell), 0.0])
                blocked |= margin.shifted(tops, cell) - (ground + x * ahead + y * left) > box.above
        on_wall, on_step = [], []
        reach = np.array([settings.foot_reach, 0.0])
        for foot in feet:
            here, *near = (_cell(rotated @ place) for place in (foot, foot + reach, foot - reach))
            on_wall.append(margin.shifted(walls, here))
            on_step.append(margin.shifted(edges, here) & ~on_wall[-1])
            blocked |= on_step[-1] & np.all([margin.shifted(edges, cell) for cell in near], axis=0)
        length, width = np.abs(feet).max(axis=0) + settings.margin
        around = _cells_in(-length, length, width, rotated)
        uneven = reduce(np.add, (margin.shifted(ranges, cell) for cell in around)) / len(around)
        return _PoseTerrain(blocked, np.array(on_step), np.array(on_wall), uneven)

    def _ground_plane(self, grounds: np.ndarray, margin: _Margin, rotated: np.ndarray) -> tuple[np.ndarray, ...]:
        """Plane through the ground under the neutral feet, as in `hdsp.detailed.base_pose`.

        Returns:
            Height under the base centre (m), gradient ahead, gradient to the left, each [nx, ny].
        """
        feet = self.robot.neutral_feet()
        steepest_ahead, steepest_left = self.robot.slope.steepest()
        length, width = np.abs(feet).max(axis=0)
        z = [margin.shifted(grounds, _cell(rotated @ foot)) for foot in feet]
        ahead = (z[0] + z[3] - z[1] - z[2]) / (4 * length)
        left = (z[0] + z[1] - z[2] - z[3]) / (4 * width)
        ahead, left = np.clip(ahead, -steepest_ahead, steepest_ahead), np.clip(left, -steepest_left, steepest_left)
        return (z[0] + z[1] + z[2] + z[3]) / 4, ahead, left


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


def _is_wall(features: Features, robot: Robot) -> np.ndarray:
    return np.isnan(features.ground) | (features.height_range > robot.step.max_height)


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


def _one_cell(values: np.ndarray, x: int, y: int) -> np.ndarray:
    return values[..., x, y]


def _wrapped(values: np.ndarray) -> np.ndarray:
    """Values [..., nx, ny] with a border of values from the other side, as wide as the longest move."""
    return np.pad(values, [(0, 0)] * (values.ndim - 2) + [(_LONGEST, _LONGEST)] * 2, mode="wrap")


def _moved(wrapped: np.ndarray, x: int, y: int) -> np.ndarray:
    """Values at an offset from each cell, a view, from ``_wrapped`` ones."""
    nx, ny = wrapped.shape[-2] - 2 * _LONGEST, wrapped.shape[-1] - 2 * _LONGEST
    return wrapped[..., _LONGEST + x : _LONGEST + x + nx, _LONGEST + y : _LONGEST + y + ny]


def _in_cells(length: float) -> float:
    return float(abstract_steps((length, 0.0, 0.0))[0])


def _margin_cells(reach: float) -> int:
    return math.ceil(_in_cells(reach)) + 1


def _take(poses: _PoseTerrain, take, *arguments) -> _PoseTerrain:
    return _PoseTerrain(*(take(values, *arguments) for values in poses))


class _Margin:
    """Reads maps at an offset from each cell; a margin supplies values outside the map."""

    def __init__(self, features: Features, reach: float):
        self.cells = _margin_cells(reach)
        self.shape = features.ground.shape[-2:]

    def of(self, values: np.ndarray, outside) -> np.ndarray:
        around = [(0, 0)] * (values.ndim - 2)
        return np.pad(values, [*around, (self.cells,) * 2, (self.cells,) * 2], constant_values=outside)

    def shifted(self, values: np.ndarray, cell: tuple[int, int]) -> np.ndarray:
        """Returns, for each cell, the value at offset `cell`."""
        x, y = (self.cells + step for step in cell)
        return values[..., x : x + self.shape[0], y : y + self.shape[1]]
