"""Heuristics: estimates of the cost from a detailed state to the goal.

One documented contract, two families: the geometric heuristic, which is admissible, and the costs of an abstraction
(learned, manual or any other ``AbstractCosts``), which is far better informed and may overestimate.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from hdsp.abstract.costs import AbstractCosts
from hdsp.abstract.dijkstra import PreparedGraph
from hdsp.abstract.transform import best_feet
from hdsp.detailed.actions import Rules
from hdsp.detailed.estimate import Estimate, estimate, geometric_estimate, least_foot_cost, with_footing
from hdsp.detailed.footing import Footing, efforts_to, find_footing
from hdsp.detailed.states import pack_states
from hdsp.detailed.world import World
from hdsp.errors import InputError
from hdsp.heightmap import HeightMap
from hdsp.jit import njit
from hdsp.lattice import (
    ABSTRACT_ANCHOR,
    ABSTRACT_HEADINGS,
    CELLS_PER_ABSTRACT,
    HEADINGS_PER_ABSTRACT,
    abstract_shape,
    detailed_to_abstract,
)


class Heuristic(ABC):
    """Estimates the cost from any detailed state to one goal.

    A heuristic belongs to one terrain and robot. ``set_goal`` prepares it for a goal and gives what the search kernels
    read: a flat array and a lookup rule (``Estimate``), so that a search never calls back into Python. Calling the
    heuristic evaluates the same rule for any states.

    Convention: states are in lattice units (ix, iy, heading, 4 foot offsets); see ``hdsp.lattice``.
    """

    name: str
    #: Whether estimates never exceed the true cost; weighted A* then keeps its bound of W times optimal.
    admissible: bool

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

    def update(self, world: World, terrain: HeightMap) -> None:
        """Take over a changed terrain; the goal has to be set again."""
        self.world, self._estimate = world, None


class GeometricHeuristic(Heuristic):
    """Distance, difference of headings and of foot configurations, each at its least cost (paper, Sec. VI-B)."""

    name = "geometric"
    admissible = True

    def _prepare(self, goal: np.ndarray) -> Estimate:
        return geometric_estimate(self.world, goal)


class AbstractHeuristic(Heuristic):
    """Costs-to-go of an abstraction: one backward Dijkstra over its edges per goal, looked up at T_d->a of a state.

    Where the geometric heuristic says more (within one abstract cell of the goal, say), that counts. The steps that
    each foot still has to make are added (``hdsp.detailed.footing``): abstract states know no feet, so that without it
    a search could not tell a step that leads on from one that does not. States that the
    abstraction cuts off from the goal are not given up: they come after all others, so that a mistake of the
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
        self._footing: Footing | None = None

    @property
    def graph(self) -> PreparedGraph:
        """The abstract graph of the whole map; computed when first used."""
        if self._graph is None:
            mask = standing_states(self.world)
            self._graph = PreparedGraph.from_edges(self.costs.edges(self.terrain, mask=mask))
        return self._graph

    @property
    def footing(self) -> Footing:
        """Regions in which feet can roll, and the steps between them; computed when first used."""
        if self._footing is None:
            self._footing = find_footing(self.world, Rules(), least_foot_cost(self.world))
        return self._footing

    def prepare(self) -> None:
        """Compute what the heuristic needs of the whole map, whatever the goal."""
        _ = self.graph, self.footing

    def _prepare(self, goal: np.ndarray) -> Estimate:
        shape = abstract_shape(self.terrain.shape)
        a, b, k = (int(v) for v in detailed_to_abstract(goal))
        to_go = self.graph.cost_to_go((min(a, shape[0] - 1), min(b, shape[1] - 1), k))
        finite = to_go[np.isfinite(to_go)]
        efforts = efforts_to(self.footing, self.world, goal[None])
        return with_footing(geometric_estimate(self.world, goal), self.footing, efforts)._replace(
            table=np.ascontiguousarray(to_go, dtype=np.float32).ravel(),
            table_nx=to_go.shape[1],
            table_ny=to_go.shape[2],
            cells=CELLS_PER_ABSTRACT,
            heading_steps=HEADINGS_PER_ABSTRACT,
            outside=float(finite.max()) if len(finite) else 0.0,
        )

    def update(self, world: World, terrain: HeightMap) -> None:
        super().update(world, terrain)
        self.terrain, self._graph, self._footing = terrain, None, None


def standing_states(world: World) -> np.ndarray:
    """The abstract states at whose anchor the robot can stand with some feet, bool [16, nx, ny]."""
    nx, ny = abstract_shape((world.nx, world.ny))
    return _standing_states(world, nx, ny)


@njit()
def _standing_states(world, nx, ny):
    result = np.zeros((ABSTRACT_HEADINGS, nx, ny), dtype=np.bool_)
    for k in range(ABSTRACT_HEADINGS):
        for a in range(nx):
            for b in range(ny):
                ix, iy = CELLS_PER_ABSTRACT * a + ABSTRACT_ANCHOR, CELLS_PER_ABSTRACT * b + ABSTRACT_ANCHOR
                cost, _ = best_feet(world, ix, iy, k * HEADINGS_PER_ABSTRACT)
                result[k, a, b] = cost < np.inf
    return result


@njit()
def _estimates(parameters, keys):
    result = np.empty(len(keys))
    for i in range(len(keys)):
        result[i] = estimate(parameters, keys[i])
    return result
