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


def least_costs_from(standing, least, starts):
    """Least possible costs from the nearest of some states (ix, iy, heading): a dict over reachable states."""
    _, nx, ny = standing.shape
    costs, queue, closed = {}, [(0.0, tuple(start)) for start in starts], set()
    while queue:
        reached, (ix, iy, heading) = heapq.heappop(queue)
        if (ix, iy, heading) in closed:
            continue
        closed.add((ix, iy, heading))
        costs[ix, iy, heading] = reached
        for action, (dx, dy, dtheta) in enumerate(ABSTRACT_ACTIONS.tolist()):
            x, y, turned = ix + dx, iy + dy, (heading + dtheta) % ABSTRACT_HEADINGS
            if 0 <= x < nx and 0 <= y < ny and standing[turned, x, y]:
                heapq.heappush(queue, (reached + float(least[heading, action]), (x, y, turned)))
    return costs


def corridor(distances, behind, narrow, wide, most, near, doubt):
    """States of the corridor with their costs, a dict, and its limit.

    Args:
        distances: costs-to-go with all edges, [16, nx, ny].
        behind: from ``least_costs_from``.
        narrow, wide, most, near, doubt: as in `hdsp.abstract.corridor`.
    """
    costs = {state: float(distances[state[2], state[0], state[1]]) for state in behind}
    best = min((cost + doubt * behind[state] for state, cost in costs.items() if behind[state] <= near), default=np.inf)
    keys = sorted(cost + behind[state] for state, cost in costs.items() if cost + behind[state] <= best + wide)
    limit = max(best + narrow, keys[min(most, len(keys)) - 1])
    return {state: cost for state, cost in costs.items() if cost + behind[state] <= limit}, limit


def costs_around(inside, behind, limit, edges, standing, least, prices, excess):
    """Costs-to-go in and around a corridor: a dict over states (ix, iy, heading).

    Args:
        inside, limit: from ``corridor``.
        behind: from ``least_costs_from``.
        edges: all edges, at least ``least``.
        standing, least, prices, excess: as in `hdsp.abstract.corridor.costs_around`.
    """
    result, reached = {state: max(cost - excess, 0.0) for state, cost in inside.items()}, set(inside)
    for heading, ix, iy in np.argwhere(standing).tolist():
        for action, (dx, dy, dtheta) in enumerate(ABSTRACT_ACTIONS.tolist()):
            end = ix + dx, iy + dy, (heading + dtheta) % ABSTRACT_HEADINGS
            if end not in inside or (ix, iy, heading) not in behind:
                continue
            if inside[end] + float(least[heading, action]) + behind[ix, iy, heading] > limit:
                continue
            reached.add((ix, iy, heading))
            cost = float(edges[heading, ix, iy, action])
            if dtheta or not np.isfinite(cost):
                continue
            for x in {math.floor(dx / 2), math.ceil(dx / 2)}:
                for y in {math.floor(dy / 2), math.ceil(dy / 2)}:
                    between = ix + x, iy + y, heading
                    if (x, y) not in ((0, 0), (dx, dy)) and between not in inside:
                        reached.add(between)
                        value = max(inside[end] + 0.5 * cost - excess, 0.0)
                        result[between] = min(result.get(between, np.inf), value)
    return reconnected(result, reached, prices)


def reconnected(costs, states, prices):
    """Costs-to-go with those of further states, at given prices: a dict over states (ix, iy, heading).

    Args:
        costs: costs-to-go of some states.
        states: those that a way may pass.
        prices: as in `hdsp.abstract.cut_off.reconnect`.
    """
    result, queue = dict(costs), []
    for ix, iy, heading in states - set(result):
        for action, (dx, dy, dtheta) in enumerate(ABSTRACT_ACTIONS.tolist()):
            end = ix + dx, iy + dy, (heading + dtheta) % ABSTRACT_HEADINGS
            if end in result:
                queue.append((result[end] + float(prices[heading, action]), (ix, iy, heading)))
    heapq.heapify(queue)
    while queue:
        cost, (ix, iy, heading) = heapq.heappop(queue)
        if cost >= result.get((ix, iy, heading), np.inf):
            continue
        result[ix, iy, heading] = cost
        for action, (dx, dy, dtheta) in enumerate(ABSTRACT_ACTIONS.tolist()):
            start = ix - dx, iy - dy, (heading - dtheta) % ABSTRACT_HEADINGS
            if start in states:
                heapq.heappush(queue, (cost + float(prices[start[2], action]), start))
    return result


def shortest(edges, sources):
    """Costs from sources, a dict over states (ix, iy, heading); ``edges`` maps a state to (next state, cost) pairs."""
    result, queue = {}, [(cost, state) for state, cost in sources.items()]
    heapq.heapify(queue)
    while queue:
        reached, state = heapq.heappop(queue)
        if state in result:
            continue
        result[state] = reached
        for following, cost in edges.get(state, ()):
            heapq.heappush(queue, (reached + cost, following))
    return result


def ways(edges, entered=None, other=None, factor=1.0, open_states=None, prices=None):
    """Edges for ``shortest``, forward and backward.

    Args:
        edges: float32 [16, nx, ny, 22], those of a guide.
        entered: bool [16, nx, ny], states with edges from ``other`` instead.
        factor: on edges of the guide.
        open_states, prices: infeasible edges between open states have these prices, [16, 22] by heading.
    """
    ahead, behind = {}, {}
    for (k, a, b, action), cost in np.ndenumerate(edges):
        cost = other[k, a, b, action] if entered is not None and entered[k, a, b] else cost * np.float32(factor)
        dx, dy, dtheta = ABSTRACT_ACTIONS[action].tolist()
        end = a + dx, b + dy, (k + dtheta) % ABSTRACT_HEADINGS
        if not (0 <= end[0] < edges.shape[1] and 0 <= end[1] < edges.shape[2]):
            continue
        if cost == np.inf and open_states is not None and open_states[k, a, b] and open_states[end[2], end[0], end[1]]:
            cost = np.float32(prices[k, action])
        if cost < np.inf:
            ahead.setdefault((a, b, k), []).append((end, float(cost)))
            behind.setdefault(end, []).append(((a, b, k), float(cost)))
    return ahead, behind


def band(ahead, behind, starts, goals, nearest, farthest, enough):
    """Sums of the costs from a start and to a goal at each state, a dict, and their limit in the band."""
    to_goals, from_starts = shortest(behind, goals), shortest(ahead, dict.fromkeys(starts, 0.0))
    best = min(to_goals[start] for start in starts if start in to_goals)
    keys = {state: cost + to_goals[state] for state, cost in from_starts.items() if state in to_goals}
    near = sorted(key for key in keys.values() if key <= best + farthest)
    return keys, max(best + nearest, near[min(enough, len(near)) - 1])
