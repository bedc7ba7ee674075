"""Multi-heuristic A*: heuristics that may be wrong guide the search, and the bound on the cost is proven.

Source: shared MHA* (SMHA*), Aine, Swaminathan, Narayanan, Hwang & Likhachev, IJRR 2016. The search has one store with
states and their costs g, and one open list per heuristic. The *anchor* is a consistent heuristic, so it never exceeds
the cost-to-go. One or more *guides* may have any values. The anchor's keys are ``g + h``, the guides' ``g + W1 h``.

The guides take turns and first search for a plan alone. Often the least key of the anchor over all waiting states
proves the bound at once. Otherwise, the anchor's list takes all waiting states, and the search goes on as SMHA*: a
guide may expand the first state in its list only if the state's key is at most W1 W2 times the anchor's least key.
Otherwise, the anchor expands its own first state. The anchor's least key never exceeds the least cost. A plan that
costs at most W1 W2 times this key is therefore within W1 W2 of the optimum.

Every state is expanded at most twice: once for all guides together, and once for the anchor. With a cost limit, the
anchor also expands a state again when the search finds a cheaper path to it. Otherwise, the limit could exclude states
that were first reached on an expensive path, and "no plan costs less" would not be proven.

Five differences from the paper leave its proofs valid:

- The guides need no leave of the anchor before there is a plan. In the paper, the anchor has to raise its least key
  first, even if the guide's plan will be good enough for its present one.
- The anchor's keys are not inflated, so a backward search behind it goes no farther than the proof of a plan asks: to
  the plan's cost over W1 W2.
- A guide's list also takes states whose key is too large at present, because the anchor's least key rises.
- The search also ends when a guide has to wait and the anchor's key already proves the bound.
- An outdated entry stays in its list until it comes first, and is dropped there.

A guide that takes more than ``_LONG`` expansions to find a plan takes the greater of its own value and the anchor's.
The anchor's backward search then gets about half of the time, and its values count as far as it has come.

The proven bound may be better than W1 W2, see ``kernel.least_f``.
"""

import numpy as np

from hdsp.base.errors import InputError
from hdsp.detailed.actions.successors import MAX_SUCCESSORS, Rules
from hdsp.detailed.search import kernel, multi_kernel
from hdsp.detailed.search.bounds import rounding, suboptimality
from hdsp.detailed.search.estimate import Estimate, begin_from, settle_for
from hdsp.detailed.search.life_cycle import AtEnd, Hopeless, Progress, Search
from hdsp.detailed.search.open_list import first_f
from hdsp.detailed.search.outcome import Limits, SearchResult, Status
from hdsp.detailed.search.store import CUT, EXPANDED, count_waiting, find
from hdsp.detailed.search.weighted_astar import EXPANSIONS_PER_SETTLED, LEAST_SETTLED
from hdsp.detailed.world.world import World

#: Expansions of a search that may gain from the anchor's backward search.
_LONG = 3000


def solve_multi(
    world: World,
    start: np.ndarray,
    goals: np.ndarray,
    anchor: Estimate,
    guides: list[Estimate],
    *,
    weight: float = 1.0,
    anchor_weight: float = 1.0,
    rules: Rules | None = None,
    limits: Limits | None = None,
    hopeless: Hopeless | None = None,
    progress: Progress | None = None,
    at_end: AtEnd | None = None,
) -> SearchResult:
    """Searches with shared multi-heuristic A* from one detailed state to the nearest of one or several goals.

    Args:
        world: terrain and robot.
        start: int64 [7], lattice units (ix, iy, heading, 4 foot offsets).
        goals: int64 [7] or [n, 7]. Goals in which the robot cannot stand are left out.
        anchor: consistent heuristic, 0 at each goal; all proofs rest on it.
        guides: heuristics that may overestimate; a guide leaves states with the value inf to the other heuristics.
        weight: W1 >= 1, factor on the guides.
        anchor_weight: W2 >= 1; W1 W2 is the largest ratio between a guide's key and the anchor's least key.
        rules, limits, hopeless, progress, at_end: see ``solve``.

    Returns:
        A result with one status. The cost of a plan is at most ``bound <= W1 W2`` times the optimum.

    Raises:
        InputError: no guides, or a weight that is not a finite number >= 1.
    """
    for name, value in (("weight", weight), ("anchor_weight", anchor_weight)):
        if not (np.isfinite(value) and value >= 1):
            raise InputError(f"{name} is {value}; it must be a finite number >= 1")
    if not guides:
        raise InputError("a multi-heuristic search needs one guide at least")
    search = _MultiSearch(world, start, goals, rules, limits, progress, nearest=True)
    if (invalid := search.impossible) is not None:
        return SearchResult.of([invalid], [None])
    ended = search.begin_guided(anchor, guides, weight, anchor_weight)
    if ended is None:
        ended = search.run(hopeless)
    result = search.result(ended)
    if at_end is not None and ended != Status.SOLVED:
        at_end(search)
    result.lower_bound = search.lower_bound(ended)
    if ended == Status.SOLVED:
        proved = suboptimality(float(result.cost[0]), result.lower_bound, rounding(world))
        result.bound = min(float(weight * anchor_weight), proved)
    return result


class _MultiSearch(Search):
    """A running search for the nearest goal; the first open list belongs to the anchor, the others to the guides."""

    def begin_guided(
        self, anchor: Estimate, guides: list[Estimate], weight: float, anchor_weight: float
    ) -> Status | None:
        """Puts the start into the lists of the guides; returns as ``begin``."""
        self._set_up(lists=1 + len(guides))
        self._anchor, self._guides = self._within_memory(anchor), tuple(guides)
        if len(anchor.back.place) > 0:
            begin_from(self.world, self._anchor, self.start)
        self._weight, self._bound = float(weight), float(weight * anchor_weight)
        self._guided = np.zeros(len(guides), dtype=np.int64)
        self._once = multi_kernel.ANCHORED if np.isinf(self.limits.cost) else 0
        self._proves = self._starved = False
        valid = self.goals[self.invalid.index(None)]
        self._goal = np.array([find(self.store, self.start if self.start in self.goals else valid)])
        first = np.array([self._first_f(guide) for guide in guides])
        multi_kernel.insert_start(self.store, tuple(self.lists[1:]), first, self.start)
        return self._memory_limit()

    def _run(self, expansions: int) -> int:
        code = self._run_anchored(expansions) if self._proves else self._run_guides(expansions)
        if code == kernel.SOLVED:
            reached = kernel.cheapest_goal(self.store, self.goals)
            self.goal_cost[reached] = self.store.g[self._goal[0]]
        return code

    def _run_guides(self, expansions: int) -> int:
        done = int(self.store.counts[EXPANDED])
        if done >= _LONG and len(self._guides[0].back.place) == 0:
            self._guides = tuple(guide._replace(back=self._anchor.back) for guide in self._guides)
        code = multi_kernel.run_guides(
            self.world, self.rules, self._guides, self.store, tuple(self.lists[1:]), self._guided, self._weight,
            self._goal, self.limits.cost, min(expansions, _LONG - done) if done < _LONG else expansions,
        )  # fmt: skip
        if code not in (kernel.SOLVED, kernel.EXHAUSTED) or (code == kernel.SOLVED and self._is_proved()):
            return code
        # The anchor goes on where the guides have stopped.
        if not self._make_room(0, count_waiting(self.store)):
            self._starved = True
            return kernel.FULL
        self._proves = True
        multi_kernel.push_waiting(self.world, self.store, self.lists[0], self._anchor)
        return kernel.RUNNING

    def _grow(self, entries: int = MAX_SUCCESSORS) -> bool:
        return not self._starved and super()._grow(entries)

    def _is_proved(self) -> bool:
        """Whether a little of the anchor's backward search proves the bound of the guides' plan."""
        if len(self._anchor.back.place) > 0:
            nodes = LEAST_SETTLED + int(self.store.counts[EXPANDED]) // EXPANSIONS_PER_SETTLED
            settle_for(self.world, self._anchor, self.start, nodes)
        cost = float(self.store.g[self._goal[0]])
        proved = suboptimality(cost, self.least_cost(self._anchor), rounding(self.world))
        return proved <= self._bound

    def _run_anchored(self, expansions: int) -> int:
        anchor_list, *guide_lists = self.lists
        return multi_kernel.run(
            self.world, self.rules, self._anchor, self._guides, self.store, anchor_list, tuple(guide_lists),
            self._guided, self._weight, self._bound, self._goal, self.limits.cost, expansions, self._once,
        )  # fmt: skip

    def lower_bound(self, status: Status) -> float:
        """Cost below which no plan exists, given the final status."""
        if status == Status.INFEASIBLE:
            return np.inf
        if status == Status.COST_LIMIT:
            return self.limits.cost * max(0.0, 1 - rounding(self.world) * self.limits.cost)
        least = self.least_cost(self._anchor)
        if not self._proves or not np.isfinite(least):
            return least
        # Keys are rounded to single precision; the plan's cost and its lower bound are not.
        first = float(first_f(self.lists[0], self.store.flags, self._once)) * (1 - 2.0**-23)
        if self.store.counts[CUT]:
            first = min(first, self.limits.cost)
        return max(least, first * max(0.0, 1 - rounding(self.world) * first))

    def count(self, result: SearchResult) -> None:
        super().count(result)
        guided = [int(n) for n in self._guided]
        result.expansions_by = (result.expansions - sum(guided), *guided)
