"""Running a search to its end: limits, growth of memory, and the result."""

import time
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from hdsp.detailed import open_list, search
from hdsp.detailed.actions import MAX_SUCCESSORS, Rules, successors
from hdsp.detailed.estimate import Estimate
from hdsp.detailed.state_costs import state_cost
from hdsp.detailed.states import neutral_feet, pack_states, unpack_states
from hdsp.detailed.store import EXPANDED, GOALS_LEFT, SEEN, grown, has_room, new_store, trace
from hdsp.detailed.world import World


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
        memory: bytes of the store of states.
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
    rules = rules or Rules()
    limits = limits or Limits()
    lowest = world.tables.lowest
    goals = np.atleast_2d(goals)
    keys = pack_states(goals, lowest)
    start_key = int(pack_states(start, lowest)[0])
    status: list[Status] = [Status.TIME_LIMIT] * len(keys)
    result = SearchResult(status, np.full(len(keys), np.inf))
    if not np.isfinite(state_cost(world, start_key)):
        result.status = [Status.INVALID_START] * len(keys)
        return result
    valid = np.array([np.isfinite(state_cost(world, int(k))) for k in keys], dtype=bool)
    wanted = keys[valid]
    settled = np.full(len(wanted), np.inf, dtype=np.float32)
    store = new_store((world.nx, world.ny), neutral_feet(lowest))
    reason = None
    if len(wanted):
        for key in wanted:
            if not has_room(store):
                store = grown(store)
            search.mark_goal(store, key)
        store.count[GOALS_LEFT] = len(wanted)
        search.insert_start(store, heuristic, weight, start_key)
        task = world, rules, heuristic, store, weight, wanted, settled, limits.cost
        reason = Status.MEMORY_LIMIT
        if store.nbytes() <= limits.memory:
            reason, store = _loop(task, weight * limits.cost if admissible else np.inf, limits, began, progress)

    costs = np.full(len(keys), np.inf)
    costs[valid] = settled
    for i in range(len(keys)):
        if not valid[i]:
            status[i] = Status.INVALID_GOAL
        elif np.isfinite(costs[i]):
            status[i] = Status.SOLVED
        else:
            status[i] = reason
    result.cost = costs
    result.expansions = int(store.count[EXPANDED])
    result.seen = int(store.count[SEEN])
    result.memory, result.open_memory = store.nbytes(), store.open_nbytes()
    if paths:
        for i, key in enumerate(keys):
            _add_path(result, world, rules, store, int(key), status[i], lowest, i)
    result.seconds = time.perf_counter() - began
    return result


def _loop(task, f_limit, limits, began, progress):
    world, rules, heuristic, store, *rest = task
    while True:
        left = limits.expansions - int(store.count[EXPANDED])
        if left <= 0:
            return Status.EXPANSION_LIMIT, store
        code = search.run(world, rules, heuristic, store, *rest, f_limit, min(left, _SLICE), True)
        if code == search.SOLVED:
            return Status.SOLVED, store
        if code == search.EXHAUSTED:
            return Status.INFEASIBLE, store
        if code == search.OVER_COST_LIMIT:
            return Status.COST_LIMIT, store
        if code == search.FULL:
            if 2 * store.nbytes() > limits.memory:
                return Status.MEMORY_LIMIT, store
            store = open_list.with_room(grown(store), MAX_SUCCESSORS)
        elapsed = time.perf_counter() - began
        if progress is not None:
            progress(int(store.count[EXPANDED]), elapsed)
        if elapsed > limits.time:
            return Status.TIME_LIMIT, store


def _add_path(result, world, rules, store, key, status, lowest, i):
    if status != Status.SOLVED:
        result.states.append(None)
        result.actions.append(None)
        result.edge_costs.append(None)
        return
    path, actions = trace(world, store, key)
    costs = np.array(
        [edge_cost(world, rules, int(a), int(b), int(c)) for a, b, c in zip(path, path[1:], actions, strict=False)]
    )
    result.states.append(unpack_states(path, lowest))
    result.actions.append(actions)
    result.edge_costs.append(costs)
    # The store keeps single precision; the plan's own cost is the sum of its edges.
    result.cost[i] = costs.sum()


def edge_cost(world: World, rules: Rules, key: int, reached: int, action: int) -> float:
    """Cost of one action between two packed states; inf if it is not legal."""
    keys, costs = np.empty(MAX_SUCCESSORS, np.int64), np.empty(MAX_SUCCESSORS)
    actions = np.empty(MAX_SUCCESSORS, np.uint8)
    n = successors(world, rules, key, keys, costs, actions)
    for k in range(n):
        if keys[k] == reached and actions[k] == action:
            return float(costs[k])
    return float("inf")
