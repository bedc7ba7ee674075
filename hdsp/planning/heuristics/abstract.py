"""Heuristics from abstractions: costs-to-go in the abstract graph."""

from __future__ import annotations

import numpy as np

from hdsp.abstract.abstract_costs import AbstractCosts, LocalCosts, Region, edge_steps
from hdsp.abstract.prepared_graph import PreparedGraph
from hdsp.base.gradual import Gradual, Steps, finished
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.relaxed.foothold_regions import FootholdRegions, efforts_to, foothold_region_steps
from hdsp.detailed.search.estimate import Estimate, geometric_estimate, least_foot_cost, with_step_efforts
from hdsp.detailed.world.world import World
from hdsp.planning.heuristics.heuristic import Heuristic
from hdsp.planning.heuristics.standing import standing_states, standing_steps
from hdsp.planning.map_changes import changed_cells
from hdsp.robot.lattice import (
    ABSTRACT_HEADINGS,
    CELLS_PER_ABSTRACT,
    HEADINGS_PER_ABSTRACT,
    abstract_shape,
    detailed_to_abstract,
)
from hdsp.terrain.height_map import HeightMap


class AbstractHeuristic(Heuristic):
    """Costs-to-go in an abstraction: one backward Dijkstra search per goal, looked up at T_d->a of a state.

    Three parts complete the lookup. The geometric heuristic counts where it is larger, e.g. within one abstract cell
    around the goal. Each foot adds its remaining steps (``hdsp.detailed.relaxed.foothold_regions``): abstract states
    contain no feet, so the lookup alone cannot tell a useful step from a useless one. A state without rest inside an
    abstract action, e.g. on a step, counts the rest of this action (``PreparedGraph.bridged``).

    States that the abstraction cuts off from the goal come after all other states. An error in the abstraction
    therefore costs time, but every solvable task stays solvable.

    Args:
        world: terrain and robot, compiled.
        terrain: the same terrain, for ``costs``.
        costs: the abstraction.
        name: its name in results.
    """

    admissible = False

    def __init__(self, world: World, terrain: HeightMap, costs: AbstractCosts, name: str = "abstract"):
        super().__init__(world)
        self.name, self.costs, self.terrain = name, costs, terrain
        self._graph: PreparedGraph | None = None
        self._standing = np.empty(0, bool)  # of the graph
        self._reached: tuple[np.ndarray, np.ndarray] | None = None  # abstract goals int64 [n, 3], distances to them
        self._foothold_regions: FootholdRegions | None = None
        self._preparation: Gradual[None] | None = None  # begun, and not yet complete

    @property
    def graph(self) -> PreparedGraph:
        """The abstract graph for the whole map; computed at first use."""
        self.prepare()
        assert self._graph is not None
        return self._graph

    @property
    def foothold_regions(self) -> FootholdRegions:
        """Regions in which feet can roll, and the steps between them; computed at first use."""
        self.prepare()
        assert self._foothold_regions is not None
        return self._foothold_regions

    def prepare(self) -> None:
        finished(self._prepared())

    def steps_to(self, goals: np.ndarray, groups: np.ndarray | None = None) -> Steps[Estimate]:
        yield from self._prepared()
        abstract = self._abstract_goals(goals)
        if self._reached is None or not np.array_equal(self._reached[0], abstract):
            self._reached = abstract, (yield from self.graph.distance_steps(abstract))
        return (yield from super().steps_to(goals, groups))

    def _prepared(self) -> Steps[None]:
        """Continues the preparation for the map, begun by this query or by an earlier one."""
        while self._graph is None or self._foothold_regions is None:
            if self._preparation is None or self._preparation.failed or self._preparation.done:
                self._preparation = Gradual(self._preparation_steps())
            self._preparation.step()
            yield
        self._preparation = None

    def _preparation_steps(self) -> Steps[None]:
        world, terrain = self.world, self.terrain
        if self._foothold_regions is None:
            self._foothold_regions = yield from foothold_region_steps(world, Rules(), least_foot_cost(world))
        if self._graph is None:
            standing = yield from standing_steps(world)
            edges = yield from edge_steps(self.costs, terrain, standing)
            yield
            graph = PreparedGraph.from_edges(edges)
            yield
            _ = graph.passed_over
            self._standing, self._graph = standing, graph

    def clear(self) -> None:
        super().clear()
        self._reached = None

    def estimate_for(self, goal: np.ndarray) -> Estimate:
        return self.estimate_for_nearest(goal[None], np.zeros(1, dtype=np.int64))

    def estimate_for_nearest(self, goals: np.ndarray, groups: np.ndarray) -> Estimate:
        to_go = self._cost_to_go(self._abstract_goals(goals))
        finite = to_go[np.isfinite(to_go)]
        efforts = efforts_to(self.foothold_regions, self.world, goals)
        geometric = geometric_estimate(self.world, goals, groups)
        view = with_step_efforts(geometric, self.foothold_regions.region, efforts)
        return view._replace(
            table=np.ascontiguousarray(to_go, dtype=np.float32).ravel(),
            table_nx=to_go.shape[1],
            table_ny=to_go.shape[2],
            cells=CELLS_PER_ABSTRACT,
            heading_steps=HEADINGS_PER_ABSTRACT,
            outside=float(finite.max()) if len(finite) else 0.0,
        )

    def _abstract_goals(self, goals: np.ndarray) -> np.ndarray:
        """Distinct abstract states, int64 [n, 3] (ix, iy, heading), of goals [n, 7]."""
        # Cells at the map's far borders may belong to no whole abstract cell.
        last = *(n - 1 for n in abstract_shape(self.terrain.shape)), ABSTRACT_HEADINGS - 1
        return np.unique(np.minimum(detailed_to_abstract(goals), last), axis=0)

    def _cost_to_go(self, goals: np.ndarray) -> np.ndarray:
        if self._reached is None or not np.array_equal(self._reached[0], goals):
            self._reached = goals, self.graph.distances(goals)
        return self.graph.bridged(self._reached[1]).astype(np.float32)

    def update(self, world: World, terrain: HeightMap, region: Region | None = None) -> None:
        """See ``Heuristic.update``.

        ``LocalCosts`` name the states that a change touches. Their edges are computed again, and the costs-to-go for
        the last goal that depend on them. Other costs start from nothing.
        """
        changed = changed_cells(self.terrain, terrain, region)
        super().update(world, terrain, region)
        self.terrain, self._foothold_regions, self._preparation = terrain, None, None
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
            goals, distances = self._reached
            # A repair keeps the costs of one goal; those of several goals are computed again at the next query.
            self._reached = (goals, self._graph.repaired(distances, goals[0], states)) if len(goals) == 1 else None
