"""Labels of a map: a patch as network input, its 22 goals, and their labels from the detailed planner.

Source: paper, Sec. V-C.
"""

from typing import NamedTuple

import numpy as np

from hdsp.abstract.flat_table import cost_limit
from hdsp.abstract.oracle import CostKind, LabelSettings, task_costs
from hdsp.abstract.transform import feet_at
from hdsp.base.errors import InputError
from hdsp.base.short_repr import short_repr
from hdsp.detailed.search.outcome import Status
from hdsp.detailed.world.world import build_world
from hdsp.robot.lattice import (
    ABSTRACT_ACTIONS,
    HEADINGS,
    HEADINGS_PER_ABSTRACT,
    N_ABSTRACT_ACTIONS,
    PATCH_CELLS,
    Grid,
    robot_frame_goals,
)
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap

__all__ = ["LabelSettings", "MapTasks", "label_map", "label_unstandable"]


class MapTasks(NamedTuple):
    """The 22 tasks from one start state, with their labels.

    Convention: patch and goals in the robot frame; see ``hdsp.terrain.height_map`` and
    ``hdsp.robot.lattice.robot_frame_goals``.

    Attributes:
        heights: float32 [72, 72], m, NaN = unknown.
        goals: float32 [22, 3], abstract steps.
        feasible: bool [22].
        cost: float32 [22], 0 where infeasible.
        reason: uint8 [22], ``Status`` of each task's search.
        start: float32 [7], detailed start state in the world: m, m, rad, 4 x m.
        goal: float32 [22, 7], detailed goal states; feet NaN-free, neutral where no state is valid.
        planning_cost: float32 [22], cost for planning, 0 where infeasible; None without ``settings.planning_costs``.
    """

    heights: np.ndarray
    goals: np.ndarray
    feasible: np.ndarray
    cost: np.ndarray
    reason: np.ndarray
    start: np.ndarray
    goal: np.ndarray
    planning_cost: np.ndarray | None = None

    def __repr__(self) -> str:
        return short_repr(self)


def label_map(
    terrain: HeightMap, robot: Robot, settings: LabelSettings | None = None, start_heading: int = 0
) -> MapTasks | None:
    """Labels the 22 tasks that start in the middle cell of a map.

    Args:
        terrain: at least 72 x 72 cells; the base starts in cell (nx // 2, ny // 2).
        robot: the robot whose planner makes the labels.
        settings: labelling rules.
        start_heading: detailed start heading, a multiple of 4 in [0, 64).

    Returns:
        The tasks, or None if no valid start state exists.

    Raises:
        InputError: if the map is smaller than a patch, or the heading is no abstract heading.
    """
    base = start_base(terrain, start_heading)
    world = build_world(terrain, robot)
    start = feet_at(world, base)
    if start is None:
        return None
    settings = settings or LabelSettings()
    limit = cost_limit(robot, settings)
    tasks = _map_tasks(terrain, base, start, *(labels := task_costs(world, start, settings, limit)))
    if not settings.planning_costs:
        return tasks
    _, cost, _ = labels
    planning = np.zeros_like(tasks.cost)
    feasible = np.flatnonzero(tasks.feasible)
    if len(feasible):
        actions, known = ABSTRACT_ACTIONS[feasible], cost[feasible]
        planning[feasible] = task_costs(world, start, settings, limit, actions, CostKind.PLANNING, at_most=known)[1]
    return tasks._replace(planning_cost=planning)


def label_unstandable(
    terrain: HeightMap, robot: Robot, settings: LabelSettings | None = None, start_heading: int = 0
) -> MapTasks | None:
    """Labels the 22 tasks of a map where the robot cannot stand in the middle cell: all tasks are infeasible.

    Arguments and errors as for `label_map`; nothing is searched.

    Returns:
        The tasks, with start and goals at the start base with neutral feet; None if a valid start state exists.
    """
    base = start_base(terrain, start_heading)
    if feet_at(build_world(terrain, robot), base) is not None:
        return None
    start = np.array([*base, 0, 0, 0, 0])
    goals, cost = np.tile(start, (N_ABSTRACT_ACTIONS, 1)), np.full(N_ABSTRACT_ACTIONS, np.inf)
    tasks = _map_tasks(terrain, base, start, goals, cost, np.full(N_ABSTRACT_ACTIONS, Status.INVALID_START))
    planned = settings is not None and settings.planning_costs
    return tasks._replace(planning_cost=np.zeros_like(tasks.cost)) if planned else tasks


def start_base(terrain: HeightMap, start_heading: int) -> tuple[int, int, int]:
    """Detailed base state from which a map's tasks start."""
    if min(terrain.shape) < PATCH_CELLS:
        raise InputError(
            f"map of {terrain.shape[0]} x {terrain.shape[1]} cells: labels need at least {PATCH_CELLS} x {PATCH_CELLS}"
        )
    if start_heading % HEADINGS_PER_ABSTRACT or not 0 <= start_heading < HEADINGS:
        raise InputError(
            f"start heading {start_heading}: need a multiple of {HEADINGS_PER_ABSTRACT} in [0, {HEADINGS})"
        )
    return terrain.shape[0] // 2, terrain.shape[1] // 2, start_heading


def _map_tasks(
    terrain: HeightMap,
    base: tuple[int, int, int],
    start: np.ndarray,
    goals: np.ndarray,
    cost: np.ndarray,
    reason: np.ndarray,
) -> MapTasks:
    """Tasks from detailed start and goal states and search results."""
    grid = Grid(terrain.origin, terrain.shape)
    feasible = reason == Status.SOLVED
    return MapTasks(
        heights=terrain.crop_cells(*base).heights,
        goals=robot_frame_goals(base[2] // HEADINGS_PER_ABSTRACT),
        feasible=feasible,
        cost=np.where(feasible, cost, 0).astype(np.float32),
        reason=reason.astype(np.uint8),
        start=grid.to_world(start).astype(np.float32),
        goal=grid.to_world(goals).astype(np.float32),
    )
