"""Weighted A* that expands no state twice.

With a weight above 1 a state is often expanded before the cheapest way to it is found. Expanding it again each time a
cheaper one turns up, as ``solve`` does, can take hundreds of expansions a state. Without, the plan still costs at most
W times the optimum if the heuristic is consistent (M. Likhachev et al., ARA*, NIPS 2003, theorem 2): each state then
costs at most W times its optimum when it is expanded.
"""

import time

import numpy as np

from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.search.estimate import Estimate
from hdsp.detailed.search.solve import Limits, Search, SearchResult, Status
from hdsp.detailed.states import pack_states
from hdsp.detailed.world.world import World


def solve_once(
    world: World,
    start: np.ndarray,
    goal: np.ndarray,
    heuristic: Estimate,
    *,
    weight: float,
    limits: Limits | None = None,
    progress=None,
) -> SearchResult:
    """Search from one detailed state to another.

    Args:
        world: terrain and robot.
        start, goal: int64 [7], valid states in lattice units.
        heuristic: of the cost to the goal.
        weight: W > 1.
        limits: when to give up. Without reopening nothing is proved about costs: theirs has to be infinite.
        progress: called with (expansions, seconds) now and then.

    Returns:
        A result with one status.
    """
    limits = limits or Limits()
    assert np.isinf(limits.cost)
    began = time.perf_counter()
    start_key, goal_key = (int(pack_states(state, world.tables.lowest)[0]) for state in (start, goal))
    task = Search(world, start_key, np.array([goal_key]), Rules(), limits, progress, began)
    status = None if task.begin(heuristic, weight, admissible=False, reopen=False) else Status.MEMORY_LIMIT
    while status is None:
        status = task.advance()
    result = SearchResult([status], np.full(1, np.inf), [None], [None], [None])
    if status == Status.SOLVED:
        path, actions, costs = task.path(goal_key)
        result = SearchResult([status], np.full(1, costs.sum()), [path], [actions], [costs])
    task.count(result)
    return result
