"""Running a search to its end: limits, growth of memory, and the result."""

import time
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from hdsp.detailed.actions.state_costs import state_cost
from hdsp.detailed.actions.successors import MAX_SUCCESSORS, Rules, successors
from hdsp.detailed.search import kernel as search
from hdsp.detailed.search import open_list
from hdsp.detailed.search.estimate import Estimate
from hdsp.detailed.search.store import (
    EXPANDED,
    GOALS_LEFT,
    SEEN,
    count_waiting,
    grown,
    growth_nbytes,
    has_room,
    new_store,
    trace,
)
from hdsp.detailed.states import neutral_feet, pack_states, unpack_states
from hdsp.detailed.world.world import World


class Status(IntEnum):
    """How a search, or one of its goals, ended."""

    SOLVED = 0
    INFEASIBLE = 1  # proved: everything that can be reached was
    COST_LIMIT = 2  # proved: no plan costs less than the limit
    EXPANSION_LIMIT = 3
    MEMORY_LIMIT = 4
    TIME_LIMIT = 5
    INVALID_START = 6
    INVALID_GOAL = 7

    def __str__(self) -> str:
        return self.name.lower()


@dataclass(frozen=True)
class Limits:
    """When a search gives up. ``cost`` decides feasibility; the others only say that it is not known.

    Attributes:
        cost: no plan above this cost is of interest.
        expansions: number of expanded states.
        memory: bytes of the store of states, while it grows including those of the larger one.
        time: seconds.
    """

    cost: float = np.inf
    expansions: int = 50_000_000
    memory: int = 4 << 30
    time: float = 600.0


@dataclass
class SearchResult:
    """Outcome of a search from one start to one or several goals.

    Attributes:
        status: of each goal, in the order given.
        cost: float64 [goals], inf where not solved.
        states: per goal int64 [n, 7] from start to goal in lattice units, or None.
        actions: per goal uint8 [n - 1] action codes, or None.
        edge_costs: per goal float64 [n - 1], or None.
        expansions: states expanded.
        seen: states generated.
        memory: bytes used at the end, all told.
        open_memory: of these, bytes of the open list.
        seconds: time spent.
    """

    status: list[Status]
    cost: np.ndarray
    states: list = field(default_factory=list)
    actions: list = field(default_factory=list)
    edge_costs: list = field(default_factory=list)
    expansions: int = 0
    seen: int = 0
    memory: int = 0
    open_memory: int = 0
    seconds: float = 0.0


_SLICE = 20_000  # expansions between two looks at the clock
_ENDS = {
    search.SOLVED: Status.SOLVED,
    search.EXHAUSTED: Status.INFEASIBLE,
    search.OVER_COST_LIMIT: Status.COST_LIMIT,
}


def solve(
    world: World,
    start: np.ndarray,
    goals: np.ndarray,
    heuristic: Estimate,
    *,
    weight: float = 1.0,
    admissible: bool = True,
    rules: Rules | None = None,
    limits: Limits | None = None,
    paths: bool = True,
    progress=None,
) -> SearchResult:
    """Weighted A* from one detailed state to all of several others.

    Args:
        world: terrain and robot.
        start: int64 [7], lattice units (ix, iy, heading, 4 foot offsets).
        goals: int64 [n, 7].
        heuristic: must not exceed the cost to the nearest goal by more than the plan may be worse than optimal.
        weight: W >= 1; with an admissible heuristic, costs are at most W times optimal.
        admissible: whether the heuristic never exceeds the cost to the nearest goal; if so, it helps to prove that a
            cost limit cannot be kept.
        rules: restrictions, e.g. of labelling.
        limits: when to give up.
        paths: whether to return states and actions.
        progress: called with (expansions, seconds) now and then.

    Returns:
        A result with one status per goal.
    """
    began = time.perf_counter()
    goals = np.atleast_2d(goals)
    keys = pack_states(goals, world.tables.lowest)
    start_key = int(pack_states(start, world.tables.lowest)[0])
    result = SearchResult([Status.INVALID_START] * len(keys), np.full(len(keys), np.inf))
    if not np.isfinite(state_cost(world, start_key)):
        return result
    valid = np.array([np.isfinite(state_cost(world, int(k))) for k in keys], dtype=bool)
    task = Search(world, start_key, keys[valid], rules or Rules(), limits or Limits(), progress, began)
    reason = None
    if valid.any():
        reason = None if task.begin(heuristic, weight, admissible) else Status.MEMORY_LIMIT
        while reason is None:
            reason = task.advance()

    result.cost[valid] = task.goal_cost
    for i in range(len(keys)):
        solved = np.isfinite(result.cost[i])
        result.status[i] = Status.INVALID_GOAL if not valid[i] else Status.SOLVED if solved else reason
    task.count(result)
    if paths:
        for i, key in enumerate(keys):
            found = task.path(int(key)) if result.status[i] == Status.SOLVED else (None, None, None)
            for values, value in zip((result.states, result.actions, result.edge_costs), found, strict=True):
                values.append(value)
            if found[2] is not None:
                # The store keeps single precision; the plan's own cost is the sum of its edges.
                result.cost[i] = found[2].sum()
    result.seconds = time.perf_counter() - began
    return result


class Search:
    """A search under way: its store, its limits, and what it is guided by.

    Args:
        world: terrain and robot.
        start: packed state.
        goals: int64 [n], packed states.
        rules, limits, progress: as in ``solve``.
        began: when the clock started, as told by ``time.perf_counter``.
    """

    def __init__(self, world: World, start: int, goals: np.ndarray, rules: Rules, limits: Limits, progress, began):
        self.world, self.start, self.goals = world, start, goals
        self.rules, self.limits, self.progress, self.began = rules, limits, progress, began
        self.goal_cost = np.full(len(goals), np.inf, dtype=np.float32)
        # Held nowhere else, so that what is exchanged for something larger is freed.
        self.store = new_store((world.nx, world.ny), neutral_feet(world.tables.lowest))
        for key in goals:
            if not has_room(self.store):
                self.store = grown(self.store)
            search.mark_goal(self.store, key)
        self.store.count[GOALS_LEFT] = len(goals)

    def begin(self, heuristic: Estimate, weight: float, admissible: bool, reopen: bool = True) -> bool:
        """Put the start in the open list; False if even the empty store exceeds the limit on memory."""
        self._set_order(heuristic, weight, admissible, reopen)
        search.insert_start(self.store, heuristic, weight, self.start)
        return self.store.nbytes() <= self.limits.memory

    def begin_round(self, heuristic: Estimate, weight: float, admissible: bool, reopen: bool) -> bool:
        """Fill the open list anew, in another order; False if the limit on memory leaves no room for it."""
        self._set_order(heuristic, weight, admissible, reopen)
        open_list.clear(self.store)
        if not self._grow(count_waiting(self.store)):
            return False
        search.push_waiting(self.store, heuristic, weight)
        return True

    def _set_order(self, heuristic: Estimate, weight: float, admissible: bool, reopen: bool) -> None:
        self._heuristic, self._weight, self._reopen = heuristic, weight, reopen
        self._f_limit = weight * self.limits.cost if admissible else np.inf

    def advance(self) -> Status | None:
        """Search on for a while; returns how the search ended, None if it did not."""
        left = self.limits.expansions - int(self.store.count[EXPANDED])
        if left <= 0:
            return Status.EXPANSION_LIMIT
        code = search.run(
            self.world, self.rules, self._heuristic, self.store, self._weight, self.goals, self.goal_cost,
            self.limits.cost, self._f_limit, min(left, _SLICE), self._reopen,
        )  # fmt: skip
        if code in _ENDS:
            return _ENDS[code]
        if code == search.FULL and not self._grow():
            return Status.MEMORY_LIMIT
        elapsed = time.perf_counter() - self.began
        if self.progress is not None:
            self.progress(int(self.store.count[EXPANDED]), elapsed)
        return Status.TIME_LIMIT if elapsed > self.limits.time else None

    def _grow(self, entries: int = MAX_SUCCESSORS) -> bool:
        """Make room; False if the store and the larger arrays into which it is copied would exceed the limit."""
        if self.store.nbytes() + growth_nbytes(self.store) > self.limits.memory:
            return False
        self.store = grown(self.store)
        if self.store.nbytes() + open_list.growth_nbytes(self.store, entries) > self.limits.memory:
            return False
        self.store = open_list.with_room(self.store, entries)
        return True

    def count(self, result: SearchResult) -> None:
        """Enter what was spent so far."""
        result.expansions, result.seen = int(self.store.count[EXPANDED]), int(self.store.count[SEEN])
        result.memory, result.open_memory = self.store.nbytes(), self.store.open_nbytes()
        result.seconds = time.perf_counter() - self.began

    def path(self, key: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The way to a packed state: states int64 [n, 7], actions uint8 [n - 1] and their costs float64 [n - 1]."""
        path, actions = trace(self.world, self.store, key)
        edges = zip(path, path[1:], actions, strict=False)
        costs = [edge_cost(self.world, self.rules, int(a), int(b), int(action)) for a, b, action in edges]
        return unpack_states(path, self.world.tables.lowest), actions, np.array(costs, dtype=float)


def edge_cost(world: World, rules: Rules, key: int, reached: int, action: int) -> float:
    """Cost of one action between two packed states; inf if it is not legal."""
    keys, costs = np.empty(MAX_SUCCESSORS, np.int64), np.empty(MAX_SUCCESSORS)
    actions = np.empty(MAX_SUCCESSORS, np.uint8)
    n = successors(world, rules, key, keys, costs, actions)
    for k in range(n):
        if keys[k] == reached and actions[k] == action:
            return float(costs[k])
    return float("inf")
