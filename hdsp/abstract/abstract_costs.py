"""The contract of abstract costs, and its simplest fulfilment.

An abstraction says of each of the 22 abstract actions from each abstract state whether it can be done and what it
costs, as the detailed planner would. There are two ways to ask. Whole maps (`AbstractCosts`) serve planning: Dijkstra
and the heuristics know nothing else about an abstraction. Single tasks (`TaskPredictor`) serve evaluation.
"""

from __future__ import annotations

import functools
from typing import Protocol, runtime_checkable

import numpy as np

from hdsp.abstract.oracle import LabelSettings, task_costs
from hdsp.abstract.transform import feet_at
from hdsp.base.errors import InputError
from hdsp.detailed.world.world import build_world
from hdsp.robot.lattice import (
    ABSTRACT_ACTIONS,
    ABSTRACT_HEADINGS,
    HEADINGS_PER_ABSTRACT,
    N_ABSTRACT_ACTIONS,
    PATCH_CELLS,
    PATCH_CENTER,
    abstract_shape,
    robot_frame_goals,
)
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap

#: A rectangle of abstract cells: (first ix, first iy, end ix, end iy), the ends excluded.
Region = tuple[int, int, int, int]


@runtime_checkable
class AbstractCosts(Protocol):
    """Costs of all abstract actions on a map.

    Learned, manual, flat-ground and oracle (detailed planner) costs implement it; Dijkstra, heuristics and evaluation
    know only this. An implementation is bound to one robot and keeps no state of any map.
    """

    def edges(self, height_map: HeightMap, region: Region | None = None, mask: np.ndarray | None = None) -> np.ndarray:
        """Costs of the 22 abstract actions from every abstract state.

        Convention: the result is indexed `[heading, ix, iy, action]`, states and actions in the frame of the map (not
        of the robot). `edges[k, a, b, m]` is the cost of `hdsp.robot.lattice.ABSTRACT_ACTIONS[m] = (dx, dy, dtheta)` from
        abstract state (a, b, k), which leads to (a + dx, b + dy, (k + dtheta) % 16).

        Args:
            height_map: the terrain; NaN = unknown. Its abstract cells are blocks of 4 x 4 cells, what is left over at
                the upper borders belongs to none.
            region: compute only the states in this rectangle of abstract cells; None = the whole map. Actions may lead
                out of the region.
            mask: bool, shape of the result without actions: the states worth evaluating, for instance those at which
                the robot can stand. From all others every action is infeasible. None = all.

        Returns:
            float32 [16, nx, ny, 22], `(nx, ny) = abstract_shape(height_map.shape)` or the size of the region. Costs are
            >= 0 and never NaN; inf = infeasible. Actions that lead off the map are infeasible.

        Raises:
            InputError: the region is empty or not within the map, or the mask has another shape.
        """
        ...


@runtime_checkable
class LocalCosts(AbstractCosts, Protocol):
    """Costs that say which states a change of the map can touch, so that the others need not be computed again."""

    def affected(self, changed: np.ndarray) -> np.ndarray:
        """The states with an action whose cost may change.

        Args:
            changed: bool [nx, ny], the cells of a height map whose heights change.

        Returns:
            bool [16, nx // 4, ny // 4].
        """
        ...


@runtime_checkable
class TaskPredictor(Protocol):
    """Judges single tasks: patches with goals."""

    def predict(self, patches: np.ndarray, goals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Feasibility and cost of the 22 tasks of each patch.

        Convention: patches and goals are in the frame of the robot, which stands at the centre of patch cell (36, 36)
        and looks along axis 0; see `hdsp.terrain.height_map`.

        Args:
            patches: float32 [n, 72, 72], heights in metres, NaN = unknown.
            goals: float32 [n, 22, 3], (dx, dy, dtheta) in abstract steps of 10 cm and 22.5 degrees.

        Returns:
            feasible bool [n, 22]; cost float32 [n, 22], finite where feasible, without meaning elsewhere.

        Raises:
            InputError: shapes do not fit.
        """
        ...


class FlatCosts:
    """The flat-ground baseline: every action is feasible and costs what it costs on flat ground, whatever the terrain.

    What an abstraction adds to this is what it knows about terrain. Implements `LocalCosts` and `TaskPredictor`.
    """

    def __init__(self, robot: Robot | str):
        """`robot` is a robot, or what `Robot.load` takes."""
        self.robot = Robot.load(robot)
        #: Float32 [16, 22], cost of each action from each heading.
        self.table = flat_table(self.robot)

    def edges(self, height_map: HeightMap, region: Region | None = None, mask: np.ndarray | None = None) -> np.ndarray:
        """See `AbstractCosts.edges`."""
        first_x, first_y, end_x, end_y = checked_region(height_map, region)
        shape = (ABSTRACT_HEADINGS, end_x - first_x, end_y - first_y, N_ABSTRACT_ACTIONS)
        edges = np.broadcast_to(self.table[:, None, None], shape).copy()
        close_states(edges, mask)
        close_exits(edges, height_map, region)
        return edges

    def affected(self, changed: np.ndarray) -> np.ndarray:
        """See `LocalCosts.affected`: none."""
        return np.zeros((ABSTRACT_HEADINGS, *abstract_shape(np.shape(changed))), bool)

    def predict(self, patches: np.ndarray, goals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `TaskPredictor.predict`."""
        goals = checked_tasks(patches, goals)
        return np.ones(goals.shape[:-1], bool), self.costs(goals)

    def costs(self, goals: np.ndarray) -> np.ndarray:
        """Flat cost, float32 [...], of goals [..., 3] in the robot frame: that of the nearest known task."""
        # Turned into the frame of the robot, the actions of all headings are the tasks whose flat cost is known.
        known = np.concatenate([robot_frame_goals(heading) for heading in range(ABSTRACT_HEADINGS)])
        distinct, which = np.unique(np.reshape(goals, (-1, 3)), axis=0, return_inverse=True)
        nearest = np.linalg.norm(distinct[:, None] - known, axis=-1).argmin(axis=1)
        return self.table.reshape(-1)[nearest][which].reshape(np.shape(goals)[:-1])


@functools.lru_cache(maxsize=16)
def flat_table(robot: Robot) -> np.ndarray:
    """Costs on flat ground, float32 [16, 22] by heading and action: labels of a flat map, as any map is labelled.

    A turn of the robot by 90 degrees only permutes the actions, so that four headings are searched.
    """
    world = build_world(HeightMap.flat((PATCH_CELLS, PATCH_CELLS)), robot)
    table = np.empty((ABSTRACT_HEADINGS, N_ABSTRACT_ACTIONS), np.float32)
    quarter = ABSTRACT_HEADINGS // 4
    for heading in range(quarter):
        start = feet_at(world, (PATCH_CENTER, PATCH_CENTER, heading * HEADINGS_PER_ABSTRACT))
        costs = np.full(N_ABSTRACT_ACTIONS, np.inf) if start is None else task_costs(world, start, LabelSettings())[1]
        if np.isinf(costs).any():
            raise InputError(f"robot {robot.name}: some abstract action is infeasible even on flat ground")
        table[heading] = costs
    index = {tuple(action): m for m, action in enumerate(ABSTRACT_ACTIONS.tolist())}
    for heading in range(quarter, ABSTRACT_HEADINGS):
        # What this action is to this heading, the action turned back by 90 degrees is to the heading before.
        turned_back = [index[dy, -dx, turn] for dx, dy, turn in ABSTRACT_ACTIONS.tolist()]
        table[heading] = table[heading - quarter, turned_back]
    table.flags.writeable = False
    return table


def checked_region(height_map: HeightMap, region: Region | None) -> Region:
    """The region, or that of the whole map; raises InputError where it is empty or leaves the map."""
    nx, ny = abstract_shape(height_map.shape)
    if region is None:
        region = (0, 0, nx, ny)
    first_x, first_y, end_x, end_y = (int(value) for value in region)
    if not (0 <= first_x < end_x <= nx and 0 <= first_y < end_y <= ny):
        raise InputError(
            f"region {tuple(region)}: need (first ix, first iy, end ix, end iy), not empty, "
            f"within {nx} x {ny} abstract cells"
        )
    return first_x, first_y, end_x, end_y


def close_exits(edges: np.ndarray, height_map: HeightMap, region: Region | None = None) -> None:
    """Makes the actions infeasible that lead off the map. `edges` is [16, nx, ny, 22] of the region, and changed."""
    nx, ny = abstract_shape(height_map.shape)
    first_x, first_y, end_x, end_y = checked_region(height_map, region)
    to_x = np.arange(first_x, end_x)[:, None] + ABSTRACT_ACTIONS[:, 0]
    to_y = np.arange(first_y, end_y)[:, None] + ABSTRACT_ACTIONS[:, 1]
    edges[:, ((to_x < 0) | (to_x >= nx))[:, None, :] | ((to_y < 0) | (to_y >= ny))[None, :, :]] = np.inf


def close_states(edges: np.ndarray, mask: np.ndarray | None) -> None:
    """Makes all actions infeasible that start where ``mask`` is false. ``edges`` is changed.

    Raises:
        InputError: the mask does not have the shape of the states.
    """
    if mask is not None:
        edges[~checked_mask(mask, edges.shape[:3])] = np.inf


def checked_mask(mask: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The mask as bool array; raises InputError where its shape is not that of the abstract states."""
    mask = np.asarray(mask, bool)
    if mask.shape != tuple(shape):
        raise InputError(f"mask: shape {mask.shape} is not that of the abstract states, {tuple(shape)}")
    return mask


def checked_tasks(patches: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """The goals as float array; raises InputError where the shapes of the two do not fit the contract."""
    patches, goals = np.asarray(patches), np.asarray(goals, dtype=float)
    cells = (PATCH_CELLS, PATCH_CELLS)
    if patches.ndim != 3 or patches.shape[1:] != cells or goals.shape != (len(patches), N_ABSTRACT_ACTIONS, 3):
        raise InputError(
            f"tasks: patches have shape {patches.shape} and goals {goals.shape}, "
            f"expected (n, {PATCH_CELLS}, {PATCH_CELLS}) and (n, {N_ABSTRACT_ACTIONS}, 3)"
        )
    return goals
