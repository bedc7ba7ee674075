"""Anytime repair: a first plan soon, then better ones, each with a proven bound on how far it is from optimal.

Source: ARA*, Likhachev, Gordon & Thrun, NIPS 2003. Rounds of weighted A* with falling weights share one store: a round
goes on from all states that were not expanded at their present cost, and expands each of them once at most. Only the
last round expands a state again when a cheaper way to it is found, so that heuristics need not be consistent.

The bound does not rest on the heuristic that guides the rounds: see ``search.least_f``.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hdsp.detailed.actions.state_costs import state_cost
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.search import kernel as search
from hdsp.detailed.search.estimate import Estimate, geometric_estimate
from hdsp.detailed.search.solve import Limits, Search, SearchResult, Status
from hdsp.detailed.search.store import CUT, EXPANDED, find
from hdsp.detailed.states import pack_states
from hdsp.detailed.world.world import World

#: By this share a plan must cost less than another to be better.
LEAST_GAIN = 1e-6

_CAPS = Status.EXPANSION_LIMIT, Status.MEMORY_LIMIT, Status.TIME_LIMIT


@dataclass
class Improvement:
    """How far an anytime search has come.

    Attributes:
        result: the best plan so far, or none; its status is ``SOLVED`` as soon as there is one.
        lower_bound: no plan costs less.
        weight: of the present round.
        ended: what ended the search, ``SOLVED`` if no limit did; None while it goes on.
    """

    result: SearchResult
    lower_bound: float
    weight: float
    ended: Status | None = None


def rounding(world: World) -> float:
    """Share r * c by which the cost c of a way may be wrong in the store, which adds up in single precision: half a
    unit in the last place per action, and no action costs less than the least that the geometric heuristic counts."""
    e = geometric_estimate(world, np.zeros(7, dtype=np.int64))
    return 2.0**-24 / min(cost for cost in (e.distance, e.turn, e.foot) if cost > 0)


def suboptimality(cost: float, lower_bound: float, rounding: float) -> float:
    """The least bound >= 1 on cost / least cost; exactly 1 if only rounding (see there) lies between."""
    if lower_bound >= cost * (1 - 3 * rounding * cost):
        return 1.0 if np.isfinite(cost) else np.inf
    return cost / lower_bound if lower_bound > 0 else np.inf


def improve(
    world: World,
    start: np.ndarray,
    goal: np.ndarray,
    weights: Sequence[float],
    admissible: Estimate,
    guide: Estimate | None = None,
    *,
    limits: Limits | None = None,
    hopeless: Callable[[], bool] | None = None,
    ask_after: int = 50_000,
    progress=None,
) -> Iterator[Improvement]:
    """Search in rounds, and tell whenever a better plan is found or a round ends.

    The search ends when a plan is proved to cost at most the last weight times the optimum.

    Args:
        world: terrain and robot.
        start, goal: int64 [7], lattice units.
        weights: of the rounds, falling, each >= 1.
        admissible: heuristic that never exceeds the cost to the goal; all bounds follow from it.
        guide: heuristic of the rounds, which the last weight's with the admissible one then follows; None: that one.
        limits: for all rounds together; time counts from the first ``next``.
        hopeless: asked once, after ``ask_after`` expansions without a plan: whether it is known that there is none.
        progress: as in ``solve``.

    Yields:
        What was found so far, also if that is no plan yet: costs never rise, lower bounds never fall. The last one, and
        no other, has ``ended``.
    """
    began = time.perf_counter()
    limits = limits or Limits()
    start_key, goal_key = (int(pack_states(state, world.tables.lowest)[0]) for state in (start, goal))
    for status, key in ((Status.INVALID_START, start_key), (Status.INVALID_GOAL, goal_key)):
        if not np.isfinite(state_cost(world, key)):
            yield Improvement(_without_plan(status), 0.0, weights[0], status)
            return
    rounds = [(admissible if guide is None else guide, weight, guide is None, False) for weight in weights]
    rounds = [*(rounds if guide is not None else rounds[:-1]), (admissible, weights[-1], True, True)]
    task = Search(world, start_key, np.array([goal_key]), Rules(), limits, progress, began)
    found = _Found(task, goal_key, admissible)
    for i, order in enumerate(rounds):
        status = None if (task.begin_round(*order) if i else task.begin(*order)) else Status.MEMORY_LIMIT
        while status is None:
            status = task.advance()
            if status is None and found.look():
                yield found.improvement(order[1])
            elif status is None and hopeless and not found.plan and task.store.count[EXPANDED] >= ask_after:
                if hopeless():
                    found.lower = np.inf
                    yield found.improvement(order[1], Status.INFEASIBLE)
                    return
                hopeless = None
        found.look(thorough=True)
        last = i + 1 == len(rounds)
        if found.plan and (found.bound() <= weights[-1] or (last and status not in _CAPS)):
            ended = Status.SOLVED
        else:
            ended = status if last or status in _CAPS else None
        yield found.improvement(order[1], ended)
        if ended is not None:
            return


class _Found:
    """The best plan of a search under way, and the cost below which there is none."""

    def __init__(self, task: Search, goal: int, admissible: Estimate):
        self.task, self.goal, self.admissible = task, goal, admissible
        self.rounding = rounding(task.world)
        self.cost, self.lower = np.inf, 0.0
        self.plan: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    def look(self, thorough: bool = False) -> bool:
        """Take over a better plan if there is one; then, or if told to be thorough, bound its cost anew."""
        # A state's cost in the store may exceed that of the way there, whose states got cheaper since. So a plan from
        # the store is no better because the store says so, and may be where it does not.
        node = find(self.task.store, self.goal)
        seen = float(self.task.store.g[node])
        better = False
        if np.isfinite(seen) and (thorough or seen < self.cost * (1 - LEAST_GAIN)):
            plan = self.task.path(self.goal)
            better = self.plan is None or plan[2].sum() < self.cost * (1 - LEAST_GAIN)
            if better:
                self.plan, self.cost = plan, float(plan[2].sum())
        if better or thorough:
            least = search.least_f(self.task.store, self.admissible)
            if self.task.store.count[CUT]:
                least = min(least, self.task.limits.cost)
            if np.isfinite(least):
                least *= max(0.0, 1 - self.rounding * least)
            self.lower = max(self.lower, least)
        return better

    def bound(self) -> float:
        return suboptimality(self.cost, self.lower, self.rounding)

    def improvement(self, weight: float, ended: Status | None = None) -> Improvement:
        status = Status.SOLVED if self.plan else ended or Status.TIME_LIMIT
        result = SearchResult([status], np.full(1, self.cost), *([part] for part in self.plan or (None, None, None)))
        self.task.count(result)
        return Improvement(result, self.lower, weight, ended)


def _without_plan(status: Status) -> SearchResult:
    return SearchResult([status], np.full(1, np.inf), [None], [None], [None])
