"""The planner for one terrain and one robot."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from hdsp.abstract.abstract_costs import AbstractCosts, Region
from hdsp.base.errors import InputError
from hdsp.base.gradual import now
from hdsp.base.messages import shown
from hdsp.detailed.search.life_cycle import Hopeless, Progress
from hdsp.detailed.search.outcome import Limits, Status
from hdsp.detailed.search.reached import METRES_PER_RADIAN
from hdsp.detailed.world.world import World
from hdsp.planning.answers.plans import Plan
from hdsp.planning.arguments import (
    callback,
    choice,
    factor,
    falling_weights,
    limits_of,
    number,
    whole,
)
from hdsp.planning.compiled import compile_for
from hdsp.planning.cost_limit import at_most
from hdsp.planning.ends.arrival import Tolerance, several
from hdsp.planning.heuristics import Heuristic
from hdsp.planning.improving import improving_plans
from hdsp.planning.memory import least_memory, memory_limit
from hdsp.planning.polish import DEFAULT, Polish, polish_seconds, weight_and_polish
from hdsp.planning.query import Query
from hdsp.planning.query_start import Asked, begin_query, without_search
from hdsp.planning.query_turns import QueryTurns
from hdsp.planning.refinable import refinable_plan
from hdsp.planning.shared_ground import SharedGround
from hdsp.robot.lattice import Grid
from hdsp.robot.robot import Robot
from hdsp.terrain.conditioning import ConditioningReport
from hdsp.terrain.height_map import HeightMap, as_height_map
from hdsp.terrain.map_filters import ConditioningSettings


class Planner:
    """Plans hybrid driving-stepping locomotion on one terrain.

    Life of a planner: construction compiles the terrain, and in a new installation the planner's code once
    (`hdsp warmup` does so earlier); ``prepare`` computes the map-wide part of the heuristic, else the first query does;
    ``plan`` and ``improve`` answer queries; ``update`` takes over a changed terrain; ``clear`` forgets the last query.

    Several threads may share a planner; their queries and updates take turns. ``cancel`` ends queries of other threads.

    Args:
        terrain: height map with cells of up to 0.2 m, an array [nx, ny] of heights in m with ``resolution``, or the
            path of a map file.
        robot: a ``Robot``, a preset's name, or the path to a YAML file.
        heuristic: ``"geometric"``, ``"grid"``, ``"manual"``, ``"learned"`` (the shipped abstraction for this robot),
            ``"learned:FOLDER"`` (a trained abstraction), a name from another package (entry point
            ``hdsp.heuristics``, or ``"module:function"``: a function ``make(world, terrain)``), any ``AbstractCosts``,
            or a ``Heuristic`` for the same terrain and robot.
        margin: distance between body and obstacles, m; see ``with_margin``.
        resolution: cell size of an array, or of a file without one, m.
        conditioning: True: the terrain is conditioned with default settings (`HeightMap.conditioned`), which leaves an
            exact map as it is. None: the terrain is taken as it is, and needs the detailed resolution.

    Raises:
        InputError: a terrain that is no map, cells of another size without conditioning, an unknown robot or
            heuristic, an abstraction for another robot, or a margin below 0.

    Example:
        >>> import hdsp
        >>> planner = hdsp.Planner(hdsp.HeightMap.flat((120, 120)), robot="momaro", heuristic="manual")
        >>> plan = planner.plan(start=(1.0, 1.5, 0.0), goal=(2.0, 1.5, 0.0))
        >>> str(plan.status), round(plan.cost, 3)
        ('solved', 1.0)
    """

    def __init__(
        self,
        terrain: HeightMap | np.ndarray | str | os.PathLike,
        robot: str | Path | dict | Robot = "momaro",
        heuristic: str | AbstractCosts | Heuristic = "geometric",
        margin: float = 0.0,
        *,
        resolution: float | None = None,
        conditioning: ConditioningSettings | bool | None = True,
    ):
        terrain = as_height_map(terrain, resolution)
        self._ground = SharedGround.made(terrain, Robot.load(robot), heuristic, margin, conditioning)
        self._queries = QueryTurns()
        compile_for(self.robot, self.heuristic)

    def __repr__(self) -> str:
        ground = self._ground
        return f"Planner({ground.robot.name}, heuristic {ground.heuristic.name}, {ground.terrain})"

    def __reduce__(self):
        raise InputError("a planner can be neither pickled nor copied; make another one from its map and robot")

    @property
    def robot(self) -> Robot:
        """The robot, without the margin."""
        return self._ground.robot

    @property
    def terrain(self) -> HeightMap:
        """The map on which the planner plans: the conditioned terrain."""
        return self._ground.terrain

    @property
    def grid(self) -> Grid:
        """The lattice of the map."""
        return self._ground.grid

    @property
    def world(self) -> World:
        """Terrain and robot, compiled, with the margin."""
        return self._ground.world

    @property
    def heuristic(self) -> Heuristic:
        """The heuristic for the map; an update makes another one."""
        return self._ground.heuristic

    @property
    def conditioning(self) -> ConditioningReport | None:
        """Report on the conditioning of the terrain; None without conditioning."""
        return self._ground.map.report

    def prepare(self) -> Planner:
        """Computes the map-wide part of the heuristic now instead of at the first query; returns the planner."""
        with self._queries.lock:
            self.heuristic.prepare()
        return self

    def update(self, terrain: HeightMap, region: Region | None = None) -> Planner:
        """Takes over a changed terrain; returns the planner. Later plans equal the plans from a new planner.

        The update computes only the parts that the changed cells touch: conditioned heights (with the noise estimated
        at construction), terrain costs, and places to stand. The next query computes abstract edges and costs-to-go
        that depend on them. A map with another shape or origin needs everything. A query in another thread keeps its
        map: the update waits for its end (``cancel`` shortens it). After an error, the planner has the map from before.

        Args:
            terrain: the whole height map after the change.
            region: rectangle (first ix, first iy, end ix, end iy) in cells of this map; outside, the map is unchanged.
                None: the change may be anywhere. A region only saves a comparison.

        Raises:
            InputError: another resolution without conditioning, or a region beyond the map.
        """
        if not isinstance(terrain, HeightMap):
            raise InputError(f"terrain is a {type(terrain).__name__}; need a HeightMap")
        with self._queries.lock:
            self._ground = self._ground.updated(terrain, region)
        return self

    def cancel(self) -> None:
        """Ends the queries that have begun in other threads: ``plan`` returns a plan with status ``cancelled``.

        ``improve`` ends after its last plan, and ``stats.ended`` of this plan is ``cancelled``. Within 50 ms, a query
        gets to the next place at which it may end; compilation goes on. Results that later queries share are kept.
        """
        self._queries.cancel()

    def clear(self) -> None:
        """Forgets earlier queries: poses looked at, costs-to-go for the last goal. Map-wide results stay.

        For measurements: the next query takes as long as a first query.
        """
        with self._queries.lock:
            ground = self._ground
            ground.world.base[:] = 0
            ground.world.level_ground[:] = 0
            ground.heuristic.clear()

    def valid(self, pose) -> bool:
        """Whether the robot can stand at a world pose (x, y, theta) with some feet, or in a state with 7 values.

        A robot that can stand may still be unable to get away; see ``can_leave``.

        Raises:
            InputError: a value is not finite, or the pose lies off the map.
        """
        return not self._ground.located(pose)[1]

    def can_leave(self, pose) -> bool:
        """Whether the robot can stand at a pose and get away from it, to a base position as far away as it is long.

        Many poses are valid only on feet off neutral, from which no way leads to neutral feet, on which the robot
        drives. See ``hdsp.planning.ends.nearby``.

        Args:
            pose: as for ``valid``.

        Raises:
            InputError: as from ``valid``.
        """
        return self._ground.can_leave(pose)

    def nearest(self, pose, radius: float = 1.0, *, per_radian: float = METRES_PER_RADIAN) -> np.ndarray | None:
        """Returns the nearest state that the robot can leave, float64 [7], a start or goal for ``plan``.

        The robot stands there on neutral feet, or where it cannot, on the feet from T_a->d.

        Args:
            pose: world pose (x, y, theta) in m and rad; a heading of None is free. Foot offsets do not count.
            radius: largest distance, m.
            per_radian: distance (m) for each radian of difference in heading; the sum of both counts.

        Returns:
            The state; None without any within the radius.

        Raises:
            InputError: as from ``valid``, or a negative radius or distance.

        Example:
            >>> import hdsp
            >>> heights = hdsp.HeightMap.flat((160, 160)).heights.copy()
            >>> heights[80:84] = 1.0  # a wall at x = 2 m
            >>> planner = Planner(heights, resolution=0.025)
            >>> bool(planner.valid((2.0, 2.0, 0.0))), planner.nearest((2.0, 2.0, 0.0)).round(2)[:3].tolist()
            (False, [1.54, 1.99, 0.0])
        """
        return self._ground.nearest(pose, number("radius", radius, 0.0), number("per_radian", per_radian, 0.0))

    def plan(
        self,
        start,
        goal,
        weight: float | None = None,
        *,
        tolerance: Tolerance | None = None,
        start_free: bool = True,
        way_out: bool = False,
        anchor_weight: float | None = None,
        cost: float = np.inf,
        expansions: int = Limits.expansions,
        memory: int = Limits.memory,
        time: float = Limits.time,
        refinable: bool = False,
        polish: float | None = None,
        progress: Progress | None = None,
    ) -> Plan:
        """Plans from start to goal, or to the goal that costs least among several.

        Args:
            start: world pose (x, y, theta) in m and rad, or 7 values with the four foot offsets in m. The nearest
                lattice state counts. Without feet, T_a->d chooses them: least cost, close to neutral.
            goal: the same; a heading of None is free. Where T_a->d finds no neutral feet, the plan may end on any feet.
                A sequence of poses: several goals, and the plan's ``goal_index`` tells which one it reaches.
            tolerance: distance from the goal (m), or distance and difference in heading (m, rad), within which the
                plan may end; see ``hdsp.planning.ends.arrival``. None: it ends at the nearest pose on the lattice.
            start_free: whether the ground under a robot that stands at the start counts as known and free of itself.
                Unknown cells and the robot's own body in the map then do not matter there; ``assumed`` names them. See
                ``hdsp.planning.ends.departure``.
            way_out: whether a robot that stands within the clearance of obstacles may drive straight out first, each
                action away from them (``hdsp.planning.ends.way_out``). The plan's ``way_out`` counts these actions.
            weight: W >= 1 in weighted A*. With an admissible heuristic the cost is at most W times the optimum. None:
                1.25 with a polish, for a heuristic that is not admissible and without an anchor; else 1.
            anchor_weight: W2 >= 1 in multi-heuristic A*. The heuristic guides, the grid heuristic is the anchor.
                The cost is at most W * W2 times the optimum; ``bound`` states the proved factor, often a smaller one.
                An admissible heuristic needs no anchor. None: weighted A*; if the heuristic is not admissible, W
                bounds nothing, and ``bound`` comes from a lower bound on the cost of all plans. All proofs hold over
                all states in which the plan may end.
            cost: largest cost of interest.
            expansions, memory, time: limits in expanded states, bytes, seconds. They hold for the whole query: time
                from its turn to its answer, memory for all that it creates, its heuristic included
                (`hdsp.planning.memory`).
            refinable: refine the plan; while a step cannot be carried out, report it in ``refused`` and search again
                without it.
            polish: time (s) in which windows of the plan are planned again at W = 1, so that it gets cheaper; see
                `hdsp.planning.polish`. 0 switches it off. None: 0.3 s, counted in expansions, for plans whose cost
                nothing bounds (W > 1, not admissible, no anchor), else 0.
            progress: called now and then with (expansions, seconds).

        Returns:
            A plan; ``status`` tells its end, ``explain()`` describes it in words, also an invalid start or goal.

        Raises:
            InputError: a value is not a number, a pose lies off the map, a weight is < 1 or > 1e6, or the memory is
                less than an empty search on this map needs; the message names the least.
            RefinementError: ``refinable``, and an action before the first step cannot be carried out, also after the
                polish.
        """
        anchored = None if anchor_weight is None else factor("anchor_weight", anchor_weight)
        limits, refinable = limits_of(cost, expansions, self._memory(memory), time), choice("refinable", refinable)
        start_free, way_out = choice("start_free", start_free), choice("way_out", way_out)
        unbounded = not self.heuristic.admissible and anchored is None
        weight = None if weight is None else factor("weight", weight)
        weight, polish = weight_and_polish(weight, polish, unbounded)
        compile_for(self.robot, self.heuristic, anchored=anchored is not None, refinable=refinable)
        asked = Asked(start, goal, tolerance, start_free, way_out, weight, limits, callback("progress", progress))

        def answer() -> Plan:
            began = now()
            query = begin_query(self._ground, asked)
            if isinstance(query, Plan):
                return query
            prepared = now() - began

            def search(query: Query, hopeless: Hopeless | None) -> Plan:
                if anchored is None or query.admissible:
                    return query.guided(weight, hopeless)
                return query.anchored(weight, anchored, hopeless)

            plan = query.search_or_prove(at_most(search))
            if refinable:
                plan = refinable_plan(query, at_most(search), plan, Polish(polish, second=True))
            else:
                plan = Polish(polish, second=True).of(query, plan)
            spent = {"heuristic_seconds": prepared + plan.stats.heuristic_seconds, "seconds": now() - began}
            return query.from_start(plan.renewed(spent))

        return self._queries.answer(answer, self._cancelled(weight, (start, goal)))

    def plan_each(self, start, goals: Sequence, weight: float | None = None, **options) -> list[Plan]:
        """Plans from start to each of several goals; returns one plan for each goal.

        The plans share the map-wide part of the heuristic. To the cheapest goal alone, ``plan`` takes less time.

        Args:
            start, weight: as in ``plan``.
            goals: poses as in ``plan``.
            options: as in ``plan``; limits hold for each plan.

        Raises:
            InputError, RefinementError: as in ``plan``.
        """
        poses = several(goals)
        if poses is None:
            raise InputError(f"goals is {shown(goals)}; it must be a sequence of poses")
        plans = [self.plan(start, pose, weight, **options) for pose in poses]
        return [plan.renewed(goal_index=k) if plan.solved else plan for k, plan in enumerate(plans)]

    def improve(
        self,
        start,
        goal,
        weights: Sequence[float] = (3.0, 2.0, 1.5, 1.25, 1.0),
        *,
        tolerance: Tolerance | None = None,
        start_free: bool = True,
        way_out: bool = False,
        cost: float = np.inf,
        expansions: int = Limits.expansions,
        memory: int = Limits.memory,
        time: float = Limits.time,
        refinable: bool = False,
        polish: float | None = None,
        progress: Progress | None = None,
    ) -> Iterator[Plan]:
        """Plans from start to goal: a plan soon, then better plans, each with a proven ``bound`` (ARA*).

        Rounds of weighted A* with falling weights share their states. The search ends at a limit, or with a plan that
        costs at most the last weight times the optimum. A heuristic that is not admissible needs one more round with
        the grid heuristic, which may take long.

        Args:
            start, goal, tolerance, start_free, way_out: as in ``plan``.
            weights: weights of the rounds, falling, each >= 1.
            cost, expansions, memory, time: as in ``plan``, for all rounds together. Time runs from the first ``next``
                on, also while the caller works.
            refinable: yield only plans that can be carried out; as in ``plan``.
            polish: time (s) for the polish of each better plan of a round, as in ``plan``; None: a small budget.
            progress: as in ``plan``; its numbers start again after a refused step.

        Yields:
            Plans, each with a lower cost or a smaller ``bound`` than the plan before. After the search,
            ``stats.ended`` of the last plan names its end: ``solved``, or the limit in the words of ``Status``. A
            search without any plan yields one ``Plan`` with the status of its end.

        Raises:
            InputError: at once, for a value that is not a number, a pose off the map, or weights below 1 or not
                falling.
            RefinementError: as in ``plan``.

        Example:
            >>> import hdsp
            >>> planner = Planner(hdsp.HeightMap.flat((120, 120)), heuristic="manual")
            >>> *_, best = planner.improve((1.0, 1.5, 0.0), (2.0, 1.8, 1.57))
            >>> best.bound, best.stats.ended
            (1.0, 'solved')
        """
        weights = falling_weights(weights)
        limits, refinable = limits_of(cost, expansions, self._memory(memory), time), choice("refinable", refinable)
        start_free, way_out = choice("start_free", start_free), choice("way_out", way_out)
        polish = polish_seconds(polish, DEFAULT)
        compile_for(self.robot, self.heuristic, anytime=True, refinable=refinable)
        progress = callback("progress", progress)
        asked = Asked(start, goal, tolerance, start_free, way_out, weights[0], limits, progress)
        cancelled = self._cancelled(weights[0], (start, goal))

        def timed_query() -> tuple[Query | Plan, float]:
            began = now()
            query = begin_query(self._ground, asked)
            return query, now() - began

        query, prepared = self._queries.answer(timed_query, lambda: (cancelled(), 0.0))
        if isinstance(query, Plan):
            query.stats.end(str(query.status))
            return iter([query])
        plans = improving_plans(query, weights, refinable, Polish(polish), prepared)
        return (query.from_start(plan) for plan in self._queries.answers(plans, cancelled))

    def _memory(self, asked: int) -> int:
        """Limit of a query's memory in bytes; see ``memory_limit``."""
        ground = self._ground
        return memory_limit(whole("memory", asked), ground.heuristic.needed_memory() + least_memory(ground.world))

    def _cancelled(self, weight: float, asked: tuple) -> Callable[[], Plan]:
        """Makes the answer to a cancelled query."""
        return partial(without_search, self._ground, Status.CANCELLED, weight, now(), asked)
