"""Anytime repair: a first plan soon, then better ones, each with a proven bound on how far it is from optimal.

Source: ARA*, Likhachev, Gordon & Thrun, NIPS 2003. Rounds of weighted A* with falling weights share one store: a round
goes on from all states that were not expanded at their present cost, and expands each of them once at most. Only the
last round expands a state again when a cheaper way to it is found, so that heuristics need not be consistent.

The bound does not rest on the heuristic that guides the rounds: see ``kernel.least_f``.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hdsp.detailed.search import kernel
from hdsp.detailed.search.bounds import LEAST_GAIN, rounding, suboptimality
from hdsp.detailed.search.estimate import Estimate
from hdsp.detailed.search.life_cycle import Progress, Search
from hdsp.detailed.search.outcome import Limits, Path, SearchResult, Status
from hdsp.detailed.search.store import CUT, EXPANDED, find
from hdsp.detailed.world.world import World

_CAPS = Status.EXPANSION_LIMIT, Status.MEMORY_LIMIT, Status.TIME_LIMIT


@dataclass
class Improvement:
    """How far an anytime search has come.

    Attributes:
        result: the best plan so far, or none, and what is proved of it; its status is ``SOLVED`` as soon as there is a
            plan.
        weight: of the present round.
        ended: what ended the search, ``SOLVED`` if no limit did; None while it goes on.
    """

    result: SearchResult
    weight: float
    ended: Status | None = None


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
    progress: Progress | None = None,
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
    search = Search(world, start, goal, limits=limits, progress=progress)
    (invalid,) = search.invalid
    if invalid is not None:
        yield Improvement(SearchResult.of([invalid], [None]), weights[0], invalid)
        return
    rounds = [(admissible if guide is None else guide, weight, guide is None, False) for weight in weights]
    rounds = [*(rounds if guide is not None else rounds[:-1]), (admissible, weights[-1], True, True)]
    found = _Found(search, admissible)
    for i, order in enumerate(rounds):
        status = search.begin_round(*order) if i else search.begin(*order)
        while status is None:
            status = search.advance()
            if status is None and found.look():
                yield found.improvement(order[1])
            elif status is None and hopeless and not found.plan and search.store.count[EXPANDED] >= ask_after:
                if hopeless():
                    found.lower_bound = np.inf
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

    def __init__(self, search: Search, admissible: Estimate):
        self.search, self.goal, self.admissible = search, int(search.goals[0]), admissible
        self.rounding = rounding(search.world)
        self.cost, self.lower_bound = np.inf, 0.0
        self.plan: Path | None = None

    def look(self, thorough: bool = False) -> bool:
        """Take over a better plan if there is one; then, or if told to be thorough, bound its cost again."""
        # A state's cost in the store may exceed that of the way there, whose states got cheaper since. So a plan from
        # the store is no better because the store says so, and may be where it does not.
        store = self.search.store
        seen = float(store.g[find(store, self.goal)])
        better = False
        if np.isfinite(seen) and (thorough or seen < self.cost * (1 - LEAST_GAIN)):
            plan = self.search.path(self.goal)
            better = self.plan is None or plan.cost < self.cost * (1 - LEAST_GAIN)
            if better:
                self.plan, self.cost = plan, plan.cost
        if better or thorough:
            least = kernel.least_f(store, self.admissible)
            if store.count[CUT]:
                least = min(least, self.search.limits.cost)
            if np.isfinite(least):
                least *= max(0.0, 1 - self.rounding * least)
            self.lower_bound = max(self.lower_bound, least)
        return better

    def bound(self) -> float:
        return suboptimality(self.cost, self.lower_bound, self.rounding)

    def improvement(self, weight: float, ended: Status | None = None) -> Improvement:
        status = Status.SOLVED if self.plan else ended or Status.TIME_LIMIT
        result = SearchResult.of([status], [self.plan])
        result.lower_bound, result.bound = self.lower_bound, self.bound() if self.plan else np.inf
        self.search.count(result)
        return Improvement(result, weight, ended)
