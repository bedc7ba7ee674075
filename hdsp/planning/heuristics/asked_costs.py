"""Costs-to-go for one goal, computed when a search asks for them."""

from __future__ import annotations

import numpy as np

from hdsp.abstract.asked_distances import (
    AIMED,
    ASKED,
    NO_MORE,
    AskedDistances,
    advance,
    aim_at,
    decide_all,
    enter_edges,
)
from hdsp.base.gradual import Steps, now
from hdsp.detailed.search.interpolation import CostsToGo
from hdsp.detailed.search.reading import missing
from hdsp.detailed.states import unpack
from hdsp.detailed.world.world import World
from hdsp.planning.heuristics.known_edges import KnownEdges
from hdsp.robot.lattice import ABSTRACT_HEADINGS, surrounding_abstract

#: Excess of costs over expected ones that the first and each further aim of an answer allows, relative.
_SLACK, _MORE_SLACK = 0.1, 4.0


class AskedCosts:
    """Answers to a search whose heuristic reads a table that is filled on the way; see ``life_cycle.Answers``.

    Args:
        world: terrain and robot of the table.
        known: the edges.
        search: the backward search behind the table.
        table: the table.

    Attributes:
        seconds: time spent so far.
        ends: moment on the clock ``now`` at which the time is over.
    """

    def __init__(self, world: World, known: KnownEdges, search: AskedDistances, table: CostsToGo):
        self.seconds, self.ends = 0.0, np.inf
        self._ahead, self._known, self._search, self._table = world.tables.ahead, known, search, table

    def answer(self) -> bool:
        """See ``life_cycle.Answers``."""
        began = now()
        try:
            return all(now() <= self.ends for _ in self.know(int(self._table.reading.asked[0])))
        finally:
            self.seconds += now() - began

    def know(self, key: int) -> Steps[None]:
        """Computes the costs-to-go that the expansion of a packed state reads."""
        search, wanted = self._search, self._table.reading.wanted
        aimed, slack = -np.inf, _SLACK
        while count := self._missing(key):
            if search.counts[ASKED] == 0:
                decide_all(search, wanted[:count])
            if search.counts[ASKED] == 0 and (count := self._missing(key)):
                if search.front[0] > aimed:
                    aimed, slack = self._aim(key, wanted[:count], slack), _MORE_SLACK * slack
                advance(search)
            if search.counts[ASKED] > 0:
                yield from self._known.evaluate(search.asked[: search.counts[ASKED]].copy())
                enter_edges(search)
            yield

    def _aim(self, key: int, places: np.ndarray, slack: float) -> float:
        """Aims the search at what is missing; returns f at which it has to aim again."""
        if self._search.counts[AIMED] and self._known.complete:
            return np.inf  # the search is faster than an aim
        _, nx, ny = self._known.standing.shape
        around = surrounding_abstract(np.array([unpack(key)]))[0][0]
        inside = around[((around >= 0) & (around < (nx, ny, ABSTRACT_HEADINGS))).all(axis=1)]
        return aim_at(self._search, places, (inside[:, 2] * nx + inside[:, 0]) * ny + inside[:, 1], slack)

    def _missing(self, key: int) -> int:
        table = self._table
        return missing(table.reading, table.values, table.uneven, self._ahead, table.nx, table.ny, key)


def all_distances(search: AskedDistances) -> None:
    """Completes a search whose edges are all evaluated."""
    while advance(search) != NO_MORE:
        pass
    decide_all(search, np.arange(len(search.known)))
