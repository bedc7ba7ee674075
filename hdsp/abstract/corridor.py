"""Costs-to-go in the corridor of one query: abstract states on ways from its start that are not too expensive.

A query from one start needs costs-to-go of few states. Let ``cost`` be the cost from a state to the goals, ``behind`` a
lower bound on the cost from the start to the state, and ``best`` the cost of the cheapest abstract way. The corridor
consists of the states with the least ``cost + behind``: all states up to ``best + NARROW``, and further ones up to
``best + WIDE`` while there are at most ``MOST``. A short way thus has a wide corridor, in which a search finds ways
around errors of the abstraction, and a long way has a narrow one for its length.

A backward A* search from the goals with the key ``cost + behind`` finds the corridor (Hart, Nilsson & Raphael 1968).
The bound comes from a forward Dijkstra search in which every action has its least possible cost, between states at
which the robot can stand. It is consistent, so the search gives each state of the corridor its cost in the whole graph,
and visits no state beyond.

Edges are evaluated where the search needs them (lazy weighted A*, Cohen, Phillips & Likhachev, RSS 2014). An action
without evaluation counts its least cost. All states of the corridor, and some around it, are then evaluated, and the
search begins again, until the corridor holds evaluated states alone. Its costs are then exact, and independent of edges
elsewhere: with all map edges, the corridor is the same. Where many states wait for evaluation, a small corridor of
``FIRST`` states comes first, because a large one around a way that evaluation then closes is evaluated in vain.

Convention: states are flat indices ``(heading * nx + ix) * ny + iy``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hdsp.abstract.bridging import PASSED
from hdsp.abstract.cut_off import reconnect
from hdsp.abstract.waiting import Waiting, bucket_of, present, put, take
from hdsp.base.jit import njit
from hdsp.robot.lattice import ABSTRACT_ACTIONS, ABSTRACT_HEADINGS

#: Cost above the cheapest way that a way in the corridor may have, at least and at most.
NARROW, WIDE = 0.1, 2.0
#: States of a corridor that is wider than necessary.
MOST = 3_000
#: The same for the small corridor that comes first.
FIRST = 600
#: Cost on even ground within which a start or a goal without an abstract way is connected to states that have one.
NEAR = 1.0

# States around a corridor that are evaluated with it, relative; otherwise, single ones follow one by one.
_FRINGE = 0.25


class Corridor(NamedTuple):
    """The corridor, as far as edges are known.

    Attributes:
        costs: float64 [16, nx, ny], costs to the goals in the corridor, inf outside.
        behind: float64 [16, nx, ny], lower bounds on costs from the start.
        limit: largest sum of both in the corridor.
        around: bool [16, nx, ny], states of the corridor, and the next ones in the order of this sum.
    """

    costs: np.ndarray
    behind: np.ndarray
    limit: float
    around: np.ndarray

    @property
    def states(self) -> np.ndarray:
        """Whether a state belongs to the corridor, bool [16, nx, ny]."""
        return self.costs < np.inf


class _Breadth(NamedTuple):
    """Limits of a corridor, for kernels; ``doubt`` as for ``find_corridor``, ``most`` is a number of states."""

    doubt: float
    near: float
    narrow: float
    wide: float
    most: float


def least_costs_from(states: np.ndarray, open_states: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Returns lower bounds on the costs from the nearest of some states, float64 [16, nx, ny]; inf without a way.

    Args:
        states: int64 [n, 3], abstract states (ix, iy, heading).
        open_states: bool [16, nx, ny], states that a way may pass.
        least: float64 [16, 22], least cost of an action by its start's heading.
    """
    headings, nx, ny = open_states.shape
    flat = _flat(states, nx, ny)
    costs, queue = np.full(open_states.size, np.inf), Waiting.none(open_states.size, least)
    _spread(flat, np.zeros(len(flat)), open_states.ravel(), (nx, ny), least, 1, np.inf, costs, queue)
    return costs.reshape(headings, nx, ny)


def connected(
    goals: np.ndarray, costs: np.ndarray, open_states: np.ndarray, prices: np.ndarray, most: float
) -> tuple[np.ndarray, np.ndarray]:
    """Returns states around goals, int64 [n, 3], and the cost from each to a goal at given prices, float64 [n].

    Args:
        goals: int64 [m, 3], states (ix, iy, heading).
        costs: float64 [m], >= 0, cost that is left at each of them.
        open_states: bool [16, nx, ny], states that a way may pass.
        prices: float64 [16, 22], price of an action by its start's heading.
        most: largest cost.
    """
    _, nx, ny = open_states.shape
    prices = np.array(prices, np.float32, order="C")
    found, queue = np.full(open_states.size, np.inf), Waiting.none(open_states.size, prices)
    _spread(_flat(goals, nx, ny), costs, open_states.ravel(), (nx, ny), prices, -1, most, found, queue)
    near = np.flatnonzero(found < np.inf)
    heading, ix, iy = np.unravel_index(near, open_states.shape)
    return np.stack([ix, iy, heading], axis=1), found[near]


def find_corridor(
    incoming: np.ndarray,
    behind: np.ndarray,
    goals: np.ndarray,
    costs: np.ndarray,
    least: np.ndarray,
    doubt: float,
    *,
    first: bool = False,
) -> Corridor | None:
    """Returns the corridor; None if no way leads from the start to a goal.

    A start that the abstraction cuts off is connected to states with a way within ``NEAR``, at ``doubt`` times the cost
    of even ground.

    Args:
        incoming: float32 [16, nx, ny, 22], costs by end state, see `hdsp.abstract.prepared_graph.PreparedGraph`, at
            least ``least``; the same as ``least`` where they are not evaluated.
        behind: from ``least_costs_from``, for the states around the start.
        goals: int64 [n, 3], states (ix, iy, heading).
        costs: float64 [n], >= 0, cost that is left at each of them.
        least: as for ``least_costs_from``.
        doubt: see above.
        first: whether the corridor is the small one, with ``FIRST`` states instead of ``MOST``.
    """
    most = min(FIRST, MOST) if first else MOST
    found, settled = np.full(behind.size, np.inf), np.zeros(behind.size, np.bool_)
    (_, nx, ny), bounds, queue = behind.shape, behind.ravel(), Waiting.none(behind.size, least)
    breadth = _Breadth(doubt, NEAR, NARROW, WIDE, (1 + _FRINGE) * most)
    best = _settle(incoming.reshape(-1), (nx, ny), bounds, _flat(goals, nx, ny), costs, found, settled, queue, breadth)
    if best == np.inf:
        return None
    keys = np.where(settled, found + bounds, np.inf)
    around = keys <= best + WIDE
    limit = max(best + NARROW, _smallest(keys[around], most))
    around &= keys <= max(limit, _smallest(keys[around], round((1 + _FRINGE) * most)))
    found[~(keys <= limit)] = np.inf
    return Corridor(found.reshape(behind.shape), behind, limit, around.reshape(behind.shape))


def _smallest(values: np.ndarray, count: int) -> float:
    """The largest of the ``count`` smallest values."""
    last = min(count, values.size) - 1
    return float(np.partition(values, last)[last])


def costs_around(
    corridor: Corridor,
    incoming: np.ndarray,
    standing: np.ndarray,
    least: np.ndarray,
    prices: np.ndarray,
    excess: float,
) -> np.ndarray:
    """Returns costs-to-go in and around a corridor, float64 [16, nx, ny]; inf elsewhere.

    States between the ends of an action count half its cost, see `hdsp.abstract.bridging`. States with evaluated
    actions into the corridor, and no feasible one, are connected at high prices, see `hdsp.abstract.cut_off`.

    Args:
        corridor: a corridor with evaluated edges.
        incoming, least: as for ``find_corridor``.
        standing: bool [16, nx, ny], states at which the robot can stand.
        prices: float64 [16, 22], price of an action that is judged infeasible, by its start's heading.
        excess: costs in the corridor exceed the costs-to-go by this much.
    """
    values, reached = _around(corridor.costs, corridor.behind, corridor.limit, incoming, standing, least, PASSED)
    values = np.maximum(values - excess, 0.0)
    reconnect(values, reached, prices)
    return values


def _flat(states: np.ndarray, nx: int, ny: int) -> np.ndarray:
    return (states[:, 2] * nx + states[:, 0]) * ny + states[:, 1]


@njit(allocates=False, nogil=True)
def _spread(sources, costs, open_states, shape, least, direction, most, cost, queue):
    """Dijkstra search with the same edges everywhere, forward (direction 1) or backward (-1); fills ``cost``."""
    nx, ny = shape
    for i in range(len(sources)):
        if costs[i] <= most and costs[i] < cost[sources[i]]:
            cost[sources[i]] = costs[i]
            put(queue, sources[i], costs[i])
    while queue.counts[1] > 0:
        while present(queue):
            state = take(queue)
            k, a, b = state // (nx * ny), state // ny % nx, state % ny
            so_far = cost[state]
            for m in range(len(ABSTRACT_ACTIONS)):
                x, y = a + direction * ABSTRACT_ACTIONS[m, 0], b + direction * ABSTRACT_ACTIONS[m, 1]
                if not (0 <= x < nx and 0 <= y < ny):
                    continue
                z = (k + direction * ABSTRACT_ACTIONS[m, 2]) % ABSTRACT_HEADINGS
                other = (z * nx + x) * ny + y
                further = so_far + least[k if direction > 0 else z, m]
                if further < cost[other] and further <= most and open_states[other]:
                    cost[other] = further
                    put(queue, other, further)
        queue.counts[0] += 1


@njit(allocates=False, nogil=True)
def _settle(incoming, shape, behind, goals, costs, cost, settled, queue, breadth):
    """Backward A* search; fills ``cost``, also beyond the corridor, and returns the cost of the cheapest way."""
    nx, ny = shape
    best, least_key, limit, total = np.inf, np.inf, np.inf, 0
    for i in range(len(goals)):
        goal = goals[i]
        if costs[i] < cost[goal] and behind[goal] < np.inf:
            cost[goal] = costs[i]
            put(queue, goal, costs[i] + behind[goal])
    count = len(ABSTRACT_ACTIONS)
    while queue.counts[1] > 0 and queue.counts[0] <= limit * queue.per_width:
        # All states of former buckets have their cost.
        if total >= breadth.most and queue.counts[0] > least_key * queue.per_width:
            break
        while present(queue):
            state = take(queue)
            so_far = cost[state]
            key = so_far + behind[state]
            if key > limit:
                continue
            if bucket_of(queue, key) > queue.counts[0]:
                put(queue, state, key)
                continue
            if behind[state] <= breadth.near and so_far + breadth.doubt * behind[state] < best:
                best = so_far + breadth.doubt * behind[state]
                least_key, limit = best + breadth.narrow, best + breadth.wide
            if not settled[state]:
                settled[state] = True
                total += 1
            k, a, b = state // (nx * ny), state // ny % nx, state % ny
            for m in range(count):
                edge = np.float64(incoming[state * count + m])
                if edge == np.inf:
                    continue
                x, y = a - ABSTRACT_ACTIONS[m, 0], b - ABSTRACT_ACTIONS[m, 1]
                start = ((k - ABSTRACT_ACTIONS[m, 2]) % ABSTRACT_HEADINGS * nx + x) * ny + y
                further = so_far + edge
                if further < cost[start] and behind[start] < np.inf and further + behind[start] <= limit:
                    cost[start] = further
                    put(queue, start, further + behind[start])
        queue.counts[0] += 1
    return best


@njit(nogil=True)
def _around(costs, behind, limit, incoming, standing, least, passed):
    """Costs with those of states between the ends of an action, and the states that ``reconnect`` may reach."""
    headings, nx, ny = costs.shape
    values, reached = costs.copy(), np.zeros((headings, nx, ny), np.bool_)
    for k in range(headings):
        for a in range(nx):
            for b in range(ny):
                cost = costs[k, a, b]
                if cost == np.inf:
                    continue
                reached[k, a, b] = True
                for m in range(len(ABSTRACT_ACTIONS)):
                    x, y = a - ABSTRACT_ACTIONS[m, 0], b - ABSTRACT_ACTIONS[m, 1]
                    z = (k - ABSTRACT_ACTIONS[m, 2]) % ABSTRACT_HEADINGS
                    if not (0 <= x < nx and 0 <= y < ny) or not standing[z, x, y]:
                        continue
                    # Other states may be without evaluated edges.
                    if cost + least[z, m] + behind[z, x, y] <= limit:
                        reached[z, x, y] = True
                for n in range(len(passed)):
                    m = passed[n, 0]
                    edge = np.float64(incoming[k, a, b, m])
                    if edge == np.inf:
                        continue
                    x, y = a - ABSTRACT_ACTIONS[m, 0], b - ABSTRACT_ACTIONS[m, 1]
                    if cost + least[k, m] + behind[k, x, y] > limit:
                        continue
                    x, y = a - passed[n, 1], b - passed[n, 2]
                    if costs[k, x, y] == np.inf:
                        reached[k, x, y] = True
                        values[k, x, y] = min(values[k, x, y], cost + 0.5 * edge)
    return values, reached
