"""Multi-heuristic A*: heuristics that may be wrong guide the search, and the bound on the cost is proven.

Source: shared MHA* (SMHA*), Aine, Swaminathan, Narayanan, Hwang & Likhachev, IJRR 2016. The search has one store with
states and their costs g, and one open list per heuristic. The *anchor* is a consistent heuristic, so it never exceeds
the cost-to-go. One or more *guides* may have any values. Keys are ``g + W1 h``.

The guides take turns. A guide may expand the first state in its list only if the state's key is at most W2 times the
anchor's least key. Otherwise, the anchor expands its own first state. The anchor's least key never exceeds W1 times the
least cost. A plan that costs at most W2 times this key is therefore within W1 W2 of the optimum.

Every state is expanded at most twice: once for all guides together, and once for the anchor. With a cost limit, the
anchor also expands a state again when the search finds a cheaper path to it. Otherwise, the limit could exclude states
that were first reached on an expensive path, and "no plan costs less" would not be proven.

Three differences from the paper leave its proofs valid:

- A guide's list also takes states whose key is too large at present, because the anchor's least key rises.
- The search also ends when a guide has to wait and the anchor's key already proves the bound.
- An outdated entry stays in its list until it comes first, and is dropped there.

The proven bound may be better than W1 W2, see ``kernel.least_f``.
"""

import numpy as np

from hdsp.base.errors import InputError
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.search import kernel, multi_kernel
from hdsp.detailed.search.bounds import rounding, suboptimality
from hdsp.detailed.search.estimate import Estimate
from hdsp.detailed.search.life_cycle import AtEnd, Hopeless, Progress, Search
from hdsp.detailed.search.open_list import first_f
from hdsp.detailed.search.outcome import Limits, SearchResult, Status
from hdsp.detailed.search.store import CUT, find
from hdsp.detailed.world.world import World


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
        weight: W1 >= 1, factor on all heuristics.
        anchor_weight: W2 >= 1, largest ratio between a guide's key and the anchor's least key.
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
        """Puts the start into all open lists; returns as ``begin``."""
        self._set_up(lists=1 + len(guides))
        self._anchor, self._guides = anchor, tuple(guides)
        self._weight, self._anchor_weight = float(weight), float(anchor_weight)
        self._guided = np.zeros(len(guides), dtype=np.int64)
        self._once = multi_kernel.ANCHORED if np.isinf(self.limits.cost) else 0
        valid = self.goals[self.invalid.index(None)]
        self._goal = np.array([find(self.store, self.start if self.start in self.goals else valid)])
        anchor_list, *guide_lists = self.lists
        first = np.array([self._first_f(heuristic) for heuristic in (anchor, *guides)])
        multi_kernel.insert_start(self.store, anchor_list, tuple(guide_lists), first, self.start)
        return self._memory_limit()

    def _run(self, expansions: int) -> int:
        anchor_list, *guide_lists = self.lists
        code = multi_kernel.run(
            self.world, self.rules, self._anchor, self._guides, self.store, anchor_list, tuple(guide_lists),
            self._guided, self._weight, self._anchor_weight, self._goal, self.limits.cost, expansions, self._once,
        )  # fmt: skip
        if code == kernel.SOLVED:
            reached = kernel.cheapest_goal(self.store, self.goals)
            self.goal_cost[reached] = self.store.g[self._goal[0]]
        return code

    def lower_bound(self, status: Status) -> float:
        """Cost below which no plan exists, given the final status."""
        if status == Status.INFEASIBLE:
            return np.inf
        if status == Status.COST_LIMIT:
            return float(self.limits.cost)
        least = kernel.least_f(self.world, self.store, self._anchor)
        first = float(first_f(self.lists[0], self.store.flags, self._once)) / self._weight
        # Keys are rounded to single precision; the plan's cost and its lower bound are not.
        least = max(least, first * (1 - 2.0**-23))
        if self.store.counts[CUT]:
            least = min(least, self.limits.cost)
        return least * max(0.0, 1 - rounding(self.world) * least) if np.isfinite(least) else least

    def count(self, result: SearchResult) -> None:
        super().count(result)
        guided = [int(n) for n in self._guided]
        result.expansions_by = (result.expansions - sum(guided), *guided)
