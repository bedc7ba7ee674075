"""Contract for abstract costs, and its simplest implementation.

For each of the 22 abstract actions from each abstract state, an abstraction predicts feasibility and cost, as the
detailed planner would find them. `AbstractCosts` covers whole maps and serves planning: Dijkstra and the heuristics use
no other interface. `TaskPredictor` covers single tasks and serves evaluation.
"""

from __future__ import annotations

from typing import Protocol, Self, runtime_checkable

import numpy as np

from hdsp.abstract.flat_table import flat_table
from hdsp.abstract.oracle import CostKind, checked_kind
from hdsp.base.errors import InputError
from hdsp.base.gradual import Steps
from hdsp.base.messages import shown
from hdsp.base.scalars import integers
from hdsp.robot.lattice import (
    ABSTRACT_ACTIONS,
    ABSTRACT_HEADINGS,
    N_ABSTRACT_ACTIONS,
    PATCH_CELLS,
    abstract_shape,
    robot_frame_goals,
)
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap

#: Rectangle of abstract cells: (first ix, first iy, end ix, end iy), ends excluded.
Region = tuple[int, int, int, int]


@runtime_checkable
class AbstractCosts(Protocol):
    """Costs of all abstract actions on a map.

    Learned, manual, flat-ground and oracle (detailed planner) costs implement this contract; Dijkstra, heuristics and
    evaluation use nothing else. An implementation belongs to one robot and keeps no map state.
    """

    def edges(self, height_map: HeightMap, region: Region | None = None, mask: np.ndarray | None = None) -> np.ndarray:
        """Returns costs for the 22 abstract actions from every abstract state.

        Convention: the result is indexed `[heading, ix, iy, action]`; states and actions are in the map frame, not in
        the robot frame. `edges[k, a, b, m]` is the cost of `hdsp.robot.lattice.ABSTRACT_ACTIONS[m] = (dx, dy, dtheta)`
        from abstract state (a, b, k) to (a + dx, b + dy, (k + dtheta) % 16).

        Args:
            height_map: terrain; NaN = unknown. Abstract cells are blocks of 4 x 4 map cells; remaining cells at the
                upper borders belong to none.
            region: rectangle of abstract cells to compute; None = the whole map. Actions may lead out of the region.
            mask: bool, result shape without actions: states to evaluate, for instance states in which the robot can
                stand. All actions from other states are infeasible. None = all states.

        Returns:
            float32 [16, nx, ny, 22], `(nx, ny) = abstract_shape(height_map.shape)` or the region's size. Costs are >= 0
            and never NaN; inf = infeasible. Actions off the map are infeasible.

        Raises:
            InputError: the region is empty or leaves the map, or the mask has another shape.
        """
        ...


@runtime_checkable
class LocalCosts(AbstractCosts, Protocol):
    """Costs that know which states a map change affects; all other states keep their costs."""

    def affected(self, changed: np.ndarray) -> np.ndarray:
        """Returns the states with an action whose cost may change.

        Args:
            changed: bool [nx, ny], height map cells with changed heights.

        Returns:
            bool [16, nx // 4, ny // 4].
        """
        ...


@runtime_checkable
class GradualCosts(AbstractCosts, Protocol):
    """Costs in short steps, for maps that take seconds: a query with a time limit stops between two steps."""

    def edge_steps(
        self, height_map: HeightMap, region: Region | None = None, mask: np.ndarray | None = None
    ) -> Steps[np.ndarray]:
        """Computes ``edges``: yields None after each step, and returns the result; arguments as for ``edges``."""
        ...


class Memory(Protocol):
    """Parts of the work on a map that later evaluations reuse; results are the same without.

    Attributes:
        most: bytes beyond which parts are dropped.
    """

    most: int

    def nbytes(self) -> int:
        """Bytes of the parts."""
        ...

    def after(self, changed: np.ndarray) -> Self:
        """Returns the parts that a change leaves as they are, and takes them from this object.

        Args:
            changed: bool [nx, ny], height map cells with changed heights.
        """
        ...


@runtime_checkable
class RememberingCosts(AbstractCosts, Protocol):
    """Gradual costs that keep parts of their work on a map: ``edge_steps`` has a further argument ``memory``."""

    def new_memory(self, height_map: HeightMap) -> Memory | None:
        """Returns an empty memory for a map; None if the costs have no use for one."""
        ...


@runtime_checkable
class BoundedCosts(AbstractCosts, Protocol):
    """Costs with known lower bounds: a query evaluates edges only where it needs them.

    Attributes:
        least: float32 [16, 22], costs by heading and action below which hardly any edge lies; edges below count as this
            much. None: no bounds are known.
    """

    least: np.ndarray | None


@runtime_checkable
class TaskPredictor(Protocol):
    """Predicts single tasks: patches with goals."""

    def predict(self, patches: np.ndarray, goals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Predicts feasibility and cost for each patch's 22 tasks.

        Convention: patches and goals are in the robot frame; the robot stands at the centre of patch cell (36, 36) and
        faces along axis 0; see `hdsp.terrain.height_map`.

        Args:
            patches: float32 [n, 72, 72], heights in metres, NaN = unknown.
            goals: float32 [n, 22, 3], (dx, dy, dtheta) in abstract steps of 10 cm and 22.5 degrees.

        Returns:
            feasible bool [n, 22]; cost float32 [n, 22], finite where feasible, meaningless elsewhere.

        Raises:
            InputError: shapes do not fit.
        """
        ...


class FlatCosts:
    """Flat-ground baseline: every action has its flat-ground cost, on any terrain; inf = infeasible on flat ground.

    An abstraction differs from this baseline by its terrain knowledge. Implements `LocalCosts` and `TaskPredictor`:
    edges are costs for planning, predictions are label costs.
    """

    def __init__(self, robot: Robot | str, kind: CostKind | str = CostKind.PLANNING):
        """Sets up the baseline.

        Args:
            robot: a robot, or what `Robot.load` takes.
            kind: kind of costs of the edges.

        Raises:
            InputError: the kind is unknown.
        """
        self.robot = Robot.load(robot)
        #: Float32 [16, 22], label cost of each action from each heading.
        self.table = flat_table(self.robot)
        #: The same, costs of the edges.
        self.edge_table = flat_table(self.robot, None, checked_kind(kind))

    def __repr__(self) -> str:
        return f"FlatCosts({self.robot.name})"

    def edges(self, height_map: HeightMap, region: Region | None = None, mask: np.ndarray | None = None) -> np.ndarray:
        """See `AbstractCosts.edges`."""
        first_x, first_y, end_x, end_y = checked_region(height_map, region)
        shape = (ABSTRACT_HEADINGS, end_x - first_x, end_y - first_y, N_ABSTRACT_ACTIONS)
        edges = np.broadcast_to(self.edge_table[:, None, None], shape).copy()
        close_states(edges, mask)
        close_exits(edges, height_map, region)
        return edges

    def affected(self, changed: np.ndarray) -> np.ndarray:
        """See `LocalCosts.affected`: none."""
        return np.zeros((ABSTRACT_HEADINGS, *abstract_shape(np.shape(changed))), bool)

    def predict(self, patches: np.ndarray, goals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `TaskPredictor.predict`."""
        costs = self.costs(checked_tasks(patches, goals))
        return np.isfinite(costs), costs

    def costs(self, goals: np.ndarray) -> np.ndarray:
        """Returns flat-ground costs, float32 [...], for robot-frame goals [..., 3], from the nearest known task.

        inf = infeasible on flat ground.
        """
        # The known tasks are the actions at all headings, rotated into the robot frame.
        known = np.concatenate([robot_frame_goals(heading) for heading in range(ABSTRACT_HEADINGS)])
        distinct, which = np.unique(np.reshape(goals, (-1, 3)), axis=0, return_inverse=True)
        nearest = np.linalg.norm(distinct[:, None] - known, axis=-1).argmin(axis=1)
        return self.table.reshape(-1)[nearest][which].reshape(np.shape(goals)[:-1])


def checked_region(height_map: HeightMap, region: Region | None) -> Region:
    """Returns the region (None: the whole map); raises InputError if it is empty or leaves the map."""
    nx, ny = abstract_shape(height_map.shape)
    if region is None:
        region = (0, 0, nx, ny)
    first_x, first_y, end_x, end_y = integers(region, 4) or (0, 0, 0, 0)
    if not (0 <= first_x < end_x <= nx and 0 <= first_y < end_y <= ny):
        raise InputError(
            f"region {shown(region)}: need (first ix, first iy, end ix, end iy), not empty, "
            f"within {nx} x {ny} abstract cells"
        )
    return first_x, first_y, end_x, end_y


def edge_steps(
    costs: AbstractCosts,
    height_map: HeightMap,
    mask: np.ndarray,
    region: Region | None = None,
    memory: Memory | None = None,
) -> Steps[np.ndarray]:
    """Computes edges, in steps if the costs are ``GradualCosts``; arguments as for ``edges``.

    ``memory`` comes from ``RememberingCosts``.
    """
    classes = type(costs).__mro__
    whole = next((i for i, cls in enumerate(classes) if "edges" in vars(cls)), len(classes))
    gradual = next((i for i, cls in enumerate(classes) if "edge_steps" in vars(cls)), len(classes))
    # A subclass with other edges has inherited the steps for the edges of its parent.
    if isinstance(costs, GradualCosts) and gradual <= whole and "edges" not in getattr(costs, "__dict__", ()):
        if memory is not None:
            return (yield from costs.edge_steps(height_map, region, mask, memory=memory))  # type: ignore[call-arg]
        return (yield from costs.edge_steps(height_map, region, mask))
    return costs.edges(height_map, region, mask)


def close_exits(edges: np.ndarray, height_map: HeightMap, region: Region | None = None) -> None:
    """Makes actions off the map infeasible; modifies `edges` [16, nx, ny, 22] for the region in place."""
    nx, ny = abstract_shape(height_map.shape)
    first_x, first_y, end_x, end_y = checked_region(height_map, region)
    to_x = np.arange(first_x, end_x)[:, None] + ABSTRACT_ACTIONS[:, 0]
    to_y = np.arange(first_y, end_y)[:, None] + ABSTRACT_ACTIONS[:, 1]
    edges[:, ((to_x < 0) | (to_x >= nx))[:, None, :] | ((to_y < 0) | (to_y >= ny))[None, :, :]] = np.inf


def close_states(edges: np.ndarray, mask: np.ndarray | None) -> None:
    """Makes all actions from masked-out states infeasible; modifies ``edges`` in place.

    Raises:
        InputError: the mask has another shape than the states.
    """
    if mask is not None:
        edges[~checked_mask(mask, edges.shape[:3])] = np.inf


def checked_mask(mask: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Returns the mask as bool array; raises InputError if its shape is not ``shape``."""
    mask = np.asarray(mask, bool)
    if mask.shape != tuple(shape):
        raise InputError(f"mask: shape {mask.shape} is not that of the abstract states, {tuple(shape)}")
    return mask


def checked_tasks(patches: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """Returns the goals as float array; raises InputError if shapes violate the contract."""
    patches, goals = np.asarray(patches), np.asarray(goals, dtype=float)
    cells = (PATCH_CELLS, PATCH_CELLS)
    if patches.ndim != 3 or patches.shape[1:] != cells or goals.shape != (len(patches), N_ABSTRACT_ACTIONS, 3):
        raise InputError(
            f"tasks: patches have shape {patches.shape} and goals {goals.shape}, "
            f"expected (n, {PATCH_CELLS}, {PATCH_CELLS}) and (n, {N_ABSTRACT_ACTIONS}, 3)"
        )
    return goals
