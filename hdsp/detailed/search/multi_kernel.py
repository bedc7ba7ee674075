"""The search kernel of shared multi-heuristic A*, see ``multi_heuristic``."""

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.search.backward import settle_any
from hdsp.detailed.search.estimate import estimate
from hdsp.detailed.search.expansion import begin_at, expand, offer, relax, rises
from hdsp.detailed.search.kernel import EXHAUSTED, FULL, OVER_COST_LIMIT, RUNNING, SOLVED
from hdsp.detailed.search.open_list import first_f, list_has_room, pop, push
from hdsp.detailed.search.store import BLOCK, BLOCKS, CLOSED, CUT, EXPANDED, GOAL, has_room, key_of, waits

#: More bits of ``Store.flags``: expanded for the anchor, expanded for the guides. No search has rounds as well, and
#: ``VISITED`` shares a bit with the first.
ANCHORED, GUIDED = 4, 8

#: Nodes of the backward search that a guide settles per expansion, in about the same time, and expansions between.
_SETTLED = 4
_SHARED = 32


@njit(allocates=False)
def insert_start(store, guide_lists, f, start):
    """Begins a search at a packed state.

    Args:
        store: an empty store; changed in place.
        guide_lists: empty lists; changed in place.
        f: float32 [guides], the start's value for each guide; inf keeps the start out of a list.
        start: the state.
    """
    node = begin_at(store, start)
    for i in range(len(guide_lists)):
        if f[i] < np.inf:
            push(guide_lists[i], f[i], node)


@njit(allocates=False, nogil=True)
def push_waiting(world, store, anchor_list, anchor):
    """Fills the anchor's empty list with all waiting states."""
    for node in range(BLOCK, BLOCK * store.counts[BLOCKS]):
        if waits(store, node):
            offer(world, anchor_list, store, anchor, 1.0, key_of(store, node), node)


@njit(inline="always")
def _offer_to_guides(world, store, guide_lists, guides, weight, key, node):
    """Puts a state whose cost fell into the lists of all guides that may still expand it."""
    if store.flags[node] & (ANCHORED | GUIDED):
        return
    for i in range(len(guide_lists)):
        offer(world, guide_lists[i], store, guides[i], weight, key, node)


@njit(inline="always")
def _have_room(guide_lists):
    room = True
    for i in range(len(guide_lists)):
        room = room and list_has_room(guide_lists[i])
    return room


@njit(allocates=False, nogil=True)
def run_guides(
    world, rules, guides, store, guide_lists, guided, weight, cheapest, cost_limit, expansions
):  # fmt: skip
    """Continues the search for a first plan, by the guides alone.

    Args:
        world: terrain and robot.
        rules: restrictions of this search.
        guides: tuple of heuristics.
        store: the states seen so far; changed in place.
        guide_lists: tuple, one open list per guide; changed in place.
        guided: int64 [guides], expansions by each guide so far; changed in place.
        weight: W1 >= 1.
        cheapest: int64 [1], node of the cheapest goal so far, any goal without one; changed in place.
        cost_limit: states with a higher cost from the start are left out.
        expansions: expansion count before the call returns, so the caller can check the clock.

    Returns:
        SOLVED with a plan, EXHAUSTED when no guide has a state to expand, RUNNING or FULL.
    """
    costs, flags, count = store.g, store.flags, store.counts
    until = count[EXPANDED] + expansions
    goal = cheapest[0]
    while count[EXPANDED] < until:
        if not has_room(store) or not _have_room(guide_lists):
            return FULL
        turn = count[EXPANDED] % len(guide_lists)  # every turn is one expansion
        first = np.float32(np.inf)
        for _ in range(len(guide_lists)):
            first = first_f(guide_lists[turn], flags, GUIDED)
            if first < np.inf:
                break
            turn = (turn + 1) % len(guide_lists)
        if costs[goal] <= first:
            return SOLVED if costs[goal] < np.inf else EXHAUSTED
        node = pop(guide_lists[turn])
        key = key_of(store, node)
        if len(guides[turn].back.place) > 0:
            # The values of the backward search count as far as it has come.
            h = estimate(world, guides[turn], key)
            if np.float32(np.float64(costs[node]) + weight * h) > first:
                offer(world, guide_lists[turn], store, guides[turn], weight, key, node)
                continue
            if count[EXPANDED] % _SHARED == 0:
                settle_any(world, guides[turn].back, _SETTLED * _SHARED)
        guided[turn] += 1
        flags[node] |= CLOSED | GUIDED
        count[EXPANDED] += 1
        g = np.float64(costs[node])
        for k in range(expand(world, rules, store, key)):
            reached = relax(store, k, g, cost_limit)
            if reached >= 0:
                if flags[reached] & GOAL and costs[reached] < costs[goal]:
                    cheapest[0] = goal = reached
                _offer_to_guides(world, store, guide_lists, guides, weight, store.out_key[k], reached)
    return RUNNING


@njit(allocates=False, nogil=True)
def run(
    world, rules, anchor, guides, store, anchor_list, guide_lists, guided, weight, bound, cheapest, cost_limit,
    expansions, once,
):  # fmt: skip
    """Continues the search, with a plan or without guides, until it ends, needs more memory or has used its expansions.

    Args:
        world: terrain and robot.
        rules: restrictions of this search.
        anchor: consistent heuristic.
        guides: tuple of heuristics.
        store: the states seen so far; changed in place.
        anchor_list: open list for the anchor; changed in place.
        guide_lists: tuple, one open list per guide; changed in place.
        guided: int64 [guides], expansions by each guide so far; changed in place.
        weight: W1 >= 1, in the order of the guides.
        bound: W1 W2, largest ratio between a plan's cost and the anchor's least key.
        cheapest: int64 [1], node of the cheapest goal so far, any goal without one; changed in place.
        cost_limit: states with a higher cost from the start are left out; the search stops when no plan within the
            limit remains.
        expansions: expansion count before the call returns, so the caller can check the clock.
        once: flag bits for states that the anchor does not expand again: ``ANCHORED``, or 0 if it may expand any.

    Returns:
        A code as in ``kernel.run``.
    """
    costs, flags, count = store.g, store.flags, store.counts
    until = count[EXPANDED] + expansions
    goal = cheapest[0]
    while count[EXPANDED] < until:
        if not has_room(store) or not list_has_room(anchor_list) or not _have_room(guide_lists):
            return FULL
        least = np.float64(first_f(anchor_list, flags, once))
        if costs[goal] <= least:
            if costs[goal] < np.inf:
                return SOLVED
            return OVER_COST_LIMIT if count[CUT] else EXHAUSTED
        if least > cost_limit:
            return OVER_COST_LIMIT
        turn = count[EXPANDED] % len(guide_lists)  # every turn is one expansion
        guide_list = guide_lists[turn]
        first = first_f(guide_list, flags, ANCHORED | GUIDED)
        if first < np.inf and first <= bound * least:
            if costs[goal] <= first:
                return SOLVED
            node = pop(guide_list)
            guided[turn] += 1
            flags[node] |= CLOSED | GUIDED
        else:
            if costs[goal] <= bound * least:
                return SOLVED
            node = pop(anchor_list)
            wanted = np.float64(costs[goal]) / bound if costs[goal] < np.inf else 0.0
            key = key_of(store, node)
            work = rises(world, anchor_list, store, anchor, 1.0, key, node, np.float32(least), wanted)
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
                if not flags[reached] & once and offer(world, anchor_list, store, anchor, 1.0, key, reached):
                    _offer_to_guides(world, store, guide_lists, guides, weight, key, reached)
    return RUNNING
