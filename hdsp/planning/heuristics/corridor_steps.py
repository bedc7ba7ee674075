"""Costs-to-go for one query, from edges that are evaluated where it needs them."""

from __future__ import annotations

import numpy as np

from hdsp.abstract.corridor import FIRST, NEAR, connected, costs_around, find_corridor, least_costs_from
from hdsp.base.gradual import Steps
from hdsp.planning.heuristics.goal_sources import Sources
from hdsp.planning.heuristics.known_edges import KnownEdges
from hdsp.robot.lattice import ABSTRACT_HEADINGS, detailed_to_abstract, surrounding_abstract

#: Price of an action that the abstraction judges infeasible, relative to its cost on even ground.
DOUBT = 3.0


def corridor_steps(
    known: KnownEdges, start: np.ndarray, sources: Sources, prices: np.ndarray
) -> Steps[np.ndarray | None]:
    """Computes costs-to-go in and around the corridor of a query (`hdsp.abstract.corridor`), in steps.

    They depend neither on edges that other queries have evaluated, nor on the steps. A goal that the abstraction cuts
    off is connected to states around it, at the prices of infeasible actions.

    Args:
        known: edges of ``BoundedCosts``; missing ones are evaluated.
        start: int64 [7], lattice units.
        sources: abstract states around the goals.
        prices: float64 [16, 22], price of an action that the abstraction judges infeasible.

    Returns:
        Float64 [16, nx, ny], inf outside; None if no abstract way leads from around the start to around a goal.
    """
    least, standing = known.least, known.standing
    assert least is not None
    open_states = standing.copy()
    open_states[sources.states[:, 2], sources.states[:, 0], sources.states[:, 1]] = True
    behind = least_costs_from(states_around(start, standing), open_states, least)
    yield from known.bounded()
    goals, costs, cut_off = sources.states, sources.costs, False
    first = begun = False
    while True:
        version = known.version
        # No step ends before some edges are evaluated, so that queries with little time get on.
        found = find_corridor(known.incoming, behind, goals, costs, least, DOUBT, first=first)
        if found is None and not cut_off:
            goals, costs = connected(goals, costs, open_states, prices, NEAR * DOUBT)
            cut_off = True
            continue
        if found is None:
            return None
        missing = found.around & standing & ~known.evaluated
        waiting = int((missing & found.states).sum())
        if waiting > FIRST and not begun:
            first = begun = True
            continue
        if waiting > 0:
            yield from known.evaluate(missing)
            continue
        if first:
            first = False
            continue
        to_go = costs_around(found, known.incoming, standing, least, prices, sources.excess)
        if version is known.version:  # no other thread has evaluated edges in the meantime
            return to_go


def states_around(start: np.ndarray, standing: np.ndarray) -> np.ndarray:
    """Abstract states, int64 [n, 3], between which the estimate of a start is interpolated."""
    last = np.array([*standing.shape[1:], ABSTRACT_HEADINGS]) - 1
    around, shares = surrounding_abstract(start[None])
    around = around[0][(shares[0] > 0) & ((around[0] >= 0) & (around[0] <= last)).all(axis=1)]
    stands = standing[around[:, 2], around[:, 0], around[:, 1]]
    return around[stands] if stands.any() else np.minimum(detailed_to_abstract(start[None]), last)
