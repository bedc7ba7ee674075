"""Costs-to-go for states that an abstraction cuts off from the goal."""

import numpy as np

from hdsp.abstract.waiting import Waiting, bucket_of, present, put, take
from hdsp.base.jit import njit
from hdsp.robot.lattice import ABSTRACT_ACTIONS


def reconnect(distances: np.ndarray, states: np.ndarray, prices: np.ndarray) -> None:
    """Extends costs-to-go to states without a path to the goal, in place.

    An abstraction may judge an action infeasible that is feasible. A state without a path to the goal gets the cost of
    the cheapest way over neighbouring states to one with a path, at given prices, which should exceed the costs of
    actions judged feasible.

    Args:
        distances: float64 [16, nx, ny], costs-to-go, inf without a path.
        states: bool [16, nx, ny], states that a robot may pass; all others stay inf.
        prices: float64 [16, 22], price of an action by its start's heading.
    """
    _reconnect(distances, states, prices, ABSTRACT_ACTIONS, Waiting.none(distances.size, prices))


@njit(allocates=False, nogil=True)
def _reconnect(distances, states, prices, actions, queue):
    headings, nx, ny = distances.shape
    for k in range(headings):
        for a in range(nx):
            for b in range(ny):
                if distances[k, a, b] < np.inf or not states[k, a, b]:
                    continue
                least = np.inf
                for m in range(len(actions)):
                    x, y = a + actions[m, 0], b + actions[m, 1]
                    if 0 <= x < nx and 0 <= y < ny:
                        least = min(least, distances[(k + actions[m, 2]) % headings, x, y] + prices[k, m])
                if least < np.inf:
                    distances[k, a, b] = least
                    put(queue, (k * nx + a) * ny + b, least)
    while queue.counts[1] > 0:
        while present(queue):
            state = take(queue)
            k, a, b = state // (nx * ny), state // ny % nx, state % ny
            cost = distances[k, a, b]
            if bucket_of(queue, cost) > queue.counts[0]:
                put(queue, state, cost)
                continue
            for m in range(len(actions)):
                x, y, z = a - actions[m, 0], b - actions[m, 1], (k - actions[m, 2]) % headings
                if 0 <= x < nx and 0 <= y < ny and states[z, x, y] and cost + prices[z, m] < distances[z, x, y]:
                    distances[z, x, y] = cost + prices[z, m]
                    put(queue, (z * nx + x) * ny + y, distances[z, x, y])
        queue.counts[0] += 1
