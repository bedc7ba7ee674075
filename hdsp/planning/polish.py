"""Polish: windows of a found plan are planned again at W = 1, so that the plan gets cheaper within a small budget.

A *window* is a part of a plan from one of its states to another. The cheapest path between both ends replaces it. The
search for this path knows a good cost limit, the window's present cost, and is therefore short. Long windows find more
than short ones and cost more, so sweeps with longer and longer windows follow each other; windows of one sweep overlap
by half. A window whose cost equals its lower bound is skipped.

Some sweeps trust the heuristic of the query, see `hdsp.detailed.search.windows`: they get through stepping and round
obstacles with few expansions. Exact sweeps follow, and remove the errors that the heuristic leaves, until one of them
finds hardly any.

No window sees another way round. A fast search with a large weight therefore gets other plans beside it: from a short
search with a smaller weight, and from short searches with another abstraction, where the heuristic has one for long
searches. The cheapest of all is polished.

The plan never gets more expensive, and it stays between start and goal. The work is counted in expansions: equal
queries give equal plans, unless the time ends before the expansions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hdsp.base.gradual import now
from hdsp.detailed.actions.action import Action, action_of
from hdsp.detailed.search.bounds import LEAST_GAIN, rounding, suboptimality
from hdsp.detailed.search.weighted_astar import HARD
from hdsp.detailed.search.windows import Windows
from hdsp.planning.answers.plans import Plan
from hdsp.planning.arguments import number
from hdsp.planning.query import Query
from hdsp.robot.lattice import heading_index, offset_steps


class Sweep(NamedTuple):
    """Windows of equal width from the start of a plan to its end.

    Attributes:
        width: least cost of a window; the last one may cost less.
        trust: as in `Windows.path`.
        most: expansions in one window, at most.
    """

    width: float
    trust: float
    most: int


#: Budget of a query that names none, s.
DEFAULT = 0.3
#: Expansions in windows for each second of a budget. Searches are about twice as fast: the clock decides on a
#: slow machine, and in hard queries.
PER_SECOND = 450_000
#: The sweeps; docs/heuristics.md has the reasons.
SWEEPS = (
    Sweep(0.6, 0.0, 10_000),
    Sweep(1.0, 0.9, 10_000),
    Sweep(2.4, 0.9, 20_000),
    Sweep(1.0, 0.0, 20_000),
    Sweep(1.6, 0.0, 20_000),
    Sweep(2.4, 0.0, 40_000),
)
#: An exact sweep that follows a trusting one, and that lowers the cost by a smaller share, is the last.
LITTLE = 0.001
#: Weight of a search that the polish makes good; docs/heuristics.md has the figures.
FAST = 1.25
_LONGEST = 1e9  # s, of a budget that is counted in expansions
#: Weights and most expansions of the searches for another plan; the first one that ends with a plan counts.
OWN = (1.03, 5_000), (1.1, 20_000), (1.25, 30_000)
#: The same for the searches with another abstraction.
OTHER = (1.03, 15_000), (1.25, 15_000)


def polish_seconds(asked: object, default: float) -> float:
    """Returns the budget of a query in seconds; ``default`` for None.

    Raises:
        InputError: no finite number >= 0.
    """
    return default if asked is None else number("polish", asked, 0.0)


def weight_and_polish(weight: object, polish: object, unbounded: bool) -> tuple[float, float]:
    """Returns the weight of a search and the budget of its polish in seconds; each may be None.

    Args:
        weight, polish: as asked.
        unbounded: whether nothing bounds the cost of the plan.

    Raises:
        InputError: a weight below 1, or no finite number >= 0 as a budget.
    """
    if weight is None:
        weight = FAST if unbounded and polish_seconds(polish, DEFAULT) > 0 else 1.0
    weight = number("weight", weight, 1.0)
    return weight, polish_seconds(polish, DEFAULT if unbounded and weight > 1 else 0.0)


@dataclass(frozen=True)
class Polish:
    """Budget for the improvement of plans.

    Attributes:
        seconds: time for one plan; 0 switches the polish off.
        second: whether a plan from a search with a large weight gets other plans beside it.
    """

    seconds: float
    second: bool = False

    def of(self, query: Query, plan: Plan) -> Plan:
        """Returns a plan that costs at most as much; only one of the other plans may end at another goal.

        Args:
            query: the query; its world, its time and its limits hold.
            plan: a plan without its way out.
        """
        began = now()
        most, left = int(PER_SECOND * min(self.seconds, _LONGEST)), query.limits.expansions - plan.stats.expansions
        if not plan.solved or plan.bound == 1 or min(most, left) <= 0 or not plan.actions:
            return plan
        windows = Windows(query.world, query.limits.memory, None if query.admissible else query.estimate)
        ends = min(began + self.seconds, query.ends)
        others, windows.expansions = self._others(query, plan, most, left, min(began + self.seconds / 2, ends))
        most = min(windows.expansions + most, left)
        better = min([plan, *others], key=lambda each: each.cost)
        course, trusted = _Course.of(query, better), False
        for sweep in SWEEPS:
            before, course = course, _swept(course, windows, sweep, most, ends)
            trusted |= sweep.trust > 0
            if trusted and sweep.trust == 0 and before.cost - course.cost < LITTLE * before.cost:
                break
        spent = {"polish_expansions": windows.expansions, "polish_seconds": now() - began, "unpolished_cost": plan.cost}
        plan, cost = plan.renewed(spent), course.cost
        if cost >= plan.cost * (1 - LEAST_GAIN):
            return plan
        return replace(
            plan,
            cost=cost,
            states=query.grid.to_world(course.states),
            actions=course.actions,
            action_costs=course.costs,
            goal_index=better.goal_index,
            bound=min(plan.bound, suboptimality(cost, plan.stats.lower_bound, rounding(query.world))),
        )

    def _others(self, query: Query, plan: Plan, most: int, left: int, ends: float) -> tuple[list[Plan], int]:
        """Returns plans from other searches, and the expansions for them.

        Args:
            query, plan: as in ``of``.
            most, left: expansions of one search and of all, at most.
            ends: moment on the clock ``now`` at which the searches end; the windows need time, too.
        """
        found: list[Plan] = []
        spent, hard = 0, plan.stats.expansions >= HARD
        if not self.second or query.admissible or plan.stats.anchor_weight:
            return found, spent

        def search(query: Query, weight: float, limit: int) -> bool:
            nonlocal spent
            limits = replace(query.limits, expansions=min(limit, most, left - spent))
            if limits.expansions <= 0 or now() >= ends:
                return False
            other = replace(query, limits=limits, ends=ends, progress=None).weighted(weight, bounded=False, hard=hard)
            spent += other.stats.expansions
            if other.solved:
                found.append(other)
            return other.solved

        for weight, limit in OWN:
            if weight >= plan.stats.weight or search(query, weight, limit):
                break
        for prepared in query.others:
            if (estimate := prepared(ends)) is not None:
                other = replace(query, estimate=estimate, whole=None, others=())
                for weight, limit in OTHER:
                    if search(other, weight, limit):
                        break
        return found, spent


class _Course(NamedTuple):
    """A plan in lattice units: int64 [n, 7], the n - 1 actions, and their costs, float64 [n - 1]."""

    states: np.ndarray
    actions: tuple[Action, ...]
    costs: np.ndarray

    @property
    def cost(self) -> float:
        return float(self.costs.sum())

    @classmethod
    def of(cls, query: Query, plan: Plan) -> _Course:
        cells, headings = query.grid.cell(plan.states[:, :2]), heading_index(plan.states[:, 2])
        states = np.column_stack([cells, headings, offset_steps(plan.states[:, 3:])])
        return cls(states, plan.actions, plan.action_costs)


def _swept(course: _Course, windows: Windows, sweep: Sweep, expansions: int, ends: float) -> _Course:
    """Returns a course after one sweep.

    Args:
        course: the course.
        windows: the searches; they count the expansions.
        sweep: the windows.
        expansions: number at which the sweep ends.
        ends: moment on the clock ``now`` at which it ends as well.
    """
    first, end = 0, 0
    while end < len(course.costs) and windows.expansions < expansions and now() < ends:
        spent = np.cumsum(course.costs[first:])
        end = min(first + int(np.searchsorted(spent, sweep.width - 1e-9)) + 1, len(course.costs))
        cost = float(course.costs[first:end].sum())
        limit, (a, b) = cost * (1 - LEAST_GAIN), course.states[[first, end]]
        most = min(sweep.most, expansions - windows.expansions)
        path = windows.path(a, b, limit, most, ends, sweep.trust) if windows.least(a, b) < limit else None
        if path is not None:
            course = _Course(
                np.concatenate([course.states[:first], path.states, course.states[end + 1 :]]),
                (*course.actions[:first], *(action_of(int(code)) for code in path.actions), *course.actions[end:]),
                np.concatenate([course.costs[:first], path.costs, course.costs[end:]]),
            )
            end = first + len(path.costs)
        spent = np.cumsum(course.costs[first:end])
        first += max(int(np.searchsorted(spent, spent[-1] / 2)), 1)
    return course
