"""A query to a planner: its ends, a search or a proof, and the plan.

One budget of time covers the whole query. The heuristic comes first. The search then runs to its end. A search that
takes long shares the time with a proof that no plan exists (``life_cycle``): both take turns, neither computes anything
twice, and the first plan or proof ends the query. They never disagree, so the clock decides only which comes first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from hdsp.base.gradual import Gradual, now
from hdsp.detailed.actions.action import action_of
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.relaxed.foothold_regions import efforts_to, foothold_region_steps
from hdsp.detailed.relaxed.proofs import Unreachable, nearest_state, proof_steps
from hdsp.detailed.search.estimate import Estimate, grid_estimate, least_foot_cost, with_step_efforts
from hdsp.detailed.search.life_cycle import GuideTurn, Hopeless, Progress, Search
from hdsp.detailed.search.multi_heuristic import solve_multi
from hdsp.detailed.search.outcome import Limits, SearchResult, Status
from hdsp.detailed.search.reached import Reached, reached_by
from hdsp.detailed.search.weighted_astar import HARD, solve
from hdsp.detailed.world.world import World
from hdsp.planning.answers.findings import Inquiry
from hdsp.planning.answers.nearest_pose import Aim
from hdsp.planning.answers.plan_statistics import PlanStatistics
from hdsp.planning.answers.plans import Plan
from hdsp.planning.ends.way_out import WayOut
from hdsp.planning.heuristics import AbstractHeuristic, Heuristic
from hdsp.planning.heuristics.grid import MEMORY
from hdsp.planning.memory import proof_memory
from hdsp.robot.lattice import Grid
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap

#: Budget of the backward search for bounds and hard searches, bytes: about a million poses.
LITTLE = 16 << 20
#: Expansions of a guide's search in one turn.
TURN = 20_000
#: Expansions of the first guide's search from which costs-to-go of the whole map are worth their time. Learned edges of
#: 6 x 6 m take as long as about 200,000 expansions.
LONG = 100_000


#: Computes a guide until a moment on the clock ``now``; returns None if the time is too short.
Prepared = Callable[[float], Estimate | None]


class ReachedStates:
    """Keeps the states that a search without a plan reached.

    Attributes:
        found: the states; None before such an end.
    """

    def __init__(self, goal: np.ndarray):
        self.found: Reached | None = None
        self._goal = goal

    def take(self, search: Search) -> None:
        """Takes over the states of a search at its end."""
        self.found = reached_by(search, self._goal)


@dataclass(frozen=True, eq=False)
class Query:
    """One query, ready for a search.

    Attributes:
        terrain: the map.
        robot: whose plan it is.
        wider: the same robot with its margin, as in ``world``.
        grid: place of the map in the world.
        world: terrain and robot, compiled.
        heuristic: the guide.
        estimate: the guide for this goal, for the kernels.
        start: int64 [7], lattice units.
        goals: int64 [n, 7], states at which the plan may end.
        goal_numbers: int64 [n], number of the goal to which each state belongs.
        admissible, consistent: whether ``estimate`` is, as in ``Heuristic``.
        assumed: changes in the map under the start, in words; see ``Plan``.
        way: way out of the clearance of obstacles, which comes before ``start``; None without one.
        aims: what each goal asks for; empty: the states alone count.
        measured: the planner's map, without changes under the start; None if it is conditioned.
        limits: of the whole query; ``ends`` counts instead of the time. The memory is that of searches and proof.
        held: bytes of everything else, part of the memory in statistics.
        ends: moment on the clock ``now`` at which the time is over.
        progress: called now and then with (expansions, seconds).
        whole: computes the guide for the whole map; None where ``estimate`` covers the map.
        others: compute the guides that take turns with ``estimate`` in a long search.
        bounds: the grid heuristic's estimate, shared by all searches of the query; empty before the first one.
    """

    terrain: HeightMap
    robot: Robot
    wider: Robot
    grid: Grid
    world: World
    heuristic: Heuristic
    estimate: Estimate
    start: np.ndarray
    goals: np.ndarray
    goal_numbers: np.ndarray
    admissible: bool
    consistent: bool
    limits: Limits
    held: int = 0
    ends: float = np.inf
    progress: Progress | None = None
    assumed: tuple[str, ...] = ()
    way: WayOut | None = None
    aims: tuple[Aim, ...] = ()
    measured: HeightMap | None = None
    whole: Prepared | None = None
    others: tuple[Prepared, ...] = ()
    bounds: list[Estimate] = field(default_factory=list)

    @property
    def goal(self) -> np.ndarray:
        """The state, int64 [7], among the goals that is nearest to the start in a straight line."""
        return nearest_state(self.start, self.goals)

    def time_left(self) -> float:
        """Seconds until the time is over, at least 0."""
        return max(0.0, self.ends - now())

    @property
    def may_prove(self) -> bool:
        """Whether the memory suffices for a proof beside a search."""
        return self.limits.memory >= 2 * proof_memory(self.world)

    def weighted(
        self,
        weight: float,
        hopeless: Hopeless | None = None,
        *,
        bounded: bool = True,
        hard: bool = False,
        turns: Iterator[GuideTurn] | None = None,
        first_turn: int | None = None,
    ) -> Plan:
        """Searches with weighted A*.

        A heuristic that is not admissible may know little of the ground that the search meets. From ``HARD`` expansions
        on, the grid heuristic counts where it is larger; its backward search takes more time than an easy search.

        Args:
            weight: W >= 1.
            hopeless: as in ``solve``.
            bounded: whether a plan from a heuristic that is not admissible gets a proved bound nevertheless.
            hard: whether the grid heuristic counts from the beginning, because an earlier search asked for it.
            turns: turns of other guides.
            first_turn: turn length before them, in expansions; None = ``TURN``.
        """
        # No bound is lost without reopening: the heuristic proves none, or it is consistent. At W = 1, a consistent
        # heuristic leads to hardly any state twice, and reopening keeps the optimum up to rounding.
        once = not self.admissible or (self.consistent and weight > 1)
        reached = ReachedStates(self.goal)
        lower = None if self.admissible else self.lower_bounds()
        result = solve(
            self.world,
            self.start,
            self.goals,
            self.estimate,
            weight=weight,
            admissible=self.admissible,
            reopen=not once,
            limits=replace(self.limits, time=self.time_left(), memory=self._memory(hopeless, lower)),
            hopeless=hopeless,
            progress=self.progress,
            nearest=True,
            at_end=reached.take,
            bounding=lower if bounded else None,
            guide=lower,
            guide_from=0 if hard else HARD,
            turns=turns,
            first_turn=TURN if first_turn is None else first_turn,
        )
        return self.plan_of(result, PlanStatistics(self.heuristic.name, float(weight)), reached)

    def guided(self, weight: float, hopeless: Hopeless | None = None) -> Plan:
        """Searches with weighted A*, a long search in turns with other guides; arguments as for ``weighted``."""
        turns = _Turns(self)
        plan = self.weighted(weight, hopeless, turns=iter(turns))
        return plan.renewed({"heuristic_seconds": turns.seconds})

    def anchored(self, weight: float, anchor_weight: float, hopeless: Hopeless | None = None) -> Plan:
        """Searches with multi-heuristic A* and the grid heuristic as the anchor; ``hopeless`` as in ``solve``."""
        reached = ReachedStates(self.goal)
        result = solve_multi(
            self.world,
            self.start,
            self.goals,
            self.grid_anchor(),
            [self.estimate],
            weight=weight,
            anchor_weight=anchor_weight,
            limits=replace(self.limits, time=self.time_left(), memory=self._memory(hopeless)),
            hopeless=hopeless,
            progress=self.progress,
            at_end=reached.take,
        )
        anchored, guided = result.expansions_by or (0, 0)
        stats = PlanStatistics(
            self.heuristic.name,
            float(weight),
            anchor_weight=float(anchor_weight),
            expansions_by={"grid": anchored, self.heuristic.name: guided},
        )
        return self.plan_of(result, stats, reached)

    def grid_anchor(self) -> Estimate:
        """Returns the grid heuristic's estimate for the goals, the consistent heuristic for all proofs."""
        # Half of the memory, since the search needs the rest.
        estimate = self.bounding(min(MEMORY, self.limits.memory // 2))
        if len(estimate.effort) > 0:
            return estimate
        steps = Gradual(foothold_region_steps(self.world, Rules(), least_foot_cost(self.world)))
        if not steps.run(self.ends):
            return estimate
        regions = steps.result
        return with_step_efforts(estimate, regions.region, efforts_to(regions, self.world, self.goals))

    def _memory(self, hopeless: Hopeless | None, lower: Estimate | None = None) -> int:
        """Memory for states and open lists, bytes: without a proof's and without the bounds' backward search."""
        proof = 0 if hopeless is None else proof_memory(self.world)
        return self.limits.memory - proof - (0 if lower is None else min(LITTLE, self.limits.memory // 4))

    def lower_bounds(self) -> Estimate:
        """Returns the grid heuristic's estimate with a small backward search, one for all searches of the query."""
        if not self.bounds:
            self.bounds.append(self.bounding(min(LITTLE, self.limits.memory // 4)))
        return self.bounds[0]

    def bounding(self, memory: int) -> Estimate:
        """Returns the grid heuristic's estimate for the goals, with step efforts as far as they are known.

        Args:
            memory: budget of its backward search, bytes.
        """
        groups = np.unique(self.goal_numbers, return_inverse=True)[1].ravel()
        estimate = grid_estimate(self.world, self.goals, groups, memory)
        if not isinstance(self.heuristic, AbstractHeuristic):
            return estimate
        return with_step_efforts(estimate, self.estimate.region, self.estimate.effort)

    def plan_of(self, result: SearchResult, stats: PlanStatistics, reached: ReachedStates) -> Plan:
        """Returns the plan from a search in world coordinates; ``stats`` holds the search settings."""
        path, status = result.paths[0], result.status[0]
        spent = replace(
            stats,
            expansions=result.expansions,
            seen=result.seen,
            memory=result.memory,
            total_memory=result.memory + self.held,
            search_seconds=result.seconds,
            lower_bound=result.lower_bound,
        )
        return Plan(
            status=status,
            cost=float(result.cost[0]),
            states=np.empty((0, 7)) if path is None else self.grid.to_world(path.states),
            actions=() if path is None else tuple(action_of(int(code)) for code in path.actions),
            action_costs=np.empty(0) if path is None else path.costs,
            stats=spent,
            terrain=self.terrain,
            robot=self.robot,
            bound=result.bound,
            goal_index=None if result.reached is None else int(self.goal_numbers[result.reached]),
            assumed=self.assumed,
            ends=(self.grid.to_world(self.start), self.grid.to_world(self.goal)),
            inquiry=None if status == Status.SOLVED else self.inquiry(status, reached.found),
        )

    def from_start(self, plan: Plan) -> Plan:
        """Returns a plan with the way out of the clearance of obstacles before it."""
        way = self.way
        if way is None or not plan.solved:
            return plan
        before, unpolished = float(way.costs.sum()), plan.stats.unpolished_cost
        return replace(
            plan,
            stats=replace(plan.stats, unpolished_cost=None if unpolished is None else unpolished + before),
            cost=plan.cost + before,
            states=np.concatenate([self.grid.to_world(way.states[:-1]), plan.states]),
            actions=(*(action_of(int(code)) for code in way.actions), *plan.actions),
            action_costs=np.concatenate([way.costs, plan.action_costs]),
            assumed=(*plan.assumed, way.words),
            way_out=len(way.actions),
        )

    def proof(self) -> Proof:
        """Returns a proof of infeasibility that is still to be tried."""
        return Proof(self)

    def without_way(self, plan: Plan, proof: Unreachable | None) -> Plan:
        """Returns a plan that ends infeasible.

        Args:
            plan: plan from a search.
            proof: proof of infeasibility; None after a search through all reachable states.
        """
        if proof is None:
            return plan
        inquiry = plan.inquiry if isinstance(plan.inquiry, Inquiry) else self.inquiry(Status.INFEASIBLE, None)
        return plan.renewed(
            {"lower_bound": np.inf},
            status=Status.INFEASIBLE,
            inquiry=replace(inquiry, status=Status.INFEASIBLE, proof=proof),
        )

    def inquiry(self, status: Status, reached: Reached | None) -> Inquiry:
        """Returns the inquiry into the reasons for a search that ended without a plan."""
        goal = self.goal
        number = int(self.goal_numbers[(self.goals == goal).all(axis=1).argmax()])
        aim = self.aims[number] if self.aims else Aim(goal)
        return Inquiry(
            self.terrain, self.robot, self.wider, self.start, goal, aim, status, reached, measured=self.measured,
            seconds=self.limits.time,
        )  # fmt: skip

    def without_path(self, plan: Plan, status: Status) -> Plan:
        """Returns the answer where a plan breaks a limit: no plan, with the effort so far.

        Args:
            plan: a plan that costs too much, or that was not refined in time.
            status: the limit.
        """
        path: dict[str, Any] = {"states": np.empty((0, 7)), "actions": (), "action_costs": np.empty(0)}
        inquiry = self.inquiry(status, None)
        return replace(plan, status=status, cost=np.inf, bound=np.inf, goal_index=None, inquiry=inquiry, **path)

    def search_or_prove(self, search: Solver) -> Plan:
        """Searches; a search that takes long shares its time with a proof of infeasibility.

        A proof takes longer than most searches and names the obstacle. A search without a plan would take very long.
        """
        proof = self.proof()
        plan = search(self, proof.succeeds_by if self.may_prove else None)
        if plan.status != Status.INFEASIBLE:
            return plan.renewed({"proof_seconds": proof.seconds})
        # A search through all reachable states proves as much, but names no obstacle.
        if self.may_prove:
            proof.succeeds_by(self.ends)
        return self.without_way(plan, proof.found).renewed({"proof_seconds": proof.seconds})


class _Turns:
    """Turns of the guides in a long search: ``TURN`` expansions each, one after the other.

    An abstraction that is wrong in one place lets a search fill the ground before it. Another abstraction is seldom
    wrong in the same place. Each guide has a search of its own, which goes on in its turns, so nothing is computed
    twice. With n guides, the whole search takes at most n times the expansions of the best guide alone, and n - 1
    turns. Equal shares are the best choice for the worst case, and longer turns would only raise the bound. A first
    turn of half the length would halve the rest for two guides; it did not save expansions on hard pairs.

    The first guide covers the whole map from ``LONG`` expansions of its own on.

    Attributes:
        seconds: time in which guides were prepared.
    """

    def __init__(self, query: Query):
        self.seconds = 0.0
        self._query = query
        self._prepared: dict[Prepared, Estimate] = {}

    def __iter__(self) -> Iterator[GuideTurn]:
        query, done = self._query, TURN
        if not query.others and query.whole is None:
            return
        while True:
            for number, other in enumerate(query.others, 1):
                yield GuideTurn(number, partial(self._guide, other), TURN)
            whole = query.whole if done >= LONG else None
            yield GuideTurn(0, partial(self._guide, whole), TURN)
            done += TURN

    def _guide(self, prepared: Prepared | None, until: float) -> Estimate | None:
        if prepared is None:
            return self._query.estimate
        if prepared not in self._prepared:
            began = now()
            estimate = prepared(until)
            self.seconds += now() - began
            if estimate is None:
                return None
            self._prepared[prepared] = estimate
        return self._prepared[prepared]


#: A search for a query, with a proof to try during it.
Solver = Callable[[Query, Hopeless | None], Plan]


class Proof:
    """A proof of infeasibility, tried in steps.

    Attributes:
        found: the proof; None without one, or before it is complete.
    """

    def __init__(self, query: Query):
        self.found: Unreachable | None = None
        self._steps: Gradual[Unreachable | None] = Gradual(proof_steps(query.world, query.start, query.goals))

    @property
    def seconds(self) -> float:
        """Time spent so far."""
        return self._steps.seconds

    def succeeds_by(self, ends: float) -> bool | None:
        """Continues until a moment on the clock ``now``; returns whether there is a proof, None before its end."""
        if not self._steps.run(ends):
            return None
        self.found = self._steps.result
        return self.found is not None
