"""Heuristics from abstractions: costs-to-go in the abstract graph."""

from __future__ import annotations

import math
from collections.abc import Sequence
from weakref import WeakValueDictionary

import numpy as np

from hdsp.abstract.abstract_costs import AbstractCosts, Region
from hdsp.abstract.cut_off import reconnect
from hdsp.abstract.prepared_graph import PreparedGraph
from hdsp.base.gradual import Gradual, Steps, finished
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.relaxed.foothold_regions import FootholdRegions, efforts_to, foothold_region_steps, regions_memory
from hdsp.detailed.search.estimate import Estimate, geometric_estimate, least_foot_cost, with_step_efforts
from hdsp.detailed.search.interpolation import CostsToGo
from hdsp.detailed.search.outcome import Limits
from hdsp.detailed.world.world import World
from hdsp.planning.heuristics.corridor_steps import DOUBT, corridor_steps
from hdsp.planning.heuristics.goal_sources import Sources, goal_source_steps
from hdsp.planning.heuristics.guided_steps import LARGE, guided_steps
from hdsp.planning.heuristics.heuristic import Heuristic
from hdsp.planning.heuristics.known_edges import PART, KnownEdges
from hdsp.planning.heuristics.standing import standing_steps, uneven_cells, updated_standing
from hdsp.planning.map_changes import changed_cells
from hdsp.robot.lattice import (
    ABSTRACT_HEADINGS,
    CELLS_PER_ABSTRACT,
    HEADINGS_PER_ABSTRACT,
    N_ABSTRACT_ACTIONS,
    abstract_shape,
)
from hdsp.terrain.height_map import HeightMap

# Bytes for an abstract state: its edges; masks, feet, distances, queues and costs-to-go.
_STATE_EDGES, _STATE_BYTES = 4 * N_ABSTRACT_ACTIONS, 128


class AbstractHeuristic(Heuristic):
    """Costs-to-go in an abstraction: one backward Dijkstra search per goal, interpolated between abstract states.

    The work of the feet completes them (``hdsp.detailed.search.interpolation``). The geometric heuristic, with the
    least steps of each foot (``hdsp.detailed.relaxed.foothold_regions``), counts where it is larger. A state without
    rest inside an abstract action, e.g. on a step, counts the rest of this action (``PreparedGraph.bridged``).

    States that the abstraction cuts off from the goal are connected at high prices (``hdsp.abstract.cut_off``); states
    far from any abstract state come after all others. An error in the abstraction therefore costs time, but every
    solvable task stays solvable.

    Args:
        world: terrain and robot, compiled.
        terrain: the same terrain, for ``costs``.
        costs: the abstraction.
        name: its name in results.
        second: another abstraction, in turns with the first one in long searches; prepared by the first of them.
    """

    admissible = False

    def __init__(
        self,
        world: World,
        terrain: HeightMap,
        costs: AbstractCosts,
        name: str = "abstract",
        second: AbstractCosts | None = None,
    ):
        super().__init__(world)
        self.name, self.costs, self.terrain, self.second = name, costs, terrain, second
        self._other: AbstractHeuristic | None = None
        self._known: KnownEdges | None = None
        self._feet = np.empty(0, np.int32)  # feet at abstract states where the robot can stand, else -1; empty: unknown
        self._uneven = np.empty(0, bool)  # abstract cells around which feet may step
        self._reached: tuple[Sources, np.ndarray] | None = None  # abstract goals and distances to them, all edges known
        self._outdated: np.ndarray | None = None  # states with other edges since then
        # The last goals and their abstract states, with the states at which the robot could stand then.
        self._last_sources: tuple[np.ndarray, np.ndarray, Sources] | None = None
        self._foothold_regions: FootholdRegions | None = None
        self._preparation: Gradual[None] | None = None  # begun, and not yet complete
        self._most_kept = Limits.memory
        # Tables of corridors by their identity, as long as some query has them.
        self._partial: WeakValueDictionary[int, np.ndarray] = WeakValueDictionary()

    @property
    def known(self) -> KnownEdges:
        """The edges evaluated so far."""
        finished(self._prepared())
        assert self._known is not None
        return self._known

    @property
    def graph(self) -> PreparedGraph:
        """The abstract graph for the whole map; computed at first use."""
        self.prepare()
        return self.known.graph

    @property
    def foothold_regions(self) -> FootholdRegions:
        """Regions in which feet can roll, and the steps between them; computed at first use."""
        finished(self._prepared())
        assert self._foothold_regions is not None
        return self._foothold_regions

    def prepare(self) -> None:
        finished(self._all_edges())

    def steps_to(self, goals: np.ndarray, groups: np.ndarray | None = None) -> Steps[Estimate]:
        yield from self._all_edges()
        to_go = yield from self._cost_to_go((yield from self._sources(goals)))
        groups = np.zeros(1, dtype=np.int64) if groups is None else groups
        self._estimate = self._view(goals, groups, to_go)
        return self._estimate

    def steps_from(self, start: np.ndarray, goals: np.ndarray, groups: np.ndarray | None = None) -> Steps[Estimate]:
        yield from self._prepared()
        known, guide = self.known, self._guide(self.known)
        sources = yield from self._sources(goals)
        groups = np.zeros(1, dtype=np.int64) if groups is None else groups
        if guide is not None:
            yield from guide._prepared()
            to_go = yield from guided_steps(known, guide.known, start, sources, self._prices())
            self._estimate = self._view(goals, groups, to_go)
            return self._estimate
        part = None if known.least is None else (yield from corridor_steps(known, start, sources, self._prices()))
        if part is None:
            return (yield from self.steps_to(goals, groups))
        estimate = self._estimate = self._view(goals, groups, part)
        self._partial[id(estimate.to_go.values)] = estimate.to_go.values
        return estimate

    def _guide(self, known: KnownEdges) -> AbstractHeuristic | None:
        """The heuristic that guides queries on a large map, while not all of its edges are evaluated."""
        if known.least is None or self.second is None or known.standing.size <= LARGE or known.complete:
            return None
        (guide,) = self.others()
        return guide

    def others(self) -> Sequence[AbstractHeuristic]:
        if self.second is None:
            return ()
        if self._other is None:
            other = AbstractHeuristic(self.world, self.terrain, self.second)
            if self._known is not None and self._foothold_regions is not None:  # the same for any abstraction
                other._feet, other._uneven = self._feet, self._uneven
                other._foothold_regions = self._foothold_regions
            self._other = other
        return (self._other,)

    def needed_memory(self) -> int:
        states = ABSTRACT_HEADINGS * math.prod(abstract_shape((self.world.nx, self.world.ny)))
        graphs = 1 + (self.second is not None) * (2 if states > LARGE else 1)  # a guided query mixes both
        edges = _STATE_EDGES * (graphs * states + min(states, PART))
        costs = sum(getattr(each, "working_memory", 0) for each in (self.costs, self.second))
        regions = regions_memory(self.world, self._foothold_regions)
        # The C library sets a block of up to 32 MB to zero at once, a larger one page by page as it is used. The next
        # heading's block may come before the last one's memory is free.
        standing = 2 * min(self.world.level_ground.nbytes, 32 << 20)
        return edges + _STATE_BYTES * states + regions + costs + standing

    def keep_within(self, memory: int) -> None:
        self._most_kept = max(memory // 2, 0)
        if self._known is not None:
            self._known.keep_within(self._most_kept)

    def kept(self) -> int:
        return 0 if self._known is None else self._known.kept()

    def covers_map(self, estimate: Estimate) -> bool:
        return self._partial.get(id(estimate.to_go.values)) is not estimate.to_go.values

    def _prepared(self) -> Steps[None]:
        """Continues the preparation for the map without its edges, begun by this query or by an earlier one."""
        while self._known is None or self._foothold_regions is None:
            if self._preparation is None or self._preparation.failed or self._preparation.done:
                self._preparation = Gradual(self._preparation_steps())
            self._preparation.step()
            yield
        self._preparation = None

    def _preparation_steps(self) -> Steps[None]:
        world, terrain = self.world, self.terrain
        if self._foothold_regions is None:
            self._foothold_regions = yield from foothold_region_steps(world, Rules(), least_foot_cost(world))
        if self._known is None:
            if self._feet.size == 0:
                feet = yield from standing_steps(world)
                self._feet, self._uneven = feet, uneven_cells(world)
                yield
            self._known = KnownEdges(terrain, self.costs, self._feet >= 0)
            self._known.keep_within(self._most_kept)

    def _all_edges(self) -> Steps[None]:
        yield from self._prepared()
        yield from self.known.evaluate_all()

    def clear(self) -> None:
        super().clear()
        self._reached = self._outdated = self._last_sources = None
        if self._other is not None:
            self._other.clear()

    def estimate_for(self, goal: np.ndarray) -> Estimate:
        return self.estimate_for_nearest(goal[None], np.zeros(1, dtype=np.int64))

    def estimate_for_nearest(self, goals: np.ndarray, groups: np.ndarray) -> Estimate:
        self.prepare()
        return self._view(goals, groups, finished(self._cost_to_go(finished(self._sources(goals)))))

    def _view(self, goals: np.ndarray, groups: np.ndarray, to_go: np.ndarray) -> Estimate:
        finite = to_go[np.isfinite(to_go)]
        efforts = efforts_to(self.foothold_regions, self.world, goals)
        geometric = geometric_estimate(self.world, goals, groups)
        table = CostsToGo(
            values=np.ascontiguousarray(to_go, dtype=np.float32).ravel(),
            feet=self._feet.ravel(),
            uneven=self._uneven.ravel(),
            nx=to_go.shape[1],
            ny=to_go.shape[2],
        )
        view = with_step_efforts(geometric, self.foothold_regions.region, efforts)
        return view._replace(to_go=table, outside=float(finite.max()) if len(finite) else 0.0)

    def _sources(self, goals: np.ndarray) -> Steps[Sources]:
        standing, last = self.known.standing, self._last_sources
        if last is None or last[0] is not standing or not np.array_equal(last[1], goals):
            last = standing, goals, (yield from goal_source_steps(self.world, standing, goals))
            self._last_sources = last
        return last[2]

    def _is_reached(self, sources: Sources) -> bool:
        return self._reached is not None and self._outdated is None and self._reached[0].equal(sources)

    def _cost_to_go(self, sources: Sources) -> Steps[np.ndarray]:
        """Costs-to-go of the whole map, float64 [16, nx, ny], in steps; all edges are known."""
        graph = self.known.graph
        if self._reached is not None and self._outdated is not None and self._reached[0].equal(sources):
            states = np.argwhere(self._outdated)
            self._reached = sources, graph.repaired(self._reached[1], sources.states, states, sources.costs)
        elif not self._is_reached(sources):
            self._reached = sources, (yield from graph.distance_steps(sources.states, sources.costs))
        self._outdated = None
        assert self._reached is not None
        distances = self._reached[1]
        yield
        passed_over = graph.passed_over
        yield
        to_go = np.maximum(graph.bridged(distances) - sources.excess, 0.0)
        yield
        reconnect(to_go, self.known.standing | passed_over, self._prices())
        return to_go

    def _prices(self) -> np.ndarray:
        """Prices of actions that the abstraction judges infeasible, float64 [16, 22]; see ``reconnect``."""
        t = self.world.tables
        drives = CELLS_PER_ABSTRACT * t.drive_price[0, ::HEADINGS_PER_ABSTRACT, : len(t.move_dx)]
        turns = np.full((ABSTRACT_HEADINGS, 2), HEADINGS_PER_ABSTRACT * self.world.constants.turn)
        return DOUBT * np.concatenate([drives, turns], axis=1)

    def update(self, world: World, terrain: HeightMap, region: Region | None = None) -> None:
        """See ``Heuristic.update``.

        ``LocalCosts`` name the states that a change touches. Only their edges are evaluated again, when a query needs
        them, and the costs-to-go for the last goal that depend on them. Other costs start from nothing.
        """
        changed = changed_cells(self.terrain, terrain, region)
        other = None if self._other is None else self._other.updated(world, terrain, region)
        if changed is None or changed.any():
            self._update_edges(world, terrain, changed)
        super().update(world, terrain, region)
        self.terrain, self._other, self._foothold_regions, self._preparation = terrain, other, None, None

    def _update_edges(self, world: World, terrain: HeightMap, changed: np.ndarray | None) -> None:
        """Takes over the edges of a changed map; all of them are new for changes None, which may be anywhere."""
        known, former, outdated = None, self._known, self._outdated
        if former is not None and changed is not None:
            feet = updated_standing(self.world, world, self._feet)
            known = former.updated(terrain, feet >= 0, changed)
        if known is None or former is None:
            self._known = self._reached = self._outdated = None
            self._feet = np.empty(0, np.int32)
            return
        uneven = uneven_cells(world)
        if self._reached is not None:
            others = (known.evaluated != former.evaluated) | (known.standing != former.standing)
            outdated = others if outdated is None else outdated | others
        self._known, self._feet, self._uneven, self._outdated = known, feet, uneven, outdated
