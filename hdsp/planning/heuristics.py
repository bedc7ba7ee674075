"""Heuristics: estimates of the cost from a detailed state to the goal.

One documented contract, two families: the geometric heuristic, which is admissible, and the costs of an abstraction
(learned, manual or any other ``AbstractCosts``), which is far better informed and may overestimate.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from hdsp.abstract.abstract_costs import AbstractCosts, LocalCosts, Region
from hdsp.abstract.prepared_graph import PreparedGraph
from hdsp.base.errors import InputError
from hdsp.base.jit import njit
from hdsp.detailed.actions.state_costs import foot_row
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.relaxed.foothold_regions import FootholdRegions, efforts_to, find_foothold_regions
from hdsp.detailed.search.estimate import Estimate, estimate, geometric_estimate, least_foot_cost, with_step_efforts
from hdsp.detailed.states import pack_states
from hdsp.detailed.world.world import World, body_is_free, cell_index
from hdsp.robot.lattice import (
    ABSTRACT_ANCHOR,
    ABSTRACT_HEADINGS,
    CELLS_PER_ABSTRACT,
    HEADINGS_PER_ABSTRACT,
    abstract_shape,
    detailed_to_abstract,
)
from hdsp.terrain.height_map import HeightMap


class Heuristic(ABC):
    """Estimates the cost from any detailed state to one goal.

    A heuristic belongs to one terrain and robot. ``set_goal`` prepares it for a goal and gives what the search kernels
    read: a flat array and a lookup rule (``Estimate``), so that a search never calls back into Python. Calling the
    heuristic evaluates the same rule for any states.

    Convention: states are in lattice units (ix, iy, heading, 4 foot offsets); see ``hdsp.robot.lattice``.
    """

    name: str
    #: Whether estimates never exceed the true cost; weighted A* then keeps its bound of W times optimal.
    admissible: bool
    #: Whether no action lowers the estimate by more than it costs, and the goal's is 0. Such a heuristic is admissible,
    #: and weighted A* keeps its bound even if it expands no state twice (``solve(..., reopen=False)``).
    consistent: bool = False

    def __init__(self, world: World):
        self.world = world
        self._estimate: Estimate | None = None

    @abstractmethod
    def _prepare(self, goal: np.ndarray) -> Estimate:
        """The kernel's view for a goal, int64 [7]."""

    def set_goal(self, goal: np.ndarray) -> Estimate:
        """Prepare for a goal, int64 [7], and return what the kernels read."""
        self._estimate = self._prepare(np.asarray(goal, dtype=np.int64))
        return self._estimate

    def __call__(self, states: np.ndarray) -> np.ndarray:
        """Estimated costs, float64 [n], of detailed states [n, 7].

        Raises:
            InputError: if no goal was set.
        """
        if self._estimate is None:
            raise InputError(f"{self.name} heuristic: call set_goal first")
        return _estimates(self._estimate, pack_states(states, self.world.tables.lowest))

    def forget(self) -> None:
        """Drop what was computed for the last goal; it has to be set again."""
        self._estimate = None

    def update(self, world: World, terrain: HeightMap, region: Region | None = None) -> None:
        """Take over a changed terrain; the goal has to be set again.

        Args:
            world: the terrain, compiled.
            terrain: the terrain.
            region: rectangle of cells (first ix, first iy, end ix, end iy) outside of which nothing has changed; None =
                anything may have.
        """
        self.world, self._estimate = world, None


class GeometricHeuristic(Heuristic):
    """Distance, difference of headings and of foot configurations, each at its least cost (paper, Sec. VI-B)."""

    name = "geometric"
    admissible = True
    consistent = True

    def _prepare(self, goal: np.ndarray) -> Estimate:
        return geometric_estimate(self.world, goal)


class AbstractHeuristic(Heuristic):
    """Costs-to-go of an abstraction: one backward Dijkstra over its edges per goal, looked up at T_d->a of a state.

    Where the geometric heuristic says more (within one abstract cell of the goal, say), that counts. The steps that
    each foot still has to make are added (``hdsp.detailed.relaxed.foothold_regions``): abstract states know no feet, so that without it
    a search could not tell a step that leads on from one that does not. Where the robot cannot rest but an abstract
    action passes, as on a step, what counts is the rest of that action (``PreparedGraph.bridged``). Other states that
    the abstraction cuts off from the goal are not given up: they come after all others, so that a mistake of the
    abstraction costs time but never makes a solvable task unsolvable.

    Args:
        world: terrain and robot, compiled.
        terrain: the same terrain, for ``costs``.
        costs: the abstraction.
        name: what to call it in results.
    """

    admissible = False

    def __init__(self, world: World, terrain: HeightMap, costs: AbstractCosts, name: str = "abstract"):
        super().__init__(world)
        self.name, self.costs, self.terrain = name, costs, terrain
        self._graph: PreparedGraph | None = None
        self._standing = np.empty(0, bool)  # of the graph
        self._reached: tuple[tuple[int, int, int], np.ndarray] | None = None  # abstract goal, distances to it
        self._foothold_regions: FootholdRegions | None = None

    @property
    def graph(self) -> PreparedGraph:
        """The abstract graph of the whole map; computed when first used."""
        if self._graph is None:
            self._standing = standing_states(self.world)
            self._graph = PreparedGraph.from_edges(self.costs.edges(self.terrain, mask=self._standing))
        return self._graph

    @property
    def foothold_regions(self) -> FootholdRegions:
        """Regions in which feet can roll, and the steps between them; computed when first used."""
        if self._foothold_regions is None:
            self._foothold_regions = find_foothold_regions(self.world, Rules(), least_foot_cost(self.world))
        return self._foothold_regions

    def forget(self) -> None:
        super().forget()
        self._reached = None

    def prepare(self) -> None:
        """Compute what the heuristic needs of the whole map, whatever the goal."""
        _ = self.graph.passed_over, self.foothold_regions

    def _prepare(self, goal: np.ndarray) -> Estimate:
        shape = abstract_shape(self.terrain.shape)
        a, b, k = (int(v) for v in detailed_to_abstract(goal))
        to_go = self._cost_to_go((min(a, shape[0] - 1), min(b, shape[1] - 1), k))
        finite = to_go[np.isfinite(to_go)]
        efforts = efforts_to(self.foothold_regions, self.world, goal[None])
        return with_step_efforts(geometric_estimate(self.world, goal), self.foothold_regions.region, efforts)._replace(
            table=np.ascontiguousarray(to_go, dtype=np.float32).ravel(),
            table_nx=to_go.shape[1],
            table_ny=to_go.shape[2],
            cells=CELLS_PER_ABSTRACT,
            heading_steps=HEADINGS_PER_ABSTRACT,
            outside=float(finite.max()) if len(finite) else 0.0,
        )

    def _cost_to_go(self, goal: tuple[int, int, int]) -> np.ndarray:
        if self._reached is None or self._reached[0] != goal:
            self._reached = goal, self.graph.distances(goal)
        return self.graph.bridged(self._reached[1]).astype(np.float32)

    def update(self, world: World, terrain: HeightMap, region: Region | None = None) -> None:
        """See ``Heuristic.update``. Where the abstraction says which states a change touches (``LocalCosts``), only
        their edges are computed again, and only those costs-to-go of the last goal that depend on them."""
        changed = changed_cells(self.terrain, terrain, region)
        super().update(world, terrain, region)
        self.terrain, self._foothold_regions = terrain, None
        if self._graph is None or changed is None or not isinstance(self.costs, LocalCosts):
            self._graph = self._reached = None
            return
        standing = standing_states(world)
        # States at which the robot could not stand before have no edges yet.
        stale = standing & (self.costs.affected(changed) | ~self._standing)
        states = np.argwhere(stale | (self._standing & ~standing))
        self._standing = standing
        if len(states) == 0:
            return
        (_, *first), (_, *last) = states.min(axis=0), states.max(axis=0)
        box = (slice(None), slice(first[0], last[0] + 1), slice(first[1], last[1] + 1))
        edges = self.costs.edges(terrain, (*first, last[0] + 1, last[1] + 1), stale[box])
        k, a, b = states.T
        self._graph = self._graph.with_edges(states, edges[k, a - first[0], b - first[1]])
        if self._reached is not None:
            goal, distances = self._reached
            self._reached = goal, self._graph.repaired(distances, goal, states)


def changed_cells(before: HeightMap, after: HeightMap, region: Region | None = None) -> np.ndarray | None:
    """The cells, bool [nx, ny], in which two height maps differ; None if they do not cover the same ground.

    Args:
        before, after: the maps.
        region: rectangle (first ix, first iy, end ix, end iy) in which to look; None = all.

    Raises:
        InputError: the region does not lie within the map.
    """
    if before.shape != after.shape or before.origin != after.origin:
        return None
    nx, ny = after.shape
    first_x, first_y, end_x, end_y = (0, 0, nx, ny) if region is None else (int(value) for value in region)
    if not (0 <= first_x <= end_x <= nx and 0 <= first_y <= end_y <= ny):
        raise InputError(f"region {tuple(region)}: need (first ix, first iy, end ix, end iy) within {nx} x {ny} cells")
    changed = np.zeros(after.shape, bool)
    part = slice(first_x, end_x), slice(first_y, end_y)
    old, new = before.heights[part], after.heights[part]
    changed[part] = (old != new) & ~(np.isnan(old) & np.isnan(new))
    return changed


def standing_states(world: World) -> np.ndarray:
    """The abstract states at whose anchor the robot can stand with some feet, bool [16, nx, ny]."""
    nx, ny = abstract_shape((world.nx, world.ny))
    return _standing_states(world, nx, ny)


@njit()
def _standing_states(world, nx, ny):
    result = np.zeros((ABSTRACT_HEADINGS, nx, ny), dtype=np.bool_)
    standable, feet, samples, n = world.standable, world.tables.feet, world.tables.n_samples, world.tables.n_offsets
    apart = 2 * world.constants.neutral_x - world.constants.min_separation
    for k in range(ABSTRACT_HEADINGS):
        heading = k * HEADINGS_PER_ABSTRACT
        left_front, left_rear, right_rear, right_front = [foot_row(world.tables, heading, i, 0) for i in range(4)]
        for a in range(nx):
            for b in range(ny):
                ix, iy = CELLS_PER_ABSTRACT * a + ABSTRACT_ANCHOR, CELLS_PER_ABSTRACT * b + ABSTRACT_ANCHOR
                p = cell_index(world, ix, iy)
                result[k, a, b] = (
                    side_stands(standable, feet, samples, n, p, left_front, left_rear, apart)
                    and side_stands(standable, feet, samples, n, p, right_front, right_rear, apart)
                    and body_is_free(world, heading, p)
                )
    return result


@njit(inline="always")
def side_stands(standable, feet, n_samples, n_offsets, p, front, rear, apart):
    """Whether front and rear foot of a side, given by their rows in ``feet``, find ground far enough from each other.

    They are farthest from each other with the front foot as far ahead as it can be, and the rear one behind.
    """
    ahead, behind = n_offsets - 1, 0
    while ahead >= 0 and not standable[p + feet[front + ahead * n_samples]]:
        ahead -= 1
    while behind < n_offsets and not standable[p + feet[rear + behind * n_samples]]:
        behind += 1
    return ahead >= 0 and behind < n_offsets and behind - ahead <= apart


@njit()
def _estimates(parameters, keys):
    result = np.empty(len(keys))
    for i in range(len(keys)):
        result[i] = estimate(parameters, keys[i])
    return result
