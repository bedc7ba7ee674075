"""Anytime repairing A* (ARA*): a first plan soon, then cheaper plans, each with a proven suboptimality bound.

Source: Likhachev, Gordon & Thrun, NIPS 2003. Rounds of weighted A* with falling weights share one store. A round
continues from all states not yet expanded at their present cost, and expands each state at most once. Only the last
round expands a state again when it finds a cheaper path to it; the heuristic may therefore be inconsistent.

The bound is independent of the heuristic that guides the rounds, see ``kernel.least_f``.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hdsp.detailed.search import kernel
from hdsp.detailed.search.bounds import LEAST_GAIN, rounding, suboptimality
from hdsp.detailed.search.estimate import Estimate
from hdsp.detailed.search.life_cycle import AtEnd, Hopeless, Progress, Search
from hdsp.detailed.search.outcome import Limits, Path, SearchResult, Status
from hdsp.detailed.search.store import find
from hdsp.detailed.world.world import World

_CAPS = Status.EXPANSION_LIMIT, Status.MEMORY_LIMIT, Status.TIME_LIMIT


@dataclass
class Improvement:
    """State of an anytime search after a better plan or a round.

    Attributes:
        result: best plan so far, if any, with its proven bounds; its status is ``SOLVED`` as soon as a plan exists.
        weight: W in the present round.
        ended: final status, None while the search continues. A search with a plan ends ``SOLVED``, unless a limit on
            expansions, memory or time ends it before the proof.
    """

    result: SearchResult
    weight: float
    ended: Status | None = None


def improve(
    world: World,
    start: np.ndarray,
    goals: np.ndarray,
    weights: Sequence[float],
    admissible: Estimate,
    guide: Estimate | None = None,
    *,
    limits: Limits | None = None,
    hopeless: Hopeless | None = None,
    progress: Progress | None = None,
    at_end: AtEnd | None = None,
) -> Iterator[Improvement]:
    """Searches in rounds and yields after each better plan and each round.

    The search ends after the round that proves a plan to cost at most the last weight times the optimum. It also ends
    at a limit, or when no plan exists.

    Args:
        world: terrain and robot.
        start: int64 [7], lattice units.
        goals: int64 [7] or [n, 7]; the nearest counts.
        weights: one W >= 1 per round, falling.
        admissible: heuristic that never exceeds the cost to the nearest goal; all bounds rest on it.
        guide: heuristic for the rounds. One more round follows, with the admissible heuristic and the last weight.
            None = the admissible heuristic guides all rounds.
        limits: for all rounds together; time counts from the first ``next``.
        hopeless: proof that no plan exists; it takes turns with the search until there is a plan, see ``Search.ask``.
        progress, at_end: see ``solve``.

    Yields:
        The best result so far, possibly without a plan. Costs never rise, lower bounds never fall. Only the last
        improvement has ``ended``.
    """
    search = Search(world, start, goals, limits=limits, progress=progress, nearest=True)
    if (invalid := search.impossible) is not None:
        yield Improvement(SearchResult.of([invalid], [None]), weights[0], invalid)
        return
    rounds = [(admissible if guide is None else guide, weight, guide is None, False) for weight in weights]
    rounds = [*(rounds if guide is not None else rounds[:-1]), (admissible, weights[-1], True, True)]
    found = _Found(search, admissible)
    for i, order in enumerate(rounds):
        status = search.begin_round(*order) if i else search.begin(*order)
        while status is None:
            status = search.advance(search.alone if hopeless and not found.plan else None)
            if found.look():
                if status is None:
                    yield found.improvement(order[1])
                continue
            answer = None if hopeless is None or found.plan else search.ask(hopeless, status)
            if answer:
                found.lower_bound = np.inf
                if at_end is not None:
                    at_end(search)
                yield found.improvement(order[1], Status.INFEASIBLE)
                return
            if answer is False:
                hopeless = None
        found.look(thorough=True)
        last = i + 1 == len(rounds)
        ended: Status | None
        if found.plan and (found.bound() <= weights[-1] or (last and status not in _CAPS)):
            ended = Status.SOLVED
        else:
            ended = status if last or status in _CAPS else None
        if at_end is not None and ended is not None and not found.plan:
            at_end(search)
        yield found.improvement(order[1], ended)
        if ended is not None:
            return


class _Found:
    """Best plan in a running search, and a lower bound on the cost of any plan."""

    def __init__(self, search: Search, admissible: Estimate):
        self.search, self.admissible = search, admissible
        self.rounding = rounding(search.world)
        self.cost, self.lower_bound = np.inf, 0.0
        self.plan: Path | None = None
        self.reached: int | None = None

    def look(self, thorough: bool = False) -> bool:
        """Takes over a better plan, and returns whether there is one.

        A better plan or ``thorough`` updates the lower bound.
        """
        # The cost in the store may exceed the cost of the stored path, because states on the path became cheaper later.
        # Only the cost of the path itself shows whether the plan is better.
        store, goals = self.search.store, self.search.goals
        nearest = kernel.cheapest_goal(store, goals)
        seen = np.inf if nearest < 0 else float(store.g[find(store, goals[nearest])])
        better = False
        if np.isfinite(seen) and (thorough or seen < self.cost * (1 - LEAST_GAIN)):
            plan = self.search.path(int(goals[nearest]))
            better = self.plan is None or plan.cost < self.cost * (1 - LEAST_GAIN)
            if better:
                self.plan, self.cost, self.reached = plan, plan.cost, nearest
        if better or thorough:
            self.lower_bound = max(self.lower_bound, self.search.least_cost(self.admissible))
        return better

    def bound(self) -> float:
        return suboptimality(self.cost, self.lower_bound, self.rounding)

    def improvement(self, weight: float, ended: Status | None = None) -> Improvement:
        status = Status.SOLVED if self.plan else ended or Status.TIME_LIMIT
        result = SearchResult.of([status], [self.plan])
        result.reached = self.reached
        result.lower_bound, result.bound = self.lower_bound, self.bound() if self.plan else np.inf
        self.search.count(result)
        return Improvement(result, weight, ended)
