"""Heuristics from abstractions: costs-to-go in the abstract graph."""

from __future__ import annotations

import numpy as np

from hdsp.abstract.abstract_costs import AbstractCosts, Region
from hdsp.abstract.asked_distances import AskedDistances, distances_from, least_costs_to
from hdsp.base.gradual import Gradual, Steps, finished
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.relaxed.foothold_regions import FootholdRegions, efforts_to, foothold_region_steps
from hdsp.detailed.search.estimate import Estimate, geometric_estimate, least_foot_cost, with_step_efforts
from hdsp.detailed.search.interpolation import CostsToGo
from hdsp.detailed.search.life_cycle import Answers
from hdsp.detailed.search.reading import Reading, all_known, reading
from hdsp.detailed.states import pack_states
from hdsp.detailed.world.world import World
from hdsp.planning.heuristics.asked_costs import AskedCosts, all_distances
from hdsp.planning.heuristics.goal_sources import Sources, goal_sources
from hdsp.planning.heuristics.heuristic import Heuristic
from hdsp.planning.heuristics.known_edges import KnownEdges
from hdsp.planning.heuristics.standing import standing_steps, uneven_cells, updated_standing
from hdsp.planning.map_changes import changed_cells
from hdsp.terrain.height_map import HeightMap


class AbstractHeuristic(Heuristic):
    """Costs-to-go in an abstraction: a backward search from each goal, interpolated between abstract states.

    The work of the feet completes them (``hdsp.detailed.search.interpolation``). The geometric heuristic, with the
    least steps of each foot (``hdsp.detailed.relaxed.foothold_regions``), counts where it is larger. A state without
    rest inside an abstract action, e.g. on a step, counts the rest of this action.

    A query searches only as far as it needs costs-to-go, and ``BlockwiseCosts`` are evaluated only there. The costs are
    those of a complete search (``hdsp.abstract.asked_distances``).

    Actions that the abstraction judges infeasible keep a high price (``known_edges.DOUBT``); states far from any
    abstract state come after all others. An error in the abstraction therefore costs time, but every solvable task
    stays solvable.

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
        self._known: KnownEdges | None = None
        self._feet = np.empty(0, np.int32)  # feet at abstract states where the robot can stand, else -1
        self._uneven = np.empty(0, bool)  # abstract cells around which feet may step
        self._last: tuple[Sources, AskedDistances] | None = None  # the last query's search
        self._asked: AskedCosts | None = None  # answers for the last estimate; None if it is complete
        self._foothold_regions: FootholdRegions | None = None
        self._preparation: Gradual[None] | None = None  # begun, and not yet complete

    @property
    def known(self) -> KnownEdges:
        """The edges evaluated so far."""
        finished(self._prepared())
        assert self._known is not None
        return self._known

    @property
    def foothold_regions(self) -> FootholdRegions:
        """Regions in which feet can roll, and the steps between them; computed at first use."""
        finished(self._prepared())
        assert self._foothold_regions is not None
        return self._foothold_regions

    @property
    def evaluated(self) -> float:
        """Share of the states at which the robot can stand whose edges are evaluated."""
        return 1 - len(self.known.missing()) / max(int(self.known.standing.sum()), 1)

    def prepare(self) -> None:
        finished(self._all_edges())

    def steps_to(self, goals: np.ndarray, groups: np.ndarray | None = None) -> Steps[Estimate]:
        yield from self._all_edges()
        return (yield from super().steps_to(goals, groups))

    def steps_from(
        self, start: np.ndarray, goals: np.ndarray, groups: np.ndarray | None = None
    ) -> Steps[tuple[Estimate, Answers | None]]:
        yield from self._prepared()
        if not self.known.blockwise:
            yield from self.known.evaluate_all()
        search = self._search_to(goals)
        read = reading(self.world, search.known)
        estimate = self._view(goals, np.zeros(1, np.int64) if groups is None else groups, search, read)
        asked = AskedCosts(self.world, self.known, search, estimate.to_go)
        yield from asked.know(int(pack_states(start, self.world.tables.lowest)[0]))
        self._estimate, self._asked = estimate, asked
        return estimate, asked

    def __call__(self, states: np.ndarray) -> np.ndarray:
        if self._estimate is not None and self._asked is not None:
            for key in pack_states(states, self.world.tables.lowest).tolist():
                finished(self._asked.know(key))
        return super().__call__(states)

    def _prepared(self) -> Steps[None]:
        """Continues the preparation for the map without its edges, begun by this query or by an earlier one."""
        while self._known is None or self._foothold_regions is None:
            if self._preparation is None or self._preparation.failed or self._preparation.done:
                self._preparation = Gradual(self._preparation_steps())
            self._preparation.step()
            yield
        self._preparation = None

    def _preparation_steps(self) -> Steps[None]:
        world = self.world
        if self._foothold_regions is None:
            self._foothold_regions = yield from foothold_region_steps(world, Rules(), least_foot_cost(world))
        if self._known is None:
            feet = yield from standing_steps(world)
            known = KnownEdges(world, self.terrain, self.costs, feet >= 0)
            self._feet, self._uneven, self._known = feet, uneven_cells(world), known

    def _all_edges(self) -> Steps[None]:
        yield from self._prepared()
        yield from self.known.evaluate_all()

    def clear(self) -> None:
        super().clear()
        self._last = self._asked = None

    def estimate_for(self, goal: np.ndarray) -> Estimate:
        return self.estimate_for_nearest(goal[None], np.zeros(1, dtype=np.int64))

    def estimate_for_nearest(self, goals: np.ndarray, groups: np.ndarray) -> Estimate:
        self.prepare()
        search, self._asked = self._search_to(goals), None
        all_distances(search)
        return self._view(goals, groups, search, all_known())

    def _view(self, goals: np.ndarray, groups: np.ndarray, search: AskedDistances, read: Reading) -> Estimate:
        efforts = efforts_to(self.foothold_regions, self.world, goals)
        view = with_step_efforts(geometric_estimate(self.world, goals, groups), self.foothold_regions.region, efforts)
        nx, ny = self.known.standing.shape[1:]
        table = CostsToGo(search.values, self._feet.ravel(), self._uneven.ravel(), nx, ny, read)
        return view._replace(to_go=table, outside=self.known.across)

    def _search_to(self, goals: np.ndarray) -> AskedDistances:
        """The backward search for goals; the last one goes on if it has the same sources."""
        sources = goal_sources(self.world, self.known.standing, goals)
        if self._last is None or not self._last[0].equal(sources):
            edges, states = self.known.edges, sources.states
            places = np.ravel_multi_index((states[:, 2], states[:, 0], states[:, 1]), self._feet.shape)
            to_goal = least_costs_to(edges, places, sources.costs)
            self._last = sources, distances_from(edges, places, sources.costs, sources.excess, to_goal)
        return self._last[1]

    def update(self, world: World, terrain: HeightMap, region: Region | None = None) -> None:
        """See ``Heuristic.update``.

        ``LocalCosts`` name the states that a change touches. Only their edges are evaluated again, where a query needs
        them. Other costs start from nothing.
        """
        changed = changed_cells(self.terrain, terrain, region)
        before = self.world
        super().update(world, terrain, region)
        self.terrain, self._foothold_regions, self._preparation = terrain, None, None
        if changed is not None and not changed.any():
            return
        self._last = self._asked = None
        if self._known is None or changed is None:
            self._known = None
            return
        feet = updated_standing(before, world, self._feet)
        if self._known.update(terrain, feet >= 0, changed):
            self._feet, self._uneven = feet, uneven_cells(world)
        else:
            self._known = None
