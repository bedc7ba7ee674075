"""Repair of costs-to-go after an edge change (Ramalingam & Reps 1996)."""

import heapq

import numpy as np

from hdsp.abstract.dijkstra import N_DRIVE
from hdsp.base.jit import njit
from hdsp.robot.lattice import N_ABSTRACT_ACTIONS


@njit(nogil=True)
def repair(incoming, offsets, distance, margin, initial, sources, most):
    """Updates `distance` in place; flat arrays and indices as in `hdsp.abstract.dijkstra.search`.

    `initial` is the cost from a state straight to a goal, inf for most states.
    Returns False if more than `most` states would be dropped, or too many searched again; `distance` is then invalid.
    """
    given_up = np.zeros(len(distance), np.bool_)
    queued = np.zeros(len(distance), np.bool_)
    lost = np.empty(most, np.int64)
    count = 0
    # In order of former cost: every state that may explain another one is decided before it.
    waiting = [(distance[state], state) for state in sources if distance[state] < np.inf]
    for _, state in waiting:
        queued[state] = True
    heapq.heapify(waiting)
    while waiting:
        former, state = heapq.heappop(waiting)
        if _least(incoming, offsets, distance, initial, given_up, margin, state) <= former:
            continue
        if count == most:
            return False
        given_up[state] = True
        lost[count] = state
        count += 1
        for action in range(N_ABSTRACT_ACTIONS):
            before = _neighbour(state, offsets[action], action, margin, len(distance))
            cost = incoming[(state - margin) * N_ABSTRACT_ACTIONS + action]
            if cost < np.inf and not queued[before] and distance[before] == former + cost:
                queued[before] = True
                heapq.heappush(waiting, (distance[before], before))
    for state in lost[:count]:
        distance[state] = np.inf
    for group in (lost[:count], sources):
        for state in group:
            least = _least(incoming, offsets, distance, initial, given_up, margin, state)
            if least < distance[state]:
                distance[state] = least
                waiting.append((least, state))
    heapq.heapify(waiting)
    count = 0
    while waiting:
        reached, state = heapq.heappop(waiting)
        if reached > distance[state]:
            continue
        if count == 2 * most:
            return False
        count += 1
        for action in range(N_ABSTRACT_ACTIONS):
            further = reached + np.float64(incoming[(state - margin) * N_ABSTRACT_ACTIONS + action])
            if further < np.inf:
                before = _neighbour(state, offsets[action], action, margin, len(distance))
                if further < distance[before]:
                    distance[before] = further
                    heapq.heappush(waiting, (further, before))
    return True


@njit(inline="always")
def _neighbour(state, offset, action, margin, length):
    """State at an offset; headings are cyclic for turns."""
    index = state + offset
    if action >= N_DRIVE:
        states = length - 2 * margin
        if index < margin:
            index += states
        elif index >= length - margin:
            index -= states
    return index


@njit()
def _least(incoming, offsets, distance, initial, given_up, margin, state):
    """Least cost straight to a goal, or over successors that were not dropped."""
    least = initial[state]
    for action in range(N_ABSTRACT_ACTIONS):
        after = _neighbour(state, -offsets[action], action, margin, len(distance))
        if distance[after] < np.inf and not given_up[after]:
            least = min(least, distance[after] + np.float64(incoming[(after - margin) * N_ABSTRACT_ACTIONS + action]))
    return least
