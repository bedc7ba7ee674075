"""Cost-to-go over the abstract graph: a backward one-to-any Dijkstra search (paper, Sec. V-D).

One search from the goal over predecessors gives every abstract state the cost of its cheapest path to the goal. The
kernel uses a ring of buckets instead of a heap. If buckets are no wider than the cheapest edge, no state in a bucket
can improve another state in it, so a bucket needs no order. If this takes too many buckets, they are made wider, and a
state that improves after its visit is visited again; the distances are the same.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hdsp.abstract.prefetch import prefetch
from hdsp.base.errors import InputError
from hdsp.base.jit import njit
from hdsp.robot.lattice import ABSTRACT_ACTIONS, ABSTRACT_HEADINGS, DRIVE_MOVES, N_ABSTRACT_ACTIONS

REPAIRED_SHARE = 16  # a repair of more than 1 / REPAIRED_SHARE of all states takes longer than a new search
AHEAD = 3  # visits between the prefetch of a cost row and its use
N_DRIVE = len(DRIVE_MOVES)  # abstract actions are these moves, followed by the turns
#: States that an action passes over: rows (action, x, y), int64 [n, 3], with (x, y) from the state to the action's end.
PASSED = np.array(
    [
        (m, dx - x, dy - y)
        for m, (dx, dy) in enumerate(DRIVE_MOVES)
        for x in sorted({math.floor(dx / 2), math.ceil(dx / 2)})
        for y in sorted({math.floor(dy / 2), math.ceil(dy / 2)})
        if (x, y) not in ((0, 0), (dx, dy))
    ],
    dtype=np.int64,
)
MAX_BUCKETS = 256  # a power of two; more buckets take memory, fewer repeat a few visits


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
    dearest: float

    @classmethod
    def from_edges(cls, edges: np.ndarray) -> PreparedGraph:
        """Inverts `edges` (float32 [16, nx, ny, 22], see `cost_to_go`); raises InputError as `cost_to_go` does."""
        edges = np.ascontiguousarray(edges, dtype=np.float32)
        if edges.ndim != 4 or edges.shape[0] != ABSTRACT_HEADINGS or edges.shape[3] != len(ABSTRACT_ACTIONS):
            raise InputError(
                f"abstract edges have shape {edges.shape}, expected "
                f"({ABSTRACT_HEADINGS}, nx, ny, {len(ABSTRACT_ACTIONS)})"
            )
        incoming, cheapest, dearest, valid = _invert(edges, ABSTRACT_ACTIONS)
        if not valid:
            worst = edges[~(edges >= 0)][0]
            raise InputError(f"abstract edges contain the cost {worst}, costs must be >= 0 (inf = infeasible)")
        return cls(incoming, float(cheapest), float(dearest))

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
        _replace(incoming, np.ascontiguousarray(states, np.int64), costs, ABSTRACT_ACTIONS)
        finite = costs[np.isfinite(costs)]
        # Both values serve as bounds; no edge needs to reach them.
        cheapest, dearest = (float(finite.min()), float(finite.max())) if len(finite) else (np.inf, 0.0)
        return PreparedGraph(incoming, min(cheapest, self.cheapest), max(dearest, self.dearest))

    def cost_to_go(self, goal_abstract: tuple[int, int, int]) -> np.ndarray:
        """Returns the cost from every state to the goal `(ix, iy, heading)`, float32 [16, nx, ny]; see `cost_to_go`."""
        return self.distances(goal_abstract).astype(np.float32)

    def repaired(self, distances: np.ndarray, goal_abstract: tuple[int, int, int], states: np.ndarray) -> np.ndarray:
        """Returns `distances`, computed from its result on a graph with other edges at some states.

        The repair visits only states whose cost-to-go changes, and their neighbours (Ramalingam & Reps 1996). From the
        goal outwards, it drops every state whose cost no successor explains any more. It then searches again from
        dropped states and from states with a better edge. A new search replaces the repair when too many states change.

        Args:
            distances: float64 [16, nx, ny], result on the other graph, for the same goal.
            goal_abstract: goal.
            states: int64 [n, 3], (heading, ix, iy), states with other edges.
        """
        finite = distances[np.isfinite(distances)]
        # A cost lost by rounding in a sum leaves open which of two states explains the other.
        if not finite.max() + self.cheapest > finite.max():
            return self.distances(goal_abstract)
        ix, iy, heading = (int(value) for value in goal_abstract)
        nx, ny = self.shape
        k, a, b = np.asarray(states, np.int64).T
        flat = np.pad(distances.ravel(), self._margin, constant_values=np.inf)
        goal = (heading * nx + ix) * ny + iy + self._margin
        sources = (k * nx + a) * ny + b + self._margin
        most = distances.size // REPAIRED_SHARE
        if not _repair(self.incoming.reshape(-1), self._offsets, flat, self._margin, goal, sources, most):
            return self.distances(goal_abstract)
        return flat[self._margin : len(flat) - self._margin].reshape(distances.shape)

    def distances(self, goal_abstract: tuple[int, int, int]) -> np.ndarray:
        """Like method `cost_to_go`, before rounding: float64 [16, nx, ny]."""
        ix, iy, heading = (int(value) for value in goal_abstract)
        nx, ny = self.shape
        if not (0 <= ix < nx and 0 <= iy < ny and 0 <= heading < ABSTRACT_HEADINGS):
            raise InputError(
                f"abstract goal {(ix, iy, heading)} lies outside the map: allowed are ix < {nx}, iy < {ny}, "
                f"heading < {ABSTRACT_HEADINGS}, none negative"
            )
        width, buckets = self._buckets()
        queue = _BucketQueue.starting_at(
            (heading * nx + ix) * ny + iy, ABSTRACT_HEADINGS * nx * ny, self._margin, buckets
        )
        while not _search(self.incoming.reshape(-1), self._offsets, queue, self._margin, 1.0 / width):
            queue = queue.with_more_room()
        inside = queue.distance[self._margin : len(queue.distance) - self._margin]
        return inside.reshape(ABSTRACT_HEADINGS, nx, ny)

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
        return _bridge(self.incoming, distances, self.passed_over, PASSED)

    @cached_property
    def passed_over(self) -> np.ndarray:
        """Whether a feasible action passes over a state, bool [16, nx, ny]."""
        return _passed_over(self.incoming, PASSED)

    @property
    def _margin(self) -> int:
        """Unused states at both ends of the flat arrays, so that moves across the map's border stay inside."""
        return int(np.abs(self._offsets[:N_DRIVE]).max())

    @property
    def _offsets(self) -> np.ndarray:
        """Flat index differences, int64 [22], from a state to its predecessor by each action."""
        nx, ny = self.shape
        return -((ABSTRACT_ACTIONS[:, 2] * nx + ABSTRACT_ACTIONS[:, 0]) * ny + ABSTRACT_ACTIONS[:, 1])

    def _buckets(self) -> tuple[float, int]:
        """Bucket width and count (a power of two); the ring must span the most expensive edge."""
        if not self.dearest > 0:  # no finite edge, or only free ones
            return 1.0, 2
        # Slightly below the cheapest edge, so that rounding cannot put a successor into its origin's bucket.
        width = max(self.cheapest * (1 - 1e-6), self.dearest / (MAX_BUCKETS - 3))
        return width, 1 << (int(self.dearest / width) + 2).bit_length()


class _BucketQueue(NamedTuple):
    """State of a search. Flat arrays over states begin and end with a margin of states that are never reached."""

    distance: np.ndarray  # float64 [margin + states + margin]
    visited: np.ndarray  # bool, like distance: whether it was visited at its present distance
    entries: np.ndarray  # uint32 [buckets, room], flat indices of states that wait
    filled: np.ndarray  # int64 [buckets]
    current: np.ndarray  # int64 [1], the bucket being emptied

    @classmethod
    def starting_at(cls, goal: int, states: int, margin: int, buckets: int) -> _BucketQueue:
        distance = np.full(states + 2 * margin, np.inf)
        distance[goal + margin] = 0.0
        entries = np.empty((buckets, max(2 * N_ABSTRACT_ACTIONS, 2 * states // buckets)), np.uint32)
        entries[0, 0] = goal + margin
        filled = np.zeros(buckets, np.int64)
        filled[0] = 1
        return cls(distance, np.zeros(len(distance), np.bool_), entries, filled, np.zeros(1, np.int64))

    def with_more_room(self) -> _BucketQueue:
        return self._replace(entries=np.concatenate([self.entries, np.empty_like(self.entries)], axis=1))


@njit()
def _invert(edges, actions):
    """Edges by end state, smallest and largest finite cost, and whether all costs are >= 0."""
    headings, nx, ny, count = edges.shape
    incoming = np.full((headings, nx, ny, count), np.float32(np.inf), np.float32)
    cheapest = np.inf
    dearest = 0.0
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
                            dearest = max(dearest, np.float64(cost))
    return incoming, cheapest, dearest, valid


@njit()
def _search(incoming, offsets, queue, margin, per_width):
    """Empties the queue; returns False if a bucket may be too small for the next visit. The next call continues.

    Indices are unsigned because numba then omits its test for negative ones. An edge from outside the map costs inf, so
    the comparison of distances is the only test in the inner loop.
    """
    distance, visited, entries, filled, current_bucket = queue
    states = np.int64(len(distance) - 2 * margin)
    count = np.uint64(len(offsets))
    buckets, room = entries.shape
    mask = np.int64(buckets - 1)
    current = current_bucket[0]
    fullest = filled.max()
    last = fullest  # entries of the current bucket
    while True:
        empty = 0
        while empty < buckets and filled[current] == 0:
            current = (current + 1) & mask
            empty += 1
        if empty == buckets:
            return True
        place = 0
        last = filled[current]
        while place < last:
            if fullest + N_ABSTRACT_ACTIONS > room:
                fullest = filled.max()
                if fullest + N_ABSTRACT_ACTIONS > room:
                    current_bucket[0] = current  # its entries stay; the next call skips visited ones
                    return False
            state = np.uint64(entries[np.uint64(current), np.uint64(place)])
            place += 1
            if place + AHEAD < last:
                ahead = (np.uint64(entries[np.uint64(current), np.uint64(place + AHEAD)]) - np.uint64(margin)) * count
                prefetch(incoming, ahead)
                prefetch(incoming, ahead + count - np.uint64(1))
            if visited[state]:
                continue
            visited[state] = True
            base = distance[state]
            row = (state - np.uint64(margin)) * count
            for action in range(N_ABSTRACT_ACTIONS):
                index = np.int64(state) + offsets[np.uint64(action)]
                if action >= N_DRIVE:  # turns: headings are cyclic
                    if index < margin:
                        index += states
                    elif index >= states + margin:
                        index -= states
                reached = base + np.float64(incoming[row + np.uint64(action)])
                target = np.uint64(index)
                if reached < distance[target]:
                    distance[target] = reached
                    visited[target] = False
                    bucket = np.uint64(np.int64(reached * per_width) & mask)
                    end = filled[bucket]
                    entries[bucket, np.uint64(end)] = target
                    filled[bucket] = end + 1
                    fullest = max(fullest, end + 1)
            last = filled[current]
        filled[current] = 0


@njit()
def _replace(incoming, states, costs, actions):
    headings, nx, ny, count = incoming.shape
    for n in range(len(states)):
        k, a, b = states[n]
        for m in range(count):
            to_a = a + actions[m, 0]
            to_b = b + actions[m, 1]
            if 0 <= to_a < nx and 0 <= to_b < ny:
                incoming[(k + actions[m, 2]) % headings, to_a, to_b, m] = costs[n, m]


@njit()
def _repair(incoming, offsets, distance, margin, goal, sources, most):
    """Updates `distance` in place; flat arrays and indices as in `_search`.

    Returns False if more than `most` states would be dropped, or too many searched again; `distance` is then invalid.
    """
    given_up = np.zeros(len(distance), np.bool_)
    queued = np.zeros(len(distance), np.bool_)
    lost = np.empty(most, np.int64)
    count = 0
    # In order of former cost: every state that may explain another one is decided before it.
    waiting = [(distance[state], state) for state in sources if state != goal and distance[state] < np.inf]
    for _, state in waiting:
        queued[state] = True
    heapq.heapify(waiting)
    while waiting:
        former, state = heapq.heappop(waiting)
        if _least(incoming, offsets, distance, given_up, margin, state) <= former:
            continue
        if count == most:
            return False
        given_up[state] = True
        lost[count] = state
        count += 1
        for action in range(N_ABSTRACT_ACTIONS):
            before = _neighbour(state, offsets[action], action, margin, len(distance))
            cost = incoming[(state - margin) * N_ABSTRACT_ACTIONS + action]
            if cost < np.inf and not queued[before] and before != goal and distance[before] == former + cost:
                queued[before] = True
                heapq.heappush(waiting, (distance[before], before))
    for state in lost[:count]:
        distance[state] = np.inf
    for group in (lost[:count], sources):
        for state in group:
            least = _least(incoming, offsets, distance, given_up, margin, state)
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
def _least(incoming, offsets, distance, given_up, margin, state):
    """Least cost over successors that were not dropped."""
    least = np.inf
    for action in range(N_ABSTRACT_ACTIONS):
        after = _neighbour(state, -offsets[action], action, margin, len(distance))
        if distance[after] < np.inf and not given_up[after]:
            least = min(least, distance[after] + np.float64(incoming[(after - margin) * N_ABSTRACT_ACTIONS + action]))
    return least


@njit()
def _passed_over(incoming, passed):
    headings, nx, ny, _ = incoming.shape
    result = np.zeros((headings, nx, ny), dtype=np.bool_)
    for k in range(headings):
        for x in range(nx):
            for y in range(ny):
                for n in range(len(passed)):
                    if incoming[k, x, y, passed[n, 0]] < np.inf:
                        # The start is on the map, and so are all states between.
                        result[k, x - passed[n, 1], y - passed[n, 2]] = True
    return result


@njit()
def _bridge(incoming, distances, passed_over, passed):
    headings, nx, ny = distances.shape
    result = distances.copy()
    for k in range(headings):
        for a in range(nx):
            for b in range(ny):
                if distances[k, a, b] < np.inf or not passed_over[k, a, b]:
                    continue
                least = np.inf
                for n in range(len(passed)):
                    x, y = a + passed[n, 1], b + passed[n, 2]
                    if 0 <= x < nx and 0 <= y < ny and distances[k, x, y] < least:
                        least = min(least, distances[k, x, y] + 0.5 * incoming[k, x, y, passed[n, 0]])
                result[k, a, b] = least
    return result
