"""Costs-to-go for one query on a large map, from edges that are evaluated near its way (`hdsp.abstract.guided`)."""

from __future__ import annotations

import numpy as np

from hdsp.abstract.cut_off import reconnect
from hdsp.abstract.guided import DEARER, MixedEdges, find_band
from hdsp.base.gradual import Steps
from hdsp.planning.heuristics.corridor_steps import states_around
from hdsp.planning.heuristics.goal_sources import Sources
from hdsp.planning.heuristics.known_edges import KnownEdges

#: Abstract states of a map beyond which a query on it is guided; a square of 12.5 m.
LARGE = 250_000
#: Relative rise of the guide's costs in costs-to-go, so that a search leaves the evaluated states late.
OUTSIDE = 1.0


def guided_steps(
    known: KnownEdges, guide: KnownEdges, start: np.ndarray, sources: Sources, prices: np.ndarray
) -> Steps[np.ndarray]:
    """Computes costs-to-go of the whole map, in steps.

    They depend neither on edges that other queries have evaluated, nor on the steps.

    Args:
        known: the abstraction's edges; missing ones are evaluated near the way.
        guide: the guide's edges.
        start: int64 [7], lattice units.
        sources: abstract states around the goals.
        prices: float64 [16, 22], price of an action that both judge infeasible. It counts only where no way leads from
            the start to a goal without such actions.

    Returns:
        Float64 [16, nx, ny]; inf without a way to a goal.
    """
    yield from guide.evaluate_all()
    standing, mixed = known.standing, MixedEdges(guide.graph)
    starts, entered = states_around(start, standing), np.zeros(standing.shape, bool)
    opened: np.ndarray | None = None

    def raise_guide(share: float) -> Steps[None]:
        mixed.raise_by(share)
        yield
        mixed.enter(known.from_evaluated, entered, *known.extremes)
        yield
        if opened is not None:
            mixed.open(prices, opened)

    while True:
        distances = yield from mixed.graph.distance_steps(sources.states, sources.costs)
        yield
        band = find_band(mixed.graph, distances, starts)
        yield
        if band is None and opened is None:
            opened = standing.copy()
            opened[sources.states[:, 2], sources.states[:, 0], sources.states[:, 1]] = True
            mixed.open(prices, opened)
            continue
        if band is None or not (band.inside & standing & ~entered).any():
            break
        missing = band.around & standing & ~entered
        yield from known.evaluate(missing)
        entered |= missing
        yield from raise_guide(DEARER)
    yield from raise_guide(OUTSIDE)
    graph = mixed.graph
    distances = yield from graph.distance_steps(sources.states, sources.costs)
    yield
    passed_over = graph.passed_over
    yield
    to_go = np.maximum(graph.bridged(distances) - sources.excess, 0.0)
    yield
    reconnect(to_go, standing | passed_over, prices)
    return to_go
