"""The life cycle of a search: begin, advance until the end, read the result.

All drivers share it: ``weighted_astar``, ``anytime`` and ``multi_heuristic``.

A search may share its time with a proof that no plan exists. Short searches run alone: a proof has to look at the poses
of a whole map, and a goal is most often in reach. From a number of expansions on, which grows with the map, the proof
takes turns with the search and gets ``PROOF_SHARE`` of the time in total. Its share is the larger one, because a proof
without success ends soon (``heading_masks.PoseFlood``): a proof that goes on is likely to succeed. Both keep their work
between turns, so a proof takes at most 1 / PROOF_SHARE times its own time, or its time plus the search that ran alone.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from hdsp.base.gradual import checkpoint, now
from hdsp.base.jit import njit
from hdsp.detailed.actions.state_costs import state_cost, state_costs
from hdsp.detailed.actions.successors import MAX_SUCCESSORS, Rules, successors
from hdsp.detailed.search import kernel, open_list
from hdsp.detailed.search.backward import Backward, no_backward
from hdsp.detailed.search.bounds import rounding
from hdsp.detailed.search.estimate import Estimate, estimate
from hdsp.detailed.search.open_list import OpenList
from hdsp.detailed.search.outcome import Limits, Path, SearchResult, Status
from hdsp.detailed.search.store import (
    CUT,
    EXPANDED,
    GOALS_LEFT,
    SEEN,
    Store,
    count_waiting,
    grown,
    growth_nbytes,
    new_store,
    trace,
)
from hdsp.detailed.states import neutral_feet, pack_states, unpack_states
from hdsp.detailed.world.world import World

#: Callback with (expansions, seconds), called regularly during a search.
Progress = Callable[[int, float], object]
#: Callback with a search that ended without a plan.
AtEnd = Callable[["Search"], object]

#: Proof that no plan exists, continued until a moment on the clock ``now``. Returns True after a success, False after a
#: failure, None before its end.
Hopeless = Callable[[float], bool | None]


class GuideTurn(NamedTuple):
    """A turn of one of several searches, each with a guide of its own.

    Attributes:
        number: which search; 0 is the first one.
        guide: returns the estimate before a moment on the clock ``now``; None if the time is too short.
        expansions: turn length.
    """

    number: int
    guide: Callable[[float], Estimate | None]
    expansions: int


class _Resting(NamedTuple):
    """A search between its turns; attributes as in ``Search``."""

    store: Store
    lists: list[OpenList]
    goal_cost: np.ndarray
    guide: Estimate
    heuristic: Estimate


#: Least number of expansions before a proof takes turns with a search; about a tenth of a second. On larger maps, the
#: number of map cells counts.
FEW = 50_000
#: Share of the time for a proof that takes turns with a search.
PROOF_SHARE = 0.75
_SLICE = 20_000  # expansions between two checks of the clock, at most
_LOOK = 0.02  # s, the same on a slow machine, so that a query soon notices that it was cancelled
_FIRST = 2_000  # the same while their time is unknown
_LEAST = 200  # the same shortly before the time limit
_ENDS = {
    kernel.SOLVED: Status.SOLVED,
    kernel.EXHAUSTED: Status.INFEASIBLE,
    kernel.OVER_COST_LIMIT: Status.COST_LIMIT,
}


class Search:
    """A running search from one start to one or several goals, to each or to the nearest of them.

    Args:
        world: terrain and robot.
        start: int64 [7], lattice units (ix, iy, heading, 4 foot offsets).
        goals: int64 [n, 7] or [7].
        rules: restrictions; default: none.
        limits: limits that end the search.
        progress: callback, called regularly.
        nearest: whether the first settled goal ends the search.

    Attributes:
        goals: int64 [n], packed.
        goal_cost: float32 [n], inf where a goal is not settled.
        invalid: per goal, the status for an invalid start or goal, None if both are valid. A search may begin if one
            entry is None.
        alone: expansion count before a proof takes turns with the search.
        impossible: the status of ``invalid`` if no search may begin, else None.
        store, lists: states seen, and open lists; from ``begin`` on.
    """

    store: Store
    lists: list[OpenList]
    _guide: Estimate
    _heuristic: Estimate  # the guide, with a backward search
    _weight: float
    _admissible: bool
    _reopen: bool

    def __init__(
        self,
        world: World,
        start: np.ndarray,
        goals: np.ndarray,
        rules: Rules | None = None,
        limits: Limits | None = None,
        progress: Progress | None = None,
        nearest: bool = False,
    ):
        self.began, self.paused = now(), 0.0
        self.world, self.rules, self.limits, self.progress = world, rules or Rules(), limits or Limits(), progress
        self.start = int(pack_states(start, world.tables.lowest)[0])
        self.goals = pack_states(goals, world.tables.lowest)
        self.goal_cost = np.full(len(self.goals), np.inf, dtype=np.float32)
        self.nearest = nearest
        self.alone = max(FEW, world.nx * world.ny)
        self._later: tuple[int, Backward] | None = None
        self._turns: Iterator[GuideTurn] = iter(())
        self._turn_ends: int | None = None
        self._number, self._resting = 0, dict[int, _Resting]()
        self._back = no_backward()
        self.invalid = self._invalid_ends()

    def _invalid_ends(self) -> list[Status | None]:
        if not np.isfinite(state_cost(self.world, self.start)):
            return [Status.INVALID_START] * len(self.goals)
        valid = np.isfinite(state_costs(self.world, self.goals))
        return [None if each else Status.INVALID_GOAL for each in valid]

    @property
    def impossible(self) -> Status | None:
        return None if None in self.invalid else self.invalid[0]

    def begin(self, heuristic: Estimate, weight: float, admissible: bool, reopen: bool = True) -> Status | None:
        """Puts the start into the open list.

        Args:
            heuristic: estimated cost to the nearest goal.
            weight: W >= 1.
            admissible: whether the heuristic never exceeds the cost to the nearest goal.
            reopen: whether a state found cheaper after its expansion is expanded again.

        Returns:
            None if the search continues, as from ``advance``; otherwise, its final status.
        """
        self._set_up(lists=1)
        self._set_order(heuristic, weight, admissible, reopen)
        kernel.insert_start(self.store, self.lists[0], self._first_f(heuristic), self.start)
        return self._memory_limit()

    def guide_later(self, back: Backward, after: int) -> None:
        """Raises the heuristic by a backward search, once the search has made many expansions.

        States that wait in the open list get their new order when they come out of it (``expansion.rises``).

        Args:
            back: backward search from the goals, of which the heuristic has none; it is continued as far as the search
                asks.
            after: expansion count.
        """
        self._later = after, back.within(self.limits.memory // 2)

    def _within_memory(self, heuristic: Estimate) -> Estimate:
        """Returns the heuristic with a backward search that takes half of the memory at most; counts this memory."""
        back = heuristic.back
        if len(back.place) == 0 and self._later is not None and self._own() >= self._later[0]:
            back = self._later[1]
        if len(back.place) > 0:
            self._back = back = back.within(self.limits.memory // 2)
        return heuristic._replace(back=back)

    def take_turns(self, first: int, turns: Iterator[GuideTurn]) -> None:
        """Lets several heuristics guide in turns, so that a search with one wrong heuristic does not take very long.

        Each heuristic has a search of its own, with its own store and open list, as if it were alone; a turn resumes
        it. The first search that ends decides. All searches share the limits. Heuristics in turns have to be of one
        kind: all admissible, or none. With several goals, the nearest has to be the one that counts.

        Source: dovetailing, R. Valenzano et al., Simultaneously searching with multiple settings, ICAPS 2010.

        Args:
            first: length of the first turn, with the heuristic from ``begin``, in expansions.
            turns: all further turns.
        """
        self._turns, self._turn_ends = turns, first

    def _next_turn(self) -> Status | None:
        """Begins the next turn; returns as ``begin``. After the last one, its search continues to the end."""
        turn, self._turn_ends = next(self._turns, None), None
        if turn is None:
            return None
        began = now()
        guide = turn.guide(self.began + self.limits.time)
        self.paused += now() - began
        if guide is None:
            return Status.TIME_LIMIT
        ended = self._resume(turn.number, guide)
        self._turn_ends = self._own() + turn.expansions
        return ended

    def _resume(self, number: int, guide: Estimate) -> Status | None:
        """Goes on with a search in its next turn, possibly the first one; returns as ``begin``."""
        order = guide, self._weight, self._admissible, self._reopen
        if number != self._number:
            self._resting[self._number] = _Resting(self.store, self.lists, self.goal_cost, self._guide, self._heuristic)
            self._number = number
            if number not in self._resting:
                self.goal_cost = np.full_like(self.goal_cost, np.inf)
                return self.begin(*order)
            self.store, self.lists, self.goal_cost, self._guide, self._heuristic = self._resting.pop(number)
        return None if guide is self._guide else self.begin_round(*order)

    def reopened(self) -> Status | None:
        """Begins a round with reopening in the present search, the only one from now on; returns as ``begin``."""
        self._turns, self._turn_ends = iter(()), None
        return self.begin_round(self._guide, self._weight, self._admissible, reopen=True)

    def stores(self) -> list[Store]:
        """Returns the states of all searches in turns, those of the present one first."""
        return [self.store, *(resting.store for resting in self._resting.values())]

    def _own(self) -> int:
        """Number of expansions in the present search."""
        return int(self.store.counts[EXPANDED])

    def _total(self, count: int) -> int:
        """Sum of a count over all searches in turns."""
        return sum(int(store.counts[count]) for store in self.stores())

    def _first_f(self, heuristic: Estimate) -> np.float32:
        """The start's ``W h``."""
        return np.float32(self._weight * estimate(self.world, heuristic, self.start))

    def begin_round(self, heuristic: Estimate, weight: float, admissible: bool, reopen: bool) -> Status | None:
        """Fills the open list again with all waiting states, in another order; arguments and result as in ``begin``."""
        self._set_order(heuristic, weight, admissible, reopen)
        if self.nearest:  # the round may settle another goal
            self.goal_cost[:], self.store.counts[GOALS_LEFT] = np.inf, 1
        open_list.clear(self.lists[0])
        if not self._grow(count_waiting(self.store)):
            return Status.MEMORY_LIMIT
        kernel.push_waiting(self.world, self.store, self.lists[0], heuristic, self._weight)
        return None

    def _set_up(self, lists: int) -> None:
        """Creates empty open lists and an empty store, and marks the goals in the store."""
        # The only reference to the store: an array is freed when a larger one replaces it.
        self.store = new_store((self.world.nx, self.world.ny), neutral_feet(self.world.tables.lowest))
        self.lists = [open_list.new_open_list() for _ in range(lists)]
        valid = np.array([wrong is None for wrong in self.invalid])
        marked = 0
        while (marked := kernel.mark_goals(self.store, self.goals, valid, marked)) < len(valid):
            self.store = grown(self.store)
        self.store.counts[GOALS_LEFT] = 1 if self.nearest else valid.sum()

    def _set_order(self, heuristic: Estimate, weight: float, admissible: bool, reopen: bool) -> None:
        self._guide, self._heuristic = heuristic, self._within_memory(heuristic)
        self._weight, self._reopen = float(weight), reopen
        self._admissible = admissible
        self._f_limit = weight * self.limits.cost if admissible else np.inf

    def _memory_limit(self) -> Status | None:
        return None if self.nbytes() <= self.limits.memory else Status.MEMORY_LIMIT

    def run(self, hopeless: Hopeless | None = None) -> Status:
        """Continues the search to its end; returns its final status.

        Args:
            hopeless: proof that no plan exists, see ``ask``. Once it succeeds, the search ends as infeasible.
        """
        while True:
            ended = self.advance(None if hopeless is None else self.alone)
            answer = self.ask(hopeless, ended) if hopeless is not None else None
            if answer:
                return Status.INFEASIBLE
            if ended is not None:
                return ended
            if answer is False:
                hopeless = None

    def ask(self, hopeless: Hopeless, ended: Status | None = None) -> bool | None:
        """Gives a proof its turn; its time counts for the time limit, and not as time of the search.

        The proof continues until it has had its share of the time so far. A search that ends at its limit on expansions
        or memory leaves all remaining time to the proof, unless the search was short.

        Args:
            hopeless: the proof.
            ended: final status of the search, None if it continues.

        Returns:
            The proof's answer; None without a turn.
        """
        at_limit = ended in (Status.EXPANSION_LIMIT, Status.MEMORY_LIMIT)
        if self._total(EXPANDED) < (FEW if at_limit else self.alone) or not (ended is None or at_limit):
            return None
        began = now()
        until = self.began + self.limits.time
        if not at_limit:
            searched = began - self.began - self.paused
            until = min(until, began + searched * PROOF_SHARE / (1 - PROOF_SHARE) - self.paused)
        if until <= began:
            return None
        answer = hopeless(until)
        self.paused += now() - began
        return answer

    def advance(self, pause: int | None = None) -> Status | None:
        """Continues the search for a slice; returns its final status, None if the search continues.

        Args:
            pause: expansion count at which a slice ends.

        Raises:
            Cancelled: another thread has cancelled the query.
        """
        checkpoint()
        done, own = self._total(EXPANDED), self._own()
        left = self.limits.expansions - done
        if left <= 0:
            return Status.EXPANSION_LIMIT
        if own == self._turn_ends:
            if (ended := self._next_turn()) is not None:
                return ended
            own = self._own()
        slice_ = min(left, self._slice())
        if self._turn_ends is not None:
            slice_ = min(slice_, self._turn_ends - own)
        if self._later is not None and len(self._heuristic.back.place) == 0:
            if own < self._later[0]:
                slice_ = min(slice_, self._later[0] - own)
            else:
                self._heuristic = self._within_memory(self._heuristic)
        code = self._run(min(slice_, pause - done) if pause is not None and pause > done else slice_)
        if code in _ENDS:
            return _ENDS[code]
        # The backward search of a heuristic grows in the kernel.
        if (code == kernel.FULL and not self._grow()) or self.nbytes() > self.limits.memory:
            return Status.MEMORY_LIMIT
        elapsed = now() - self.began
        if self.progress is not None:
            self.progress(self._total(EXPANDED), elapsed)
        return Status.TIME_LIMIT if elapsed > self.limits.time else None

    def _slice(self) -> int:
        """Number of expansions until the next look at the clock, so that the time limit is kept."""
        done, elapsed = self._total(EXPANDED), now() - self.began
        if done == 0:
            return min(_FIRST, _SLICE)
        per_second = done / max(elapsed - self.paused, 1e-6)
        return int(min(max(min((self.limits.time - elapsed) / 2, _LOOK) * per_second, _LEAST), _SLICE))

    def _run(self, expansions: int) -> int:
        """Expands at most ``expansions`` states; returns the kernel's code."""
        return kernel.run(
            self.world, self.rules, self._heuristic, self.store, self.lists[0], self._weight, self.goals,
            self.goal_cost, self.limits.cost, self._f_limit, expansions, self._reopen,
        )  # fmt: skip

    def _grow(self, entries: int = MAX_SUCCESSORS) -> bool:
        """Makes room for the successors of one more state, and for ``entries`` entries in each open list.

        Returns False at the memory limit. An array counts together with the larger copy that replaces it.
        """
        if self.nbytes() + growth_nbytes(self.store) > self.limits.memory:
            return False
        self.store = grown(self.store)
        return all(self._make_room(i, entries) for i in range(len(self.lists)))

    def _make_room(self, i: int, entries: int) -> bool:
        """Makes room for entries in an open list; returns False at the memory limit."""
        more = open_list.growth_nbytes(self.lists[i], self.store.flags, entries)
        if self.nbytes() + more > self.limits.memory:
            return False
        self.lists[i] = open_list.with_room(self.lists[i], self.store.flags, entries)
        return True

    def least_cost(self, admissible: Estimate) -> float:
        """Returns a cost below which no plan exists: the least g + h of all states that wait, with its rounding.

        Args:
            admissible: heuristic that never exceeds the cost to the nearest goal.
        """
        least = kernel.least_f(self.world, self.store, admissible)
        if self.store.counts[CUT]:
            least = min(least, self.limits.cost)
        return least * max(0.0, 1 - rounding(self.world) * least) if np.isfinite(least) else least

    def nbytes(self) -> int:
        """Total array size in bytes, a backward search of the heuristic included."""
        return sum(store.nbytes() for store in self.stores()) + self._open_nbytes() + self._back.nbytes()

    def _open_nbytes(self) -> int:
        resting = [entries for each in self._resting.values() for entries in each.lists]
        return sum(entries.nbytes() for entries in [*self.lists, *resting])

    def path(self, goal: int) -> Path:
        """Returns the path from the start to a seen state (packed)."""
        keys, actions = trace(self.world, self.store, goal)
        costs = edge_costs(self.world, self.rules, keys, actions)
        return Path(unpack_states(keys, self.world.tables.lowest), actions, costs)

    def result(self, ended: Status, paths: bool = True) -> SearchResult:
        """Returns the result, given the final status; ``paths`` adds states and actions."""
        if self.nearest:
            return self._result_of_nearest(ended, paths)
        settled = np.isfinite(self.goal_cost)
        status = [Status.SOLVED if found else ended for found in settled]
        status = [of if wrong is None else wrong for of, wrong in zip(status, self.invalid, strict=True)]
        if paths:
            found = [self.path(int(goal)) if solved else None for goal, solved in zip(self.goals, settled, strict=True)]
            result = SearchResult.of(status, found)
        else:
            result = SearchResult(status, self.goal_cost.astype(float))
        self.count(result)
        return result

    def _result_of_nearest(self, ended: Status, paths: bool) -> SearchResult:
        k = int(np.argmin(self.goal_cost))
        solved = bool(np.isfinite(self.goal_cost[k]))
        status = [Status.SOLVED if solved else ended]
        if paths:
            result = SearchResult.of(status, [self.path(int(self.goals[k])) if solved else None])
        else:
            result = SearchResult(status, self.goal_cost[k : k + 1].astype(float))
        result.reached = k if solved else None
        self.count(result)
        return result

    def count(self, result: SearchResult) -> None:
        """Writes the resources used so far into a result."""
        result.expansions, result.seen = self._total(EXPANDED), self._total(SEEN)
        result.memory, result.open_memory = self.nbytes(), self._open_nbytes()
        result.seconds = now() - self.began - self.paused


@njit()
def edge_costs(world, rules, keys, actions):
    """Costs of the actions along a path, float64 [n - 1]; inf for an action that is not legal.

    Args:
        world: terrain and robot.
        rules: restrictions of the search.
        keys: int64 [n], packed states of the path.
        actions: uint8 [n - 1].
    """
    reached, prices = np.empty(MAX_SUCCESSORS, np.int64), np.empty(MAX_SUCCESSORS)
    taken = np.empty(MAX_SUCCESSORS, np.uint8)
    costs = np.full(len(actions), np.inf)
    for i in range(len(actions)):
        for k in range(successors(world, rules, keys[i], reached, prices, taken)):
            if reached[k] == keys[i + 1] and taken[k] == actions[i]:
                costs[i] = prices[k]
                break
    return costs
