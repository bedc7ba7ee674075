"""Compilation before the clock: the kernels of a query are compiled, or loaded from disk, before its time begins.

A trial, a query of the same kind on a small map, uses each kernel of such a query. It runs once in a process for each
kind. `hdsp.base.compilation` says that kernels are compiled, and how far it got.
"""

from __future__ import annotations

import math
import threading
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from hdsp.abstract.abstract_costs import RememberingCosts, checked_region, close_exits, close_states, edge_steps
from hdsp.abstract.guided import MixedEdges
from hdsp.base.compilation import compilations
from hdsp.base.errors import InputError, RefinementError
from hdsp.base.gradual import finished
from hdsp.detailed.relaxed.heading_masks import missing_feet
from hdsp.detailed.relaxed.proofs import why_unreachable
from hdsp.detailed.search.estimate import geometric_estimate
from hdsp.detailed.search.leaving import leave
from hdsp.detailed.search.life_cycle import FEW, GuideTurn, Search
from hdsp.detailed.search.multi_heuristic import solve_multi
from hdsp.detailed.search.outcome import Limits
from hdsp.detailed.search.store import load_growth
from hdsp.detailed.search.windows import Windows
from hdsp.detailed.world.world import build_world, cell_index
from hdsp.planning.ends.arrival import arrival
from hdsp.planning.ends.location import locate
from hdsp.planning.heuristics import AbstractHeuristic, GeometricHeuristic, GridHeuristic, Heuristic
from hdsp.planning.heuristics.goal_sources import goal_sources
from hdsp.planning.heuristics.guided_steps import guided_steps
from hdsp.planning.improving import improving_plans
from hdsp.planning.polish import DEFAULT, Polish
from hdsp.planning.query import Query
from hdsp.planning.refinable import refinable_plan
from hdsp.robot.lattice import ABSTRACT_HEADINGS, N_ABSTRACT_ACTIONS, Grid, cells, metres
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap

if TYPE_CHECKING:
    from hdsp.abstract.manual import ManualCosts
    from hdsp.learning.learned_costs import LearnedCosts


@dataclass(frozen=True)
class QueryKind:
    """Kind of a query, by the kernels that it uses.

    Attributes:
        abstract: the heuristic comes from an abstraction.
        costs: classes of costs with kernels of their own, by name.
        grid: the heuristic is the grid heuristic.
        admissible: the heuristic is admissible.
        anchored: the search is multi-heuristic A*.
        anytime: the search is ARA*.
        refinable: plans are refined.
    """

    abstract: bool = False
    costs: tuple[str, ...] = ()
    grid: bool = False
    admissible: bool = True
    anchored: bool = False
    anytime: bool = False
    refinable: bool = False

    @property
    def kernels(self) -> int:
        """Number of kernels, roughly, for lines of progress."""
        parts = self.anchored, self.anytime, self.refinable, self.abstract, "LearnedCosts" in self.costs
        return 75 + sum(more for part, more in zip(parts, (10, 5, 15, 10, 25), strict=True) if part)


#: Number of kernels for another kind of query, roughly.
_FEW_KERNELS = 10
_DONE: set[QueryKind] = set()
_LOCK = threading.Lock()
_THREAD = threading.local()


def compile_on_use() -> None:
    """From now on, `compile_for` returns at once in this thread: each query compiles the kernels that it uses.

    A first answer then comes sooner, but compilation counts as its time.
    """
    _THREAD.on_use = True


def compile_for(
    robot: Robot, heuristic: Heuristic, *, anchored: bool = False, anytime: bool = False, refinable: bool = False
) -> None:
    """Compiles or loads the kernels of a query, unless this process did, or this thread compiles on use.

    Args:
        robot: the robot of the planner.
        heuristic: its heuristic.
        anchored: the query has an anchor.
        anytime: the query improves its plan.
        refinable: the query refines its plans.
    """
    abstract = isinstance(heuristic, AbstractHeuristic)
    costs = _with_kernels(heuristic)
    kind = QueryKind(
        abstract=abstract,
        costs=tuple(type(each).__name__ for each in costs),
        grid=isinstance(heuristic, GridHeuristic),
        admissible=heuristic.admissible,
        anchored=anchored and not heuristic.admissible,
        anytime=anytime,
        refinable=refinable,
    )
    if kind in _DONE or getattr(_THREAD, "on_use", False):
        return
    with _LOCK:
        if kind in _DONE:
            return
        # A robot that cannot do the trial fails in the query too, with its reason.
        left = max(kind.kernels - compilations.done, _FEW_KERNELS)
        with compilations.told(left), suppress(InputError, RefinementError):
            _try(robot, kind, costs)
        _DONE.add(kind)


def warm_up(robot: Robot, heuristic: Heuristic) -> None:
    """Compiles or loads the kernels of all kinds of queries, so that none compiles at its first use.

    Args:
        robot: the robot of the planner.
        heuristic: its heuristic.
    """
    for anchored, anytime, refinable in product((False, True), repeat=3):
        if not (anchored and anytime):
            compile_for(robot, heuristic, anchored=anchored, anytime=anytime, refinable=refinable)


def _with_kernels(heuristic: Heuristic) -> list[LearnedCosts | ManualCosts]:
    """Costs with kernels of their own; only a planner with learned costs has loaded the network."""
    costs = (heuristic.costs, heuristic.second) if isinstance(heuristic, AbstractHeuristic) else ()
    known = "hdsp.learning.learned_costs", "hdsp.abstract.manual"
    return [each for each in costs if type(each).__module__ in known]  # type: ignore[misc]


def _try(robot: Robot, kind: QueryKind, costs: list[LearnedCosts | ManualCosts]) -> None:
    terrain = _ground(robot)
    world, grid = build_world(terrain, robot), Grid(terrain.origin, terrain.shape)
    heuristic: Heuristic = GridHeuristic(world) if kind.grid else GeometricHeuristic(world)
    if kind.abstract:
        heuristic = AbstractHeuristic(world, terrain, _EvenCosts())
    for abstraction in costs:
        mask = np.zeros((ABSTRACT_HEADINGS, *(n // 4 for n in terrain.shape)), bool)
        mask[1, mask.shape[1] // 4, mask.shape[2] // 2] = True
        memory = abstraction.new_memory(terrain) if isinstance(abstraction, RememberingCosts) else None
        for _ in range(2):  # features are kept, then loaded
            finished(edge_steps(abstraction, terrain, mask, memory=memory))
    middle = terrain.size[0] / 4, terrain.size[1] / 2
    start, _ = locate(world, grid, robot, (*middle, 0.0), "start")
    locate(world, grid, robot, (metres(1.0), metres(1.0), 0.0), "start")
    build_world(terrain, replace(robot, feet=replace(robot.feet, clearance=0.0)))  # for a way out
    for distance in (1.0, math.inf):  # a start on displaced feet
        leave(world, start, distance, expansions=1)
    goal, _ = locate(world, grid, robot, (middle[0] + metres(8.0), middle[1], 0.2), "goal")
    ends = arrival(world, grid, robot, [(middle[0] + metres(8.0), middle[1], None)], metres(1.0))
    if len(ends.states):
        heuristic.set_goals(ends.states, np.zeros(len(ends.states), np.int64))
    heuristic.set_goal(goal)
    query = Query(
        terrain=terrain,
        robot=robot,
        wider=robot,
        grid=grid,
        world=world,
        heuristic=heuristic,
        estimate=finished(heuristic.steps_from(start, goal[None])),
        start=start,
        goals=goal[None],
        goal_numbers=np.zeros(1, np.int64),
        admissible=kind.admissible,
        consistent=heuristic.consistent,
        limits=Limits(),
    )
    why_unreachable(world, start, goal)
    _load_rare(query, kind)
    # The plans of the trial may be so good that a polish searches nothing.
    Windows(world).path(start, goal, math.inf, FEW, math.inf)
    missing_feet(world, int(cell_index(world, start[0], start[1])), int(start[2]))
    if kind.anytime:
        stopped = replace(query, limits=Limits(expansions=1))
        for each in (query, stopped):
            list(improving_plans(each, (1.5, 1.2), kind.refinable, Polish(DEFAULT), 0.0))
        return
    for limits in (Limits(expansions=1), Limits()):
        each = replace(query, limits=limits)
        turns = iter([GuideTurn(1, lambda _: query.estimate, 1)]) if kind.abstract else None
        # At a bound of 1, the anchor goes on after the guide.
        plan = each.anchored(1.0, 1.0) if kind.anchored else each.weighted(1.5, turns=turns, first_turn=1)
        Polish(DEFAULT).of(each, plan)
        if kind.refinable and plan.solved:
            refinable_plan(each, lambda again, _: again.weighted(1.5), plan)


def _load_rare(query: Query, kind: QueryKind) -> None:
    """Compiles or loads kernels of long searches, large maps and changed maps, which the trial does not reach."""
    world, estimate = query.world, query.estimate
    search = Search(world, query.start, query.goals, nearest=True)
    if search.begin(estimate, 1.0, False) is None:
        search.advance()
        search.begin_round(estimate, 1.0, False, False)
        load_growth(search.store)
    if kind.anchored:
        # An anchor that knows nothing goes on after the guide.
        nothing = geometric_estimate(world, query.goals)._replace(distance=0.0, turn=0.0, foot=0.0)
        solve_multi(world, query.start, query.goals, nothing, [estimate], limits=Limits(expansions=5_000))
    if kind.abstract:
        assert isinstance(query.heuristic, AbstractHeuristic)
        known = query.heuristic.known
        finished(known.evaluate_all())
        states = np.argwhere(known.standing)[:1]
        prices = np.ones((ABSTRACT_HEADINGS, N_ABSTRACT_ACTIONS))
        sources = goal_sources(world, known.standing, query.goals)
        finished(guided_steps(known, known, query.start, sources, prices))
        MixedEdges(known.graph).open(prices, known.standing)
        changed = known.graph.with_edges(states, np.ones((1, N_ABSTRACT_ACTIONS), np.float32))
        distances = known.graph.distances(sources.states, sources.costs)
        changed.repaired(distances, sources.states, states, sources.costs)


def _ground(robot: Robot) -> HeightMap:
    """Flat ground on which the robot can stand and turn, behind it a wall and more ground."""
    side = math.ceil(cells(2 * robot.reach() + 0.5))
    heights = np.zeros((2 * side, side), np.float32)
    heights[side : side + 4] = 1.0
    heights[-side // 2 :] = 0.02
    return HeightMap(heights)


class _EvenCosts:
    """Abstract costs in which every action costs 1, evaluated where a query needs them."""

    least = np.ones((ABSTRACT_HEADINGS, N_ABSTRACT_ACTIONS), np.float32)

    def edges(self, height_map: HeightMap, region=None, mask=None) -> np.ndarray:
        first_x, first_y, end_x, end_y = checked_region(height_map, region)
        edges = np.ones((ABSTRACT_HEADINGS, end_x - first_x, end_y - first_y, N_ABSTRACT_ACTIONS), np.float32)
        close_states(edges, mask)
        close_exits(edges, height_map, region)
        return edges
