"""Textbook twins of the abstract graph search: plain Python, slow and simple."""

import heapq
import math

import numpy as np

from hdsp.robot.lattice import ABSTRACT_ACTIONS, ABSTRACT_HEADINGS


def successors(edges, state):
    """Yields (state, cost) for each feasible action from `state` = (ix, iy, heading)."""
    _, nx, ny, _ = edges.shape
    ix, iy, heading = state
    for action, (dx, dy, dtheta) in enumerate(ABSTRACT_ACTIONS.tolist()):
        cost = float(edges[heading, ix, iy, action])
        if np.isfinite(cost) and 0 <= ix + dx < nx and 0 <= iy + dy < ny:
            yield (ix + dx, iy + dy, (heading + dtheta) % ABSTRACT_HEADINGS), cost


def cost_to_go(edges, goal):
    """Distances float64 [16, nx, ny] to `goal` = (ix, iy, heading): Dijkstra on the reversed graph, with a heap."""
    _, nx, ny, _ = edges.shape
    predecessors = {}
    for heading, ix, iy in np.ndindex(ABSTRACT_HEADINGS, nx, ny):
        for target, cost in successors(edges, (ix, iy, heading)):
            predecessors.setdefault(target, []).append(((ix, iy, heading), cost))
    distance = np.full((ABSTRACT_HEADINGS, nx, ny), np.inf)
    distance[goal[2], goal[0], goal[1]] = 0.0
    queue, closed = [(0.0, tuple(goal))], set()
    while queue:
        reached, state = heapq.heappop(queue)
        if state in closed:
            continue
        closed.add(state)
        for (ix, iy, heading), cost in predecessors.get(state, ()):
            if reached + cost < distance[heading, ix, iy]:
                distance[heading, ix, iy] = reached + cost
                heapq.heappush(queue, (reached + cost, (ix, iy, heading)))
    return distance


def bridged(edges, distances):
    """Costs-to-go that also cover states without a path, if an action passes over them.

    Such a state gets the cost-to-go at the action's end plus half the action's cost.
    """
    _, nx, ny = distances.shape
    result = distances.copy()
    for (k, a, b, m), cost in np.ndenumerate(edges):
        dx, dy, turn = (int(value) for value in ABSTRACT_ACTIONS[m])
        inside = 0 <= a + dx < nx and 0 <= b + dy < ny
        if turn or not inside or not np.isfinite(cost) or not np.isfinite(distances[k, a + dx, b + dy]):
            continue
        for x in {math.floor(dx / 2), math.ceil(dx / 2)}:
            for y in {math.floor(dy / 2), math.ceil(dy / 2)}:
                between = k, a + x, b + y
                if (x, y) not in ((0, 0), (dx, dy)) and not np.isfinite(distances[between]):
                    result[between] = min(result[between], distances[k, a + dx, b + dy] + 0.5 * float(cost))
    return result
