"""Abstract graph of a map: its edges by end state, and costs-to-go for any goal."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hdsp.abstract.bridging import bridge, passed_over
from hdsp.abstract.dijkstra import DONE, FULL, N_DRIVE, BucketRing, bucket_sizes, search
from hdsp.abstract.repair import repair
from hdsp.base.errors import InputError
from hdsp.base.gradual import Steps, finished
from hdsp.base.jit import njit
from hdsp.base.short_repr import short_repr
from hdsp.robot.lattice import ABSTRACT_ACTIONS, ABSTRACT_HEADINGS

_ENTRIES = 50_000  # queue entries between two looks at the clock
REPAIRED_SHARE = 16  # a repair of more than 1 / REPAIRED_SHARE of all states takes longer than a new search


def cost_to_go(edges: np.ndarray, goal_abstract: tuple[int, int, int]) -> np.ndarray:
    """Returns the cost of the cheapest abstract path from every abstract state to one goal.

    Convention: states are indexed `[heading, ix, iy]`, the goal is given as `(ix, iy, heading)`. For several goals on
    one map, use one `PreparedGraph`.

    Args:
        edges: float32 [16, nx, ny, 22], abstract action costs as from `AbstractCosts.edges`; `edges[k, a, b, m]` leads
            from `(a, b, k)` to `(a + dx, b + dy, (k + dtheta) % 16)`, inf = infeasible.
        goal_abstract: abstract cell and heading `(ix, iy, heading)` of the goal.

    Returns:
        float32 [16, nx, ny]; 0 at the goal, inf without a feasible path to it. Sums are accumulated in float64 from the
        goal outwards and rounded once at the end.

    Raises:
        InputError: the edges have a wrong shape, a negative or a NaN cost, or the goal lies outside the map.
    """
    return PreparedGraph.from_edges(edges).cost_to_go(goal_abstract)


@dataclass(frozen=True)
class PreparedGraph:
    """One map's edges, stored by end state, ready for any number of goals.

    `incoming[k, a, b, m]` is the cost of action m from its start state to state (a, b, k); inf if the start lies
    outside the map. One row then holds all edges that a backward search reads at a state.
    """

    incoming: np.ndarray
    cheapest: float
    most_expensive: float

    def __repr__(self) -> str:
        return short_repr(self)

    @classmethod
    def from_edges(cls, edges: np.ndarray) -> PreparedGraph:
        """Inverts `edges` (float32 [16, nx, ny, 22], see `cost_to_go`); raises InputError as `cost_to_go` does."""
        edges = np.ascontiguousarray(edges, dtype=np.float32)
        if edges.ndim != 4 or edges.shape[0] != ABSTRACT_HEADINGS or edges.shape[3] != len(ABSTRACT_ACTIONS):
            raise InputError(
                f"abstract edges have shape {edges.shape}, expected "
                f"({ABSTRACT_HEADINGS}, nx, ny, {len(ABSTRACT_ACTIONS)})"
            )
        incoming, cheapest, most_expensive, valid = _invert(edges, ABSTRACT_ACTIONS)
        if not valid:
            worst = edges[~(edges >= 0)][0]
            raise InputError(f"abstract edges contain the cost {worst}, costs must be >= 0 (inf = infeasible)")
        return cls(incoming, float(cheapest), float(most_expensive))

    @property
    def shape(self) -> tuple[int, int]:
        """Abstract cells along x and y."""
        return self.incoming.shape[1], self.incoming.shape[2]

    def with_edges(self, states: np.ndarray, costs: np.ndarray) -> PreparedGraph:
        """Returns a graph with new edges at some states.

        Args:
            states: int64 [n, 3], (heading, ix, iy).
            costs: float32 [n, 22], all edges at these states.

        Raises:
            InputError: a cost is negative or NaN.
        """
        costs = np.ascontiguousarray(costs, dtype=np.float32)
        if not (costs >= 0).all():
            raise InputError(f"abstract edges contain the cost {costs[~(costs >= 0)][0]}, costs must be >= 0")
        incoming = self.incoming.copy()
        replace_edges(incoming, np.ascontiguousarray(states, np.int64), costs, ABSTRACT_ACTIONS)
        finite = costs[np.isfinite(costs)]
        # Both values serve as bounds; no edge needs to reach them.
        cheapest, most_expensive = (float(finite.min()), float(finite.max())) if len(finite) else (np.inf, 0.0)
        return PreparedGraph(incoming, min(cheapest, self.cheapest), max(most_expensive, self.most_expensive))

    def cost_to_go(self, goal_abstract: tuple[int, int, int]) -> np.ndarray:
        """Returns the cost from every state to the goal `(ix, iy, heading)`, float32 [16, nx, ny]; see `cost_to_go`."""
        return self.distances(goal_abstract).astype(np.float32)

    def repaired(
        self,
        distances: np.ndarray,
        goals_abstract: tuple[int, int, int] | np.ndarray,
        states: np.ndarray,
        initial: np.ndarray | None = None,
    ) -> np.ndarray:
        """Returns `distances`, computed from its result on a graph with other edges at some states.

        The repair visits only states whose cost-to-go changes, and their neighbours (Ramalingam & Reps 1996). From the
        goal outwards, it drops every state whose cost no successor explains any more. It then searches again from
        dropped states and from states with a better edge. A new search replaces the repair when too many states change.

        Args:
            distances: float64 [16, nx, ny], result on the other graph, for the same goals.
            goals_abstract, initial: as for `distances`.
            states: int64 [n, 3], (heading, ix, iy), states with other edges.
        """
        finite = distances[np.isfinite(distances)]
        # A cost lost by rounding in a sum leaves open which of two states explains the other.
        if not finite.max() + self.cheapest > finite.max():
            return self.distances(goals_abstract, initial)
        nx, ny = self.shape
        k, a, b = np.asarray(states, np.int64).T
        flat = np.pad(distances.ravel(), self._margin, constant_values=np.inf)
        straight = np.full(len(flat), np.inf)
        goals, costs = self._sources(goals_abstract, initial)
        straight[goals + self._margin] = costs
        sources = (k * nx + a) * ny + b + self._margin
        most = distances.size // REPAIRED_SHARE
        if not repair(self.incoming.reshape(-1), self._offsets, flat, self._margin, straight, sources, most):
            return self.distances(goals_abstract, initial)
        return flat[self._margin : len(flat) - self._margin].reshape(distances.shape)

    def distances(
        self, goals_abstract: tuple[int, int, int] | np.ndarray, initial: np.ndarray | None = None
    ) -> np.ndarray:
        """Costs to the nearest of several goals, before rounding: float64 [16, nx, ny].

        Args:
            goals_abstract: one goal `(ix, iy, heading)`, or several, int64 [n, 3].
            initial: float64 [n], >= 0, cost that is left at each goal; None: 0.

        Raises:
            InputError: a goal lies outside the map.
        """
        return finished(self.distance_steps(goals_abstract, initial))

    def distance_steps(
        self, goals_abstract: tuple[int, int, int] | np.ndarray, initial: np.ndarray | None = None
    ) -> Steps[np.ndarray]:
        """Like `distances`, in short steps."""
        goals, costs = self._sources(goals_abstract, initial)
        nx, ny = self.shape
        width, buckets = bucket_sizes(self.cheapest, max(self.most_expensive, float(costs.max())))
        queue = BucketRing.starting_at(goals, costs, 1.0 / width, ABSTRACT_HEADINGS * nx * ny, self._margin, buckets)
        incoming = self.incoming.reshape(-1)
        while (end := search(incoming, self._offsets, queue, self._margin, 1.0 / width, _ENTRIES)) != DONE:
            if end == FULL:
                queue = queue.with_more_room()
            yield
        inside = queue.distance[self._margin : len(queue.distance) - self._margin]
        return inside.reshape(ABSTRACT_HEADINGS, nx, ny)

    def _sources(
        self, goals_abstract: tuple[int, int, int] | np.ndarray, initial: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Flat indices of distinct goals, int64 [n], and the least initial cost of each, float64 [n]."""
        goals = np.atleast_2d(np.asarray(goals_abstract, dtype=np.int64))
        nx, ny = self.shape
        outside = ((goals < 0) | (goals >= (nx, ny, ABSTRACT_HEADINGS))).any(axis=1)
        if outside.any():
            raise InputError(
                f"abstract goal {tuple(goals[outside][0].tolist())} lies outside the map: allowed are ix < {nx}, "
                f"iy < {ny}, heading < {ABSTRACT_HEADINGS}, none negative"
            )
        flat, which = np.unique((goals[:, 2] * nx + goals[:, 0]) * ny + goals[:, 1], return_inverse=True)
        costs = np.full(len(flat), np.inf)
        np.minimum.at(costs, which.ravel(), 0.0 if initial is None else np.asarray(initial, dtype=float))
        return flat, costs

    def bridged(self, distances: np.ndarray) -> np.ndarray:
        """Returns costs-to-go with values for states between the ends of an action.

        During a step, the robot can be at a position without an abstract state: two feet are up, the base is on its
        way, and no feet allow it to rest there. This position has no path of its own to the goal, but actions lead over
        it. Its cost is half the cost of the best such action plus the cost-to-go at the action's end.

        Args:
            distances: float64 [16, nx, ny], from `distances`.

        Returns:
            the same values where `distances` is finite. Other states have a finite value if a feasible action over them
            ends in a state with a path to the goal.
        """
        return bridge(self.incoming, distances, self.passed_over)

    @cached_property
    def passed_over(self) -> np.ndarray:
        """Whether a feasible action passes over a state, bool [16, nx, ny]."""
        return passed_over(self.incoming)

    @property
    def _margin(self) -> int:
        """Unused states at both ends of the flat arrays, so that moves across the map's border stay inside."""
        return int(np.abs(self._offsets[:N_DRIVE]).max())

    @property
    def _offsets(self) -> np.ndarray:
        """Flat index differences, int64 [22], from a state to its predecessor by each action."""
        nx, ny = self.shape
        return -((ABSTRACT_ACTIONS[:, 2] * nx + ABSTRACT_ACTIONS[:, 0]) * ny + ABSTRACT_ACTIONS[:, 1])


@njit(nogil=True)
def _invert(edges, actions):
    """Edges by end state, smallest and largest finite cost, and whether all costs are >= 0."""
    headings, nx, ny, count = edges.shape
    incoming = np.full((headings, nx, ny, count), np.float32(np.inf), np.float32)
    cheapest = np.inf
    most_expensive = 0.0
    valid = True
    for k in range(headings):
        for a in range(nx):
            for b in range(ny):
                for m in range(count):
                    cost = edges[k, a, b, m]
                    if not cost >= 0:
                        valid = False
                    if cost < np.inf:
                        to_a = a + actions[m, 0]
                        to_b = b + actions[m, 1]
                        if 0 <= to_a < nx and 0 <= to_b < ny:
                            incoming[(k + actions[m, 2]) % headings, to_a, to_b, m] = cost
                            cheapest = min(cheapest, np.float64(cost))
                            most_expensive = max(most_expensive, np.float64(cost))
    return incoming, cheapest, most_expensive, valid


@njit(allocates=False, nogil=True)
def enter_least(incoming, k, bounded, kept, least, actions):
    """Writes the least cost of each action into the edges to the states at one heading.

    Args:
        incoming: see ``PreparedGraph``.
        k: the heading.
        bounded: bool [16, nx, ny], states whose edges have their least cost.
        kept: bool [16, nx, ny], states whose edges stay as they are; states of neither kind have no edges.
        least: float32 [16, 22], by the start's heading.
        actions: the abstract actions.
    """
    headings, nx, ny = bounded.shape
    for a in range(nx):
        for m in range(len(actions)):
            x, dy, z = a - actions[m, 0], actions[m, 1], (k - actions[m, 2]) % headings
            if not 0 <= x < nx:
                incoming[k, a, :, m] = np.float32(np.inf)
                continue
            for b in range(min(max(dy, 0), ny)):
                incoming[k, a, b, m] = np.float32(np.inf)
            for b in range(max(ny + min(dy, 0), 0), ny):
                incoming[k, a, b, m] = np.float32(np.inf)
            for b in range(max(dy, 0), ny + min(dy, 0)):
                if not kept[z, x, b - dy]:
                    incoming[k, a, b, m] = least[z, m] if bounded[z, x, b - dy] else np.float32(np.inf)


@njit(allocates=False, nogil=True)
def copy_edges(source, target, states, actions):
    """Copies the edges from some states, int64 [n, 3] (heading, ix, iy), from one ``incoming`` to another."""
    headings, nx, ny, count = source.shape
    for n in range(len(states)):
        k, a, b = states[n, 0], states[n, 1], states[n, 2]
        for m in range(count):
            x, y, z = a + actions[m, 0], b + actions[m, 1], (k + actions[m, 2]) % headings
            if 0 <= x < nx and 0 <= y < ny:
                target[z, x, y, m] = source[z, x, y, m]


@njit(nogil=True)
def replace_edges(incoming, states, costs, actions):
    """Writes new edges at some states into ``incoming``; arguments as for ``PreparedGraph.with_edges``."""
    headings, nx, ny, count = incoming.shape
    for n in range(len(states)):
        k, a, b = states[n]
        for m in range(count):
            to_a = a + actions[m, 0]
            to_b = b + actions[m, 1]
            if 0 <= to_a < nx and 0 <= to_b < ny:
                incoming[(k + actions[m, 2]) % headings, to_a, to_b, m] = costs[n, m]


@njit()
def enter_edges(incoming, edges, states, corner, least, actions):
    """Writes the edges from some states in a part of a map into ``incoming``.

    Args:
        incoming: see ``PreparedGraph``.
        edges: float32 [16, nx, ny, 22], edges of the part.
        states: bool [16, nx, ny], those with new edges.
        corner: int64 [2], first cell of the part.
        least: float32 [16, 22], least cost of an action by its start's heading.
        actions: the abstract actions.

    Returns:
        0, or a cost that is negative or NaN; then nothing is written. Smallest and largest finite cost.
    """
    headings, nx, ny, count = edges.shape
    cheapest, most_expensive = np.inf, 0.0
    for k in range(headings):
        for a in range(nx):
            for b in range(ny):
                if states[k, a, b]:
                    for m in range(count):
                        if not edges[k, a, b, m] >= 0:
                            return np.float64(edges[k, a, b, m]), cheapest, most_expensive
    for k in range(headings):
        for a in range(nx):
            for b in range(ny):
                if not states[k, a, b]:
                    continue
                for m in range(count):
                    cost = max(edges[k, a, b, m], least[k, m])
                    if cost < np.inf:
                        cheapest, most_expensive = (
                            min(cheapest, np.float64(cost)),
                            max(most_expensive, np.float64(cost)),
                        )
                    x, y = a + corner[0] + actions[m, 0], b + corner[1] + actions[m, 1]
                    if 0 <= x < incoming.shape[1] and 0 <= y < incoming.shape[2]:
                        incoming[(k + actions[m, 2]) % headings, x, y, m] = cost
    return 0.0, cheapest, most_expensive
