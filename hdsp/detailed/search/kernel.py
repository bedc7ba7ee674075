"""Weighted A* over packed states: the search kernel.

The kernel serves labels (one start, many goals), planning (one goal, weighted) and anytime planning. Learned heuristics
are inconsistent, so the search reopens states: it expands a state again whenever it finds a cheaper path to it, but
never twice at the same cost. ``store`` keeps the seen states, ``open_list`` the states to expand.

A state waits if it was seen, but not expanded at its present cost.
"""

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.search.estimate import estimate
from hdsp.detailed.search.expansion import begin_at, expand, offer, relax, rises
from hdsp.detailed.search.open_list import FAR, NEAR, list_has_room, pop, push, refill
from hdsp.detailed.search.store import (
    BLOCK,
    BLOCKS,
    CLOSED,
    CUT,
    EXPANDED,
    GOAL,
    GOALS_LEFT,
    VISITED,
    find,
    has_room,
    key_of,
    node_of,
    waits,
)

RUNNING, SOLVED, EXHAUSTED, OVER_COST_LIMIT, FULL = range(5)


@njit(allocates=False)
def mark_goals(store, goals, valid, first):
    """Marks packed states as goals, so that a search notices when it settles one.

    Returns:
        Index of the first goal for which the store has no room; ``len(goals)`` if all are marked.
    """
    for k in range(first, len(goals)):
        if not has_room(store):
            return k
        if valid[k]:
            store.flags[node_of(store, goals[k])] |= GOAL
    return len(goals)


@njit(allocates=False)
def cheapest_goal(store, goals):
    """Index of the goal (packed) with the least cost in the store; -1 if none was seen."""
    best, least = -1, np.float32(np.inf)
    for k in range(len(goals)):
        node = find(store, goals[k])
        if node >= 0 and store.g[node] < least:
            best, least = k, store.g[node]
    return best


@njit(allocates=False)
def insert_start(store, open_list, f, start):
    """Begins a search at a packed state with a value f, float32."""
    push(open_list, f, begin_at(store, start))


@njit(allocates=False, nogil=True)
def push_waiting(world, store, open_list, heuristic, weight):
    """Begins a round: fills an empty open list with all waiting states."""
    for node in range(BLOCK, BLOCK * store.counts[BLOCKS]):
        store.flags[node] &= ~np.uint8(VISITED)
        if waits(store, node):
            offer(world, open_list, store, heuristic, weight, key_of(store, node), node)


@njit(allocates=False, nogil=True)
def least_f(world, store, heuristic):
    """Least ``g + h`` over all waiting states; inf if no state waits.

    With an admissible heuristic, no plan costs less: every optimal plan contains a waiting state to which the search
    knows the plan's path. At first, this state is the start; after its expansion, its successor on the plan; and so on.
    """
    least = np.inf
    for node in range(BLOCK, BLOCK * store.counts[BLOCKS]):
        if waits(store, node):
            least = min(least, np.float64(store.g[node]) + estimate(world, heuristic, key_of(store, node)))
    return least


@njit(allocates=False, nogil=True)
def run(world, rules, heuristic, store, open_list, weight, goals, goal_cost, cost_limit, f_limit, expansions, reopen):
    """Continues the search until it ends, needs more memory or has used its expansions.

    Args:
        world: terrain and robot.
        rules: restrictions of this search.
        heuristic: estimated cost to the goals.
        store, open_list: the search so far; changed in place.
        weight: W >= 1.
        goals: int64 [n], packed goal states, marked by ``mark_goals``.
        goal_cost: float32 [n], inf where a goal is not settled; changed in place.
        cost_limit: states with a higher cost from the start are left out.
        f_limit: the search stops when all remaining states have a larger ``g + W h``.
        expansions: expansion count before the call returns, so the caller can check the clock.
        reopen: whether a state found cheaper after its expansion is expanded again in this round; otherwise, it waits
            for the next round of an anytime search.

    Returns:
        RUNNING, SOLVED (enough goals settled, ``GOALS_LEFT`` is 0), EXHAUSTED (no state left to expand),
        OVER_COST_LIMIT or FULL.
    """
    flags, count = store.flags, store.counts
    until = count[EXPANDED] + expansions
    while count[EXPANDED] < until:
        if not list_has_room(open_list) or not has_room(store):
            return FULL
        if open_list.counts[NEAR] == 0:
            if open_list.counts[FAR] == 0:
                return OVER_COST_LIMIT if count[CUT] else EXHAUSTED
            refill(open_list, flags)
            continue
        if open_list.f[0] > f_limit:
            return OVER_COST_LIMIT
        f = open_list.f[0]
        node = pop(open_list)
        if flags[node] & CLOSED:
            continue
        key = key_of(store, node)
        work = rises(world, open_list, store, heuristic, weight, key, node, f, 0.0)
        if work > 0:
            until -= work
            continue
        g = np.float64(store.g[node])
        if flags[node] & GOAL:
            for k in range(len(goals)):
                if goals[k] == key:
                    count[GOALS_LEFT] -= goal_cost[k] == np.inf
                    goal_cost[k] = g
            if count[GOALS_LEFT] == 0:
                return SOLVED
        flags[node] |= CLOSED | VISITED
        count[EXPANDED] += 1
        for k in range(expand(world, rules, store, key)):
            reached = relax(store, k, g, cost_limit)
            if reached >= 0 and (reopen or not flags[reached] & VISITED):
                offer(world, open_list, store, heuristic, weight, store.out_key[k], reached)
    return RUNNING
