"""Cheapest paths between states near each other: many short searches with one store.

Each search is A* with the geometric heuristic and a cost limit. A state enters the store only if its cost and its
estimate together stay below the limit. The heuristic is consistent, so no state is expanded twice.

The geometric heuristic sees neither walls nor steps. A *guide*, a heuristic for some goal beyond, sees them: the path
from a state to the end of the window costs at least the difference of both costs-to-go, by the triangle inequality. The
costs of a guide are not exact, so only a share of the difference counts, its *trust*. Such a search may miss the
cheapest path, and is several times shorter.

Between two searches, only the touched parts of the store are emptied, because an empty store for a large map takes
longer than a short search.
"""

import numpy as np

from hdsp.base.gradual import checkpoint, now
from hdsp.base.jit import njit
from hdsp.detailed.actions.successors import MAX_SUCCESSORS, Rules
from hdsp.detailed.search import open_list
from hdsp.detailed.search.estimate import Estimate, estimate, geometric_estimate
from hdsp.detailed.search.expansion import begin_at, expand
from hdsp.detailed.search.kernel import EXHAUSTED, FULL, RUNNING, SOLVED
from hdsp.detailed.search.life_cycle import edge_costs
from hdsp.detailed.search.open_list import FAR, NEAR, list_has_room, pop, push, refill
from hdsp.detailed.search.outcome import Limits, Path
from hdsp.detailed.search.store import (
    CLOSED,
    EXPANDED,
    emptied,
    grown,
    growth_nbytes,
    has_room,
    key_of,
    new_store,
    node_of,
    trace,
)
from hdsp.detailed.states import neutral_feet, pack_states, unpack_states
from hdsp.detailed.world.world import World

#: Expansions between two looks at the clock; about a hundredth of a second.
_SLICE = 10_000


class Windows:
    """Searches between states of one world.

    Args:
        world: terrain and robot.
        memory: most bytes for states and open list.
        guide: a heuristic for searches with a trust; None: all searches are without.

    Attributes:
        expansions: expanded states of all searches so far.
    """

    def __init__(self, world: World, memory: int = Limits.memory, guide: Estimate | None = None):
        self.expansions = 0
        self._world, self._rules, self._memory = world, Rules(), memory
        self._store = new_store((world.nx, world.ny), neutral_feet(world.tables.lowest))
        self._list = open_list.new_open_list()
        self._geometric = geometric_estimate(world, np.zeros(7, dtype=np.int64))
        self._guide = guide

    def least(self, start: np.ndarray, goal: np.ndarray) -> float:
        """Returns a lower bound on the cost between two states, int64 [7]."""
        return float(estimate(self._world, self._estimate_to(goal), self._packed(start)))

    def path(
        self, start: np.ndarray, goal: np.ndarray, limit: float, expansions: int, ends: float, trust: float = 0.0
    ) -> Path | None:
        """Returns a path between two states; without trust, it is the cheapest one.

        Args:
            start, goal: int64 [7], valid states, lattice units.
            limit: only paths that cost less count.
            expansions: the search ends without a path after so many.
            ends: moment on the clock `hdsp.base.gradual.now` after which it ends as well.
            trust: share of the guide's differences that counts as a lower bound. The guide is left out where it says
                less than the geometric heuristic, or contradicts the limit.
        """
        first, last, to_goal = self._packed(start), self._packed(goal), self._estimate_to(goal)
        least = float(estimate(self._world, to_goal, first))
        guide, beyond = to_goal, 0.0
        if trust > 0 and self._guide is not None:
            beyond = float(estimate(self._world, self._guide, last))
            if least < trust * (float(estimate(self._world, self._guide, first)) - beyond) < limit:
                guide = self._guide
        if guide is to_goal:
            trust = 0.0
        emptied(self._store)
        open_list.clear(self._list)
        push(self._list, np.float32(least), begin_at(self._store, first))
        code, done = RUNNING, 0
        while code == FULL or (code == RUNNING and done < expansions and now() < ends):
            checkpoint()
            until = min(done + _SLICE, expansions)
            code = _run(
                self._world,
                self._rules,
                to_goal,
                guide,
                trust,
                beyond,
                self._store,
                self._list,
                last,
                float(limit),
                until,
            )
            done = int(self._store.counts[EXPANDED])
            if code == FULL and not self._grow():
                break
        self.expansions += done
        if code != SOLVED:
            return None
        keys, actions = trace(self._world, self._store, last)
        costs = edge_costs(self._world, self._rules, keys, actions)
        return Path(unpack_states(keys, self._world.tables.lowest), actions, costs)

    def _packed(self, state: np.ndarray) -> int:
        return int(pack_states(state, self._world.tables.lowest)[0])

    def _estimate_to(self, goal: np.ndarray) -> Estimate:
        """The geometric estimate to one state."""
        disc = np.array([[*goal[:3], 0]], dtype=np.int64)
        return self._geometric._replace(discs=disc, goal_feet=(goal[3:] - self._world.tables.lowest)[None])

    def _grow(self) -> bool:
        """Makes room for the successors of one more state; returns False at the memory limit."""
        used = self._store.nbytes() + self._list.nbytes()
        more = growth_nbytes(self._store) + open_list.growth_nbytes(self._list, self._store.flags, MAX_SUCCESSORS)
        if used + more > self._memory:
            return False
        self._store = grown(self._store)
        self._list = open_list.with_room(self._list, self._store.flags, MAX_SUCCESSORS)
        return True


@njit(allocates=False, nogil=True)
def _run(world, rules, heuristic, guide, trust, beyond, store, entries, goal, limit, expansions):
    """Continues a search; returns SOLVED, EXHAUSTED (no path below the limit), RUNNING (too long) or FULL.

    Args:
        heuristic: the geometric heuristic to the goal.
        guide, trust: as in `Windows.path`; 0 = no guide.
        beyond: the guide's estimate at the goal.
        world, rules, store, entries, goal, limit, expansions: of the search.
    """
    flags, count = store.flags, store.counts
    while count[EXPANDED] < expansions:
        if not list_has_room(entries) or not has_room(store):
            return FULL
        if entries.counts[NEAR] == 0:
            if entries.counts[FAR] == 0:
                return EXHAUSTED
            refill(entries, flags)
            continue
        node = pop(entries)
        if flags[node] & CLOSED:
            continue
        key = key_of(store, node)
        if key == goal:
            return SOLVED
        g = np.float64(store.g[node])
        flags[node] |= CLOSED
        count[EXPANDED] += 1
        for k in range(expand(world, rules, store, key)):
            cost = np.float32(g + store.out_cost[k])
            f = np.float64(cost) + estimate(world, heuristic, store.out_key[k])
            if f >= limit:
                continue
            reached = node_of(store, store.out_key[k])
            if cost < store.g[reached]:
                if trust > 0:
                    f = max(f, np.float64(cost) + trust * (estimate(world, guide, store.out_key[k]) - beyond))
                    if f >= limit:
                        continue
                store.g[reached] = cost
                store.action[reached] = store.out_action[k]
                flags[reached] &= ~np.uint8(CLOSED)
                push(entries, np.float32(f), reached)
    return RUNNING
