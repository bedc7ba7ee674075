"""Cost-to-go over the abstract graph: a backward one-to-any Dijkstra search (paper, Sec. V-D).

One goal, every state: a single search from the goal over predecessors gives each abstract state the cost of its
cheapest way to the goal. The kernel uses a ring of buckets instead of a heap: with buckets no wider than the cheapest
edge, nothing inside a bucket can improve anything else in it, so no order inside is needed. Where that would take too
many buckets they are made wider, and a state that improves after its visit is visited again: same distances.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import njit

from hdsp.abstract.prefetch import prefetch
from hdsp.base.errors import InputError
from hdsp.robot.lattice import ABSTRACT_ACTIONS, ABSTRACT_HEADINGS, DRIVE_MOVES, N_ABSTRACT_ACTIONS

REPAIRED_SHARE = 16  # a repair that has to look at more than one state in so many takes longer than a new search
AHEAD = 3  # visits between the request of a row of costs and its use
N_DRIVE = len(DRIVE_MOVES)  # the abstract actions are these moves, then the turns
#: Which states an action passes over between its ends, rows (action, x, y of its end seen from there), int64 [n, 3].
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
MAX_BUCKETS = 256  # a power of two; more of them take memory, fewer only repeat a few visits


def cost_to_go(edges: np.ndarray, goal_abstract: tuple[int, int, int]) -> np.ndarray:
    """Cost of the cheapest abstract path from every abstract state to one goal.

    Convention: states are indexed `[heading, ix, iy]`, the goal is given as `(ix, iy, heading)`.

    Args:
        edges: float32 [16, nx, ny, 22], costs of the abstract actions as `AbstractCosts.edges` returns them;
            `edges[k, a, b, m]` leads from `(a, b, k)` to `(a + dx, b + dy, (k + dtheta) % 16)`, inf = infeasible.
        goal_abstract: abstract cell and heading `(ix, iy, heading)` of the goal.

    Returns:
        float32 [16, nx, ny]; 0 at the goal, inf where no feasible path leads to it. Sums are accumulated in float64
        from the goal outwards and rounded once at the end.

    Raises:
        InputError: the edges have a wrong shape, a negative or a NaN cost, or the goal lies outside the map.

    For many goals on one map build a `PreparedGraph` once and ask it.
    """
    return PreparedGraph.from_edges(edges).cost_to_go(goal_abstract)


@dataclass(frozen=True)
class PreparedGraph:
    """The edges of one map stored by the state they lead to, ready for any number of goals.

    `incoming[k, a, b, m]` is the cost of action m from the state it starts in, so that one row holds all edges a
    backward search looks at when it visits a state; inf where that state lies outside the map.
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
        """A graph that differs in the edges of some states.

        Args:
            states: int64 [n, 3], (heading, ix, iy).
            costs: float32 [n, 22], all edges of these states.

        Raises:
            InputError: a cost is negative or NaN.
        """
        costs = np.ascontiguousarray(costs, dtype=np.float32)
        if not (costs >= 0).all():
            raise InputError(f"abstract edges contain the cost {costs[~(costs >= 0)][0]}, costs must be >= 0")
        incoming = self.incoming.copy()
        _replace(incoming, np.ascontiguousarray(states, np.int64), costs, ABSTRACT_ACTIONS)
        finite = costs[np.isfinite(costs)]
        # Bounds are all that is needed of these two; they need not be reached.
        cheapest, dearest = (float(finite.min()), float(finite.max())) if len(finite) else (np.inf, 0.0)
        return PreparedGraph(incoming, min(cheapest, self.cheapest), max(dearest, self.dearest))

    def cost_to_go(self, goal_abstract: tuple[int, int, int]) -> np.ndarray:
        """Float32 [16, nx, ny], cost from every state to the goal `(ix, iy, heading)`; see function `cost_to_go`."""
        return self.distances(goal_abstract).astype(np.float32)

    def repaired(self, distances: np.ndarray, goal_abstract: tuple[int, int, int], states: np.ndarray) -> np.ndarray:
        """What `distances` gives, from its result on a graph that differs in the edges of some states.

        Only states whose cost-to-go changes are looked at, and those next to them (Ramalingam & Reps 1996): from the
        goal outwards, those are given up whose cost no successor accounts for any more; they, and states that a changed
        edge brings closer, are then searched anew. Where these are many, all states are: that is faster then.

        Args:
            distances: float64 [16, nx, ny], of that other graph, for the same goal.
            goal_abstract: the goal.
            states: int64 [n, 3], (heading, ix, iy), the states whose edges differ.
        """
        finite = distances[np.isfinite(distances)]
        # A cost too small to be seen in a sum leaves open which of two states accounts for the other.
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
        """As `cost_to_go`, before rounding: float64 [16, nx, ny]."""
        ix, iy, heading = (int(value) for value in goal_abstract)
        nx, ny = self.shape
        if not (0 <= ix < nx and 0 <= iy < ny and 0 <= heading < ABSTRACT_HEADINGS):
            raise InputError(
                f"abstract goal {(ix, iy, heading)} lies outside the map: allowed are ix < {nx}, iy < {ny}, "
                f"heading < {ABSTRACT_HEADINGS}, none negative"
            )
        width, buckets = self._buckets()
        queue = _Queue.starting_at((heading * nx + ix) * ny + iy, ABSTRACT_HEADINGS * nx * ny, self._margin, buckets)
        while not _search(self.incoming.reshape(-1), self._offsets, queue, self._margin, 1.0 / width):
            queue = queue.with_more_room()
        inside = queue.distance[self._margin : len(queue.distance) - self._margin]
        return inside.reshape(ABSTRACT_HEADINGS, nx, ny)

    def bridged(self, distances: np.ndarray) -> np.ndarray:
        """Costs-to-go, which also say what lies between the ends of an action.

        On an edge, the robot can be where no abstract state is: with two feet up and the base on its way, at a place
        where it cannot come to rest with the best feet for it. Such a state has no way of its own to the goal, but
        actions lead over it. There, half of the cost of the best one remains, and what its end has to go.

        Args:
            distances: float64 [16, nx, ny], of `distances`.

        Returns:
            the same where `distances` is finite; elsewhere finite if a feasible action to a state with a way to the
            goal passes over the state.
        """
        return _bridge(self.incoming, distances, self.passed_over, PASSED)

    @cached_property
    def passed_over(self) -> np.ndarray:
        """Whether a feasible action passes over a state, bool [16, nx, ny]."""
        return _passed_over(self.incoming, PASSED)

    @property
    def _margin(self) -> int:
        """Unused states at both ends of the flat arrays, so that a move across the border of the map stays in them."""
        return int(np.abs(self._offsets[:N_DRIVE]).max())

    @property
    def _offsets(self) -> np.ndarray:
        """Flat index differences, int64 [22], from a state to its predecessor by each action."""
        nx, ny = self.shape
        return -((ABSTRACT_ACTIONS[:, 2] * nx + ABSTRACT_ACTIONS[:, 0]) * ny + ABSTRACT_ACTIONS[:, 1])

    def _buckets(self) -> tuple[float, int]:
        """Width and number of the buckets in the ring, which must span the dearest edge; a power of two of them."""
        if not self.dearest > 0:  # no finite edge, or only free ones
            return 1.0, 2
        # A hair below the cheapest edge, so that rounding cannot put a successor into the bucket of its origin.
        width = max(self.cheapest * (1 - 1e-6), self.dearest / (MAX_BUCKETS - 3))
        return width, 1 << (int(self.dearest / width) + 2).bit_length()


class _Queue(NamedTuple):
    """State of a search. Flat arrays over states begin and end with a margin of states that are never reached."""

    distance: np.ndarray  # float64 [margin + states + margin]
    visited: np.ndarray  # bool, like distance: whether it was visited at its present distance
    entries: np.ndarray  # uint32 [buckets, room], flat indices of states that wait
    filled: np.ndarray  # int64 [buckets]
    current: np.ndarray  # int64 [1], the bucket being emptied

    @classmethod
    def starting_at(cls, goal: int, states: int, margin: int, buckets: int) -> _Queue:
        distance = np.full(states + 2 * margin, np.inf)
        distance[goal + margin] = 0.0
        entries = np.empty((buckets, max(2 * N_ABSTRACT_ACTIONS, 2 * states // buckets)), np.uint32)
        entries[0, 0] = goal + margin
        filled = np.zeros(buckets, np.int64)
        filled[0] = 1
        return cls(distance, np.zeros(len(distance), np.bool_), entries, filled, np.zeros(1, np.int64))

    def with_more_room(self) -> _Queue:
        return self._replace(entries=np.concatenate([self.entries, np.empty_like(self.entries)], axis=1))


@njit(cache=True)
def _invert(edges, actions):
    """Edges by the state they lead to, smallest and largest finite cost, and whether all costs are >= 0."""
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


@njit(cache=True, error_model="numpy")
def _search(incoming, offsets, queue, margin, per_width):
    """Empties the queue; returns False if a bucket may be too small for the next visit, and goes on when called again.

    Indices are unsigned because numba then leaves out its test for negative ones. An edge from outside the map costs
    inf, so that the comparison of distances is the only test in the inner loop.
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
                    current_bucket[0] = current  # its entries stay: visited ones are skipped the next time
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
                if action >= N_DRIVE:  # turns: headings are a circle
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


@njit(cache=True)
def _replace(incoming, states, costs, actions):
    headings, nx, ny, count = incoming.shape
    for n in range(len(states)):
        k, a, b = states[n]
        for m in range(count):
            to_a = a + actions[m, 0]
            to_b = b + actions[m, 1]
            if 0 <= to_a < nx and 0 <= to_b < ny:
                incoming[(k + actions[m, 2]) % headings, to_a, to_b, m] = costs[n, m]


@njit(cache=True, error_model="numpy")
def _repair(incoming, offsets, distance, margin, goal, sources, most):
    """Brings `distance` up to date in place; flat arrays and indices as in `_search`. False if more than `most` states
    would have to be given up or be searched anew; `distance` is then good for nothing."""
    given_up = np.zeros(len(distance), np.bool_)
    queued = np.zeros(len(distance), np.bool_)
    lost = np.empty(most, np.int64)
    count = 0
    # By former cost: whatever may account for a state has been settled when its turn comes.
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


@njit(cache=True, inline="always")
def _neighbour(state, offset, action, margin, length):
    """The state an offset leads to; headings are a circle for turns."""
    index = state + offset
    if action >= N_DRIVE:
        states = length - 2 * margin
        if index < margin:
            index += states
        elif index >= length - margin:
            index -= states
    return index


@njit(cache=True)
def _least(incoming, offsets, distance, given_up, margin, state):
    """Least cost by way of a successor that was not given up."""
    least = np.inf
    for action in range(N_ABSTRACT_ACTIONS):
        after = _neighbour(state, -offsets[action], action, margin, len(distance))
        if distance[after] < np.inf and not given_up[after]:
            least = min(least, distance[after] + np.float64(incoming[(after - margin) * N_ABSTRACT_ACTIONS + action]))
    return least


@njit(cache=True)
def _passed_over(incoming, passed):
    headings, nx, ny, _ = incoming.shape
    result = np.zeros((headings, nx, ny), dtype=np.bool_)
    for k in range(headings):
        for x in range(nx):
            for y in range(ny):
                for n in range(len(passed)):
                    if incoming[k, x, y, passed[n, 0]] < np.inf:
                        # The other end is on the map, and so is what lies between.
                        result[k, x - passed[n, 1], y - passed[n, 2]] = True
    return result


@njit(cache=True)
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
