"""Whether the robot can leave a state: a search outward, which ends at a distance from the start.

The search asks for reachability alone. It expands the state farthest from the start first, and among equally far ones
the state with the feet nearest to neutral, because the robot drives on neutral feet. On free ground it therefore takes
a few dozen expansions. A search that visits all reachable states proves that the robot cannot leave.
"""

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.search.expansion import begin_at, expand
from hdsp.detailed.search.kernel import EXHAUSTED, FULL, RUNNING, SOLVED
from hdsp.detailed.search.life_cycle import Search
from hdsp.detailed.search.open_list import FAR, NEAR, list_has_room, pop, push, refill
from hdsp.detailed.search.outcome import Limits, Status
from hdsp.detailed.search.store import BLOCK, BLOCKS, CLOSED, EXPANDED, SEEN, has_room, key_of, node_of
from hdsp.detailed.states import unpack, unpack_states
from hdsp.detailed.world.world import World

#: Expansions after which a state counts as one that the robot cannot leave; about a quarter second.
MOST_EXPANSIONS = 200_000


def leave(world: World, start: np.ndarray, distance: float, expansions: int = MOST_EXPANSIONS) -> np.ndarray | None:
    """Searches for a way from a state to any base position at a distance.

    Args:
        world: terrain and robot.
        start: int64 [7], a valid state, lattice units.
        distance: straight distance to the start's base position, cells.
        expansions: limit of the search.

    Returns:
        None if there is a way. Otherwise, all states that the search has seen, int64 [n, 7].
    """
    search = _Outward(world, start, start[None], Rules(), Limits(expansions=expansions))
    ended = search.begin_outward(distance)
    while ended is None:
        ended = search.advance()
    return None if ended == Status.SOLVED else unpack_states(_seen(search.store), world.tables.lowest)


class _Outward(Search):
    """A running search outward; costs stay 0."""

    def begin_outward(self, distance: float) -> Status | None:
        self._set_up(lists=1)
        self._distance = float(distance)
        push(self.lists[0], np.float32(0), begin_at(self.store, self.start))
        return self._memory_limit()

    def _run(self, expansions: int) -> int:
        x, y = unpack(self.start)[:2]
        return _run(self.world, self.rules, self.store, self.lists[0], x, y, self._distance, expansions)


@njit(allocates=False, nogil=True)
def _run(world, rules, store, open_list, x, y, distance, expansions):
    flags, count, lowest = store.flags, store.counts, world.tables.lowest
    until = count[EXPANDED] + expansions
    while count[EXPANDED] < until:
        if not list_has_room(open_list) or not has_room(store):
            return FULL
        if open_list.counts[NEAR] == 0:
            if open_list.counts[FAR] == 0:
                return EXHAUSTED
            refill(open_list, flags)
            continue
        node = pop(open_list)
        flags[node] |= CLOSED
        count[EXPANDED] += 1
        for k in range(expand(world, rules, store, key_of(store, node))):
            ix, iy, _, o0, o1, o2, o3 = unpack(store.out_key[k])
            away = np.hypot(np.float64(ix - x), np.float64(iy - y))
            if away >= distance:
                return SOLVED
            reached = node_of(store, store.out_key[k])
            if store.g[reached] == np.inf:
                store.g[reached] = 0
                count[SEEN] += 1
                displaced = abs(o0 + lowest) + abs(o1 + lowest) + abs(o2 + lowest) + abs(o3 + lowest)
                push(open_list, np.float32(displaced - 4 * away), reached)
    return RUNNING


@njit(nogil=True)
def _seen(store):
    """Packed states that were seen, int64 [n]."""
    keys = np.empty(store.counts[SEEN], np.int64)
    n = 0
    for node in range(BLOCK, BLOCK * store.counts[BLOCKS]):
        if store.g[node] < np.inf:
            keys[n] = key_of(store, node)
            n += 1
    return keys
