"""The search kernel of shared multi-heuristic A*, see ``multi_heuristic``."""

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.search.expansion import begin_at, expand, offer, relax, rises
from hdsp.detailed.search.kernel import EXHAUSTED, FULL, OVER_COST_LIMIT, RUNNING, SOLVED
from hdsp.detailed.search.open_list import first_f, list_has_room, pop, push
from hdsp.detailed.search.store import CLOSED, CUT, EXPANDED, GOAL, has_room, key_of

#: More bits of ``Store.flags``: expanded for the anchor, expanded for the guides.
ANCHORED, GUIDED = 8, 16


@njit(allocates=False)
def insert_start(store, anchor_list, guide_lists, f, start):
    """Begins a search at a packed state.

    Args:
        store: an empty store; changed in place.
        anchor_list, guide_lists: empty lists; changed in place.
        f: float32 [1 + guides], the start's value for the anchor and for each guide; inf keeps the start out of a list,
            for the anchor out of all lists.
        start: the state.
    """
    node = begin_at(store, start)
    if f[0] < np.inf:
        push(anchor_list, f[0], node)
        for i in range(len(guide_lists)):
            if f[1 + i] < np.inf:
                push(guide_lists[i], f[1 + i], node)


@njit(inline="always")
def _offer_all(world, store, anchor_list, guide_lists, anchor, guides, weight, key, node, once):
    """Puts a state whose cost fell into all lists that may still expand it."""
    flags = store.flags[node]
    if flags & once:
        return
    if not offer(world, anchor_list, store, anchor, weight, key, node):
        return
    if flags & (ANCHORED | GUIDED):
        return
    for i in range(len(guide_lists)):
        offer(world, guide_lists[i], store, guides[i], weight, key, node)


@njit(inline="always")
def _all_have_room(store, anchor_list, guide_lists):
    room = has_room(store) and list_has_room(anchor_list)
    for i in range(len(guide_lists)):
        room = room and list_has_room(guide_lists[i])
    return room


@njit(allocates=False)
def run(
    world, rules, anchor, guides, store, anchor_list, guide_lists, guided, weight, anchor_weight, cheapest, cost_limit,
    expansions, once,
):  # fmt: skip
    """Continues the search until it ends, needs more memory or has used its expansions.

    Args:
        world: terrain and robot.
        rules: restrictions of this search.
        anchor: consistent heuristic.
        guides: tuple of heuristics.
        store: the states seen so far; changed in place.
        anchor_list: open list for the anchor; changed in place.
        guide_lists: tuple, one open list per guide; changed in place.
        guided: int64 [guides], expansions by each guide so far; changed in place.
        weight, anchor_weight: W1 and W2, each >= 1.
        cheapest: int64 [1], node of the cheapest goal so far, any goal without one; changed in place.
        cost_limit: states with a higher cost from the start are left out; the search stops when no plan within the
            limit remains.
        expansions: number of expansions before the call returns, so the caller can check the clock.
        once: flag bits for states that the anchor does not expand again: ``ANCHORED``, or 0 if it may expand any.

    Returns:
        A code as in ``kernel.run``.
    """
    costs, flags, count = store.g, store.flags, store.counts
    until = count[EXPANDED] + expansions
    goal = cheapest[0]
    while count[EXPANDED] < until:
        if not _all_have_room(store, anchor_list, guide_lists):
            return FULL
        least = np.float64(first_f(anchor_list, flags, once))
        if costs[goal] <= least:
            if costs[goal] < np.inf:
                return SOLVED
            return OVER_COST_LIMIT if count[CUT] else EXHAUSTED
        if least > weight * cost_limit:
            return OVER_COST_LIMIT
        turn = count[EXPANDED] % len(guide_lists)  # every turn is one expansion
        guide_list = guide_lists[turn]
        first = first_f(guide_list, flags, ANCHORED | GUIDED)
        if first < np.inf and first <= anchor_weight * least:
            if costs[goal] <= first:
                return SOLVED
            node = pop(guide_list)
            guided[turn] += 1
            flags[node] |= CLOSED | GUIDED
        else:
            if costs[goal] <= anchor_weight * least:
                return SOLVED
            node = pop(anchor_list)
            work = rises(world, anchor_list, store, anchor, weight, key_of(store, node), node, np.float32(least))
            if work > 0:
                until -= work
                continue
            flags[node] |= CLOSED | ANCHORED
        count[EXPANDED] += 1
        g = np.float64(costs[node])
        for k in range(expand(world, rules, store, key_of(store, node))):
            reached = relax(store, k, g, cost_limit)
            if reached >= 0:
                if flags[reached] & GOAL and costs[reached] < costs[goal]:
                    cheapest[0] = goal = reached
                key = store.out_key[k]
                _offer_all(world, store, anchor_list, guide_lists, anchor, guides, weight, key, reached, once)
    return RUNNING
