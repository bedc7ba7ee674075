"""Weighted A*: plans that cost at most W times the optimum, for planning (one goal) and labels (many goals)."""

from collections.abc import Iterator

import numpy as np

from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.search.bounds import rounding, suboptimality
from hdsp.detailed.search.estimate import Estimate, begin_from, settle_for
from hdsp.detailed.search.life_cycle import AtEnd, GuideTurn, Hopeless, Progress, Search
from hdsp.detailed.search.outcome import Limits, SearchResult, Status
from hdsp.detailed.world.world import World

#: Nodes of the backward search behind a lower bound: at least so many, and one more for so many expansions. The bound
#: then takes about a millisecond, or a small share of the search.
LEAST_SETTLED = 500
EXPANSIONS_PER_SETTLED = 5
#: Expansions of a search that is hard for its heuristic, and worth a backward search over base poses.
HARD = 30_000


def solve(
    world: World,
    start: np.ndarray,
    goals: np.ndarray,
    heuristic: Estimate,
    *,
    weight: float = 1.0,
    admissible: bool = True,
    reopen: bool = True,
    rules: Rules | None = None,
    limits: Limits | None = None,
    paths: bool = True,
    hopeless: Hopeless | None = None,
    progress: Progress | None = None,
    nearest: bool = False,
    at_end: AtEnd | None = None,
    bounding: Estimate | None = None,
    guide: Estimate | None = None,
    guide_from: int = HARD,
    turns: Iterator[GuideTurn] | None = None,
    first_turn: int = HARD,
) -> SearchResult:
    """Searches with weighted A* from one detailed state to one or several goals.

    With a weight above 1, a state is often expanded before the search finds the cheapest path to it. Reopening can then
    take hundreds of expansions per state. Without reopening, the plan still costs at most W times the optimum if the
    heuristic is consistent: each state then costs at most W times its optimum when it is expanded (M. Likhachev et al.,
    ARA*, NIPS 2003, theorem 2).

    A cost limit keeps its meaning without reopening. The limit may exclude a state that the search first reached on an
    expensive path. A search that ends at the limit therefore continues from all states found cheaper after their
    expansion, now with reopening. ``COST_LIMIT`` is proven in both cases, and a plan within the limit is found.

    Args:
        world: terrain and robot.
        start: int64 [7], lattice units (ix, iy, heading, 4 foot offsets).
        goals: int64 [n, 7].
        heuristic: estimated cost to the nearest goal; an overestimate must not be larger than the accepted excess of
            the plan over the optimum.
        weight: W >= 1; with an admissible heuristic, costs are at most W times optimal.
        admissible: whether the heuristic never exceeds the cost to the nearest goal. An admissible heuristic helps to
            prove that no plan keeps the cost limit.
        reopen: whether a state is expanded again when the search finds a cheaper path to it. Without reopening, the
            bound requires a consistent heuristic.
        rules: restrictions, for example in labelling.
        limits: limits that end the search.
        paths: whether to return states and actions.
        hopeless: proof that no plan exists, which takes turns with the search; see ``Search.ask``.
        progress: callback with (expansions, seconds), called regularly.
        nearest: whether the first settled goal ends the search. Its cost is then at most W times the least cost over
            all goals. Goals in which the robot cannot stand are left out.
        at_end: called with the search that ended without a plan, before its states are dropped.
        bounding: admissible heuristic that bounds the cost of a plan from below where ``heuristic`` is not admissible.
            Its backward search settles a few nodes in proportion to the expansions, so that it takes little time.
        guide: admissible heuristic with a backward search, for a ``heuristic`` that has none. Its value counts where it
            is the larger one, from a number of expansions on.
        guide_from: this number.
        turns: turns of other heuristics, see ``Search.take_turns``.
        first_turn: length of the first turn, in expansions.

    Returns:
        A result with one status per goal, or with one status for ``nearest``, and the proven bounds if there is one
        status.
    """
    limits = limits or Limits()
    search = Search(world, start, goals, rules, limits, progress, nearest)
    if None not in search.invalid:
        wrong = [status for status in search.invalid if status][: 1 if nearest else None]
        return SearchResult.of(wrong, [None] * len(wrong))
    if guide is not None:
        begin_from(world, guide, search.start)
        search.guide_later(guide.back, guide_from)
    if turns is not None:
        search.take_turns(first_turn, turns)
    ended = search.begin(heuristic, weight, admissible, reopen)
    if ended is None:
        ended = search.run(hopeless)
    if ended == Status.COST_LIMIT and not reopen:
        ended = search.reopened() or search.run(hopeless)
    result = search.result(ended, paths)
    if at_end is not None and ended != Status.SOLVED:
        at_end(search)
    if len(result.status) == 1:
        _enter_bounds(result, world, weight if admissible else np.inf, limits)
        if bounding is not None and ended == Status.SOLVED and not admissible:
            nodes = LEAST_SETTLED + result.expansions // EXPANSIONS_PER_SETTLED
            settle_for(world, bounding, search.start, nodes)
            result.lower_bound = search.least_cost(bounding)
            result.bound = suboptimality(float(result.cost[0]), result.lower_bound, rounding(world))
    return result


def _enter_bounds(result: SearchResult, world: World, bound: float, limits: Limits) -> None:
    """Writes the proven bounds into a result for one goal, whose plan costs at most ``bound`` times the optimum."""
    (status,), cost = result.status, float(result.cost[0])
    if status == Status.SOLVED and np.isfinite(bound):
        result.bound = float(bound)
        result.lower_bound = cost / bound * (1 - rounding(world) * cost)
    elif status == Status.INFEASIBLE:
        result.lower_bound = np.inf
    elif status == Status.COST_LIMIT:
        result.lower_bound = limits.cost * max(0.0, 1 - rounding(world) * limits.cost)
