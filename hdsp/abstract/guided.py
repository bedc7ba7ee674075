"""Costs-to-go on a large map: evaluated edges near the cheapest way, and edges of a cheaper abstraction elsewhere.

The corridor of a long way (`hdsp.abstract.corridor`) is wide, because costs on even ground bound its costs from far
below. On a large map, another abstraction therefore *guides* the evaluation: an edge that is not evaluated has the
guide's cost. The states on the cheapest ways of this mixed graph are evaluated, and the ways sought again, until they
consist of evaluated edges alone (lazy shortest paths, Dellin & Srinivasa, ICAPS 2016). After each evaluation, edges of
the guide become dearer by ``DEARER``, so few rounds suffice.

The way found is the cheapest one in the mixed graph. Each other way therefore costs at least as much, if the guide's
edges, at their last price, do not exceed the costs of edges that are not evaluated.

Convention: states are flat indices ``(heading * nx + ix) * ny + iy``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hdsp.abstract.prepared_graph import PreparedGraph, copy_edges
from hdsp.abstract.waiting import Waiting, present, put, take
from hdsp.base.jit import njit
from hdsp.robot.lattice import ABSTRACT_ACTIONS, ABSTRACT_HEADINGS

#: Cost above the cheapest way that a way through an evaluated state may have, at least and at most.
NEAREST, FARTHEST = 0.1, 0.5
#: States near the way that are evaluated although they are farther than necessary.
ENOUGH = 8_000
#: Relative rise of the guide's costs after each evaluation.
DEARER = 0.01

# Ways a little dearer than those that must be evaluated are evaluated with them, otherwise single states follow.
_BEYOND = 0.05


class Band(NamedTuple):
    """States near the cheapest way between a start and goals.

    Attributes:
        inside: bool [16, nx, ny], states that must be evaluated.
        around: bool [16, nx, ny], these states, and others worth an evaluation with them.
    """

    inside: np.ndarray
    around: np.ndarray


class MixedEdges:
    """Edges by end state: those of a guide where no others were entered.

    Args:
        guide: all the guide's edges.

    Attributes:
        incoming: float32 [16, nx, ny, 22], see ``PreparedGraph``.
        cheapest, most_expensive: bounds on the finite costs.
    """

    def __init__(self, guide: PreparedGraph):
        self.incoming, self.cheapest, self.most_expensive = guide.incoming.copy(), guide.cheapest, guide.most_expensive

    @property
    def graph(self) -> PreparedGraph:
        """The graph; its edges change with these."""
        return PreparedGraph(self.incoming, self.cheapest, self.most_expensive)

    def raise_by(self, share: float) -> None:
        """Makes all edges dearer; edges that were entered have to be entered again."""
        self.incoming *= np.float32(1 + share)
        self.most_expensive *= 1 + share

    def enter(self, incoming: np.ndarray, states: np.ndarray, cheapest: float, most_expensive: float) -> None:
        """Takes over the edges from some states.

        Args:
            incoming: float32 [16, nx, ny, 22], the other edges.
            states: bool [16, nx, ny].
            cheapest, most_expensive: bounds on their finite costs.
        """
        copy_edges(incoming, self.incoming, np.argwhere(states), ABSTRACT_ACTIONS)
        self._cover(cheapest, most_expensive)

    def open(self, prices: np.ndarray, open_states: np.ndarray) -> None:
        """Gives infeasible edges between open states, bool [16, nx, ny], prices, float64 [16, 22] by heading."""
        prices = np.array(prices, np.float32, order="C")
        _open_edges(self.incoming, open_states, prices, ABSTRACT_ACTIONS)
        finite = prices[np.isfinite(prices)]
        self._cover(float(finite.min()), float(finite.max()))

    def _cover(self, cheapest: float, most_expensive: float) -> None:
        self.cheapest, self.most_expensive = min(self.cheapest, cheapest), max(self.most_expensive, most_expensive)


def find_band(graph: PreparedGraph, distances: np.ndarray, starts: np.ndarray) -> Band | None:
    """Returns the states near the cheapest way; None without a way.

    Args:
        graph: the edges.
        distances: float64 [16, nx, ny], costs to the goals.
        starts: int64 [n, 3], states (ix, iy, heading).
    """
    (nx, ny), to_goals = graph.shape, distances.ravel()
    flat = (starts[:, 2] * nx + starts[:, 0]) * ny + starts[:, 1]
    best = to_goals[flat].min()
    if best == np.inf:
        return None
    costs, queue = np.full(to_goals.size, np.inf), Waiting.none(to_goals.size, (graph.cheapest, graph.most_expensive))
    most = best + FARTHEST + _BEYOND
    _spread_near(graph.incoming.reshape(-1), flat, (nx, ny), to_goals, most, costs, queue)
    keys = costs + to_goals
    near = np.sort(keys[keys <= most])
    limit = min(max(best + NEAREST, near[min(ENOUGH, len(near)) - 1]), best + FARTHEST)
    return Band(*((keys <= limit + more).reshape(distances.shape) for more in (0.0, _BEYOND)))


@njit(allocates=False)
def _spread_near(incoming, starts, shape, to_goals, most, cost, queue):
    """Dijkstra search from some states over states on ways to a goal that cost at most ``most``; fills ``cost``."""
    (nx, ny), count = shape, len(ABSTRACT_ACTIONS)
    for start in starts:
        if to_goals[start] <= most:
            cost[start] = 0.0
            put(queue, start, 0.0)
    while queue.counts[1] > 0:
        while present(queue):
            state = take(queue)
            k, a, b = state // (nx * ny), state // ny % nx, state % ny
            so_far = cost[state]
            for m in range(count):
                x, y = a + ABSTRACT_ACTIONS[m, 0], b + ABSTRACT_ACTIONS[m, 1]
                if not (0 <= x < nx and 0 <= y < ny):
                    continue
                other = ((k + ABSTRACT_ACTIONS[m, 2]) % ABSTRACT_HEADINGS * nx + x) * ny + y
                further = so_far + np.float64(incoming[other * count + m])
                if further < cost[other] and further + to_goals[other] <= most:
                    cost[other] = further
                    put(queue, other, further)
        queue.counts[0] += 1


@njit(allocates=False)
def _open_edges(incoming, open_states, prices, actions):
    headings, nx, ny, count = incoming.shape
    for k in range(headings):
        for a in range(nx):
            for b in range(ny):
                if not open_states[k, a, b]:
                    continue
                for m in range(count):
                    x, y, z = a - actions[m, 0], b - actions[m, 1], (k - actions[m, 2]) % headings
                    inside = 0 <= x < nx and 0 <= y < ny
                    if inside and open_states[z, x, y] and incoming[k, a, b, m] == np.inf:
                        incoming[k, a, b, m] = prices[z, m]
