"""Multi-heuristic A*: guided by heuristics that may be wrong, with a proved bound on the cost.

Source: shared MHA* (SMHA*), Aine, Swaminathan, Narayanan, Hwang & Likhachev, IJRR 2016. One store of states and their
costs g, one open list per heuristic: the *anchor*, which is consistent (so it never exceeds the cost to go), and one or
more *guides*, which may say anything. Keys are ``g + W1 h``. The guides take turns; a guide may expand the first state
of its list only if its key is at most W2 times the anchor's least key; else the anchor expands its own first state. As
the anchor's least key never exceeds W1 times the least cost, a plan that costs at most W2 times that key is within
W1 W2 of optimal. Every state is expanded twice at most: once for all guides together, and once for the anchor. Only
with a limit on the cost does the anchor expand a state again when a cheaper way to it is found: else the limit could
keep out what was reached by a dear way first, and "no plan costs less" would be no proof.

Three departures from the paper, none of which touches its proofs. A guide's list also takes states whose key is too
large by now, because the anchor's least key rises. The search also ends where a guide is held back and the anchor's
key proves the bound already. And lists are never searched for outdated entries; these are dropped when they come first.

What the search proves may be better than W1 W2, see ``kernel.least_f``.
"""

import numpy as np

from hdsp.base.errors import InputError
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.search import kernel, multi_kernel
from hdsp.detailed.search.bounds import rounding, suboptimality
from hdsp.detailed.search.estimate import Estimate
from hdsp.detailed.search.life_cycle import Progress, Search
from hdsp.detailed.search.open_list import first_f
from hdsp.detailed.search.outcome import Limits, SearchResult, Status
from hdsp.detailed.search.store import CUT, find
from hdsp.detailed.world.world import World


def solve_multi(
    world: World,
    start: np.ndarray,
    goal: np.ndarray,
    anchor: Estimate,
    guides: list[Estimate],
    *,
    weight: float = 1.0,
    anchor_weight: float = 1.0,
    rules: Rules | None = None,
    limits: Limits | None = None,
    progress: Progress | None = None,
) -> SearchResult:
    """Shared multi-heuristic A* from one detailed state to another.

    Args:
        world: terrain and robot.
        start, goal: int64 [7], lattice units (ix, iy, heading, 4 foot offsets).
        anchor: consistent heuristic, 0 at the goal; all that is proved follows from it.
        guides: heuristics that may overestimate; states for which one is inf are left to the others.
        weight: W1 >= 1, by which all heuristics are multiplied.
        anchor_weight: W2 >= 1, by how much guides may be ahead of the anchor.
        rules, limits, progress: as in ``solve``.

    Returns:
        A result with one status. If solved, its cost is at most ``bound <= W1 W2`` times optimal.

    Raises:
        InputError: without guides, or for a weight that is no finite number >= 1.
    """
    for name, value in (("weight", weight), ("anchor_weight", anchor_weight)):
        if not (np.isfinite(value) and value >= 1):
            raise InputError(f"{name} is {value}; it must be a finite number >= 1")
    if not guides:
        raise InputError("a multi-heuristic search needs one guide at least")
    search = _MultiSearch(world, start, goal, rules, limits, progress)
    (invalid,) = search.invalid
    if invalid is not None:
        return SearchResult.of([invalid], [None])
    ended = search.begin_guided(anchor, guides, weight, anchor_weight)
    while ended is None:
        ended = search.advance()
    result = search.result(ended)
    result.lower_bound = search.lower_bound(ended)
    if ended == Status.SOLVED:
        proved = suboptimality(float(result.cost[0]), result.lower_bound, rounding(world))
        result.bound = min(float(weight * anchor_weight), proved)
    return result


class _MultiSearch(Search):
    """A search under way for one goal; the first open list is the anchor's, the others are those of the guides."""

    def begin_guided(
        self, anchor: Estimate, guides: list[Estimate], weight: float, anchor_weight: float
    ) -> Status | None:
        """Put the start in all open lists; returns as ``begin``."""
        self._set_up(lists=1 + len(guides))
        self._anchor, self._guides = anchor, tuple(guides)
        self._weight, self._anchor_weight = float(weight), float(anchor_weight)
        self._guided = np.zeros(len(guides), dtype=np.int64)
        self._once = multi_kernel.ANCHORED if np.isinf(self.limits.cost) else 0
        self._goal = int(find(self.store, self.goals[0]))
        anchor_list, *guide_lists = self.lists
        multi_kernel.insert_start(
            self.store, anchor_list, tuple(guide_lists), anchor, self._guides, self._weight, self.start, self._once
        )
        return self._memory_limit()

    def _run(self, expansions: int) -> int:
        anchor_list, *guide_lists = self.lists
        code = multi_kernel.run(
            self.world, self.rules, self._anchor, self._guides, self.store, anchor_list, tuple(guide_lists),
            self._guided, self._weight, self._anchor_weight, self._goal, self.limits.cost, expansions, self._once,
        )  # fmt: skip
        if code == kernel.SOLVED:
            self.goal_cost[0] = self.store.g[self._goal]
        return code

    def lower_bound(self, status: Status) -> float:
        """Cost below which there is no plan, after a search that ended like this."""
        if status == Status.INFEASIBLE:
            return np.inf
        if status == Status.COST_LIMIT:
            return float(self.limits.cost)
        least = kernel.least_f(self.store, self._anchor)
        first = float(first_f(self.lists[0], self.store.flags, self._once)) / self._weight
        # Keys are rounded to single precision, what is compared with the plan's cost is not.
        least = max(least, first * (1 - 2.0**-23))
        if self.store.count[CUT]:
            least = min(least, self.limits.cost)
        return least * max(0.0, 1 - rounding(self.world) * least) if np.isfinite(least) else least

    def count(self, result: SearchResult) -> None:
        super().count(result)
        guided = [int(n) for n in self._guided]
        result.expansions_by = (result.expansions - sum(guided), *guided)
