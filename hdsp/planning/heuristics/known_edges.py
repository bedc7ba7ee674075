"""Edges of a map that a heuristic knows, evaluated all at once or where a search asks for them."""

from __future__ import annotations

import numpy as np

from hdsp.abstract.abstract_costs import AbstractCosts, BlockwiseCosts, LocalCosts, edge_steps
from hdsp.abstract.asked_distances import Edges
from hdsp.base.errors import InputError
from hdsp.base.gradual import Gradual, Steps
from hdsp.detailed.world.world import World
from hdsp.robot.lattice import (
    ABSTRACT_HEADINGS,
    CELLS_PER_ABSTRACT,
    DRIVE_MOVES,
    HEADINGS_PER_ABSTRACT,
    N_ABSTRACT_ACTIONS,
)
from hdsp.terrain.height_map import HeightMap

#: Price of an action that the abstraction judges infeasible, relative to its cost on even ground.
DOUBT = 3.0
#: The same, for the choice of ways: a way over such an action is chosen where a detour costs more, or there is none.
ORDER = 16.0


class KnownEdges:
    """Edges from the states of a map at which the robot can stand, as far as they were evaluated.

    Several threads may evaluate edges; each is evaluated once.

    Args:
        world: terrain and robot, compiled.
        terrain: the same terrain.
        costs: the abstraction.
        standing: bool [16, nx, ny], states at which the robot can stand.

    Attributes:
        blockwise: whether edges may be evaluated where they are needed; otherwise, all are evaluated at once.
        evaluated: number of states evaluated so far, again after changes of the map.
    """

    def __init__(self, world: World, terrain: HeightMap, costs: AbstractCosts, standing: np.ndarray):
        self.costs, self.terrain, self.standing = costs, terrain, standing
        self.evaluated, self._left = 0, int(standing.sum())
        self._prices = _prices(world)
        stated = costs.least if isinstance(costs, BlockwiseCosts) else None
        self.blockwise = stated is not None
        # Without costs that are stated beforehand, the edges themselves tell the least ones.
        self._least = self._prices if stated is None else np.minimum(stated, self._prices).astype(float)
        self._edges = np.empty((standing.size, N_ABSTRACT_ACTIONS), np.float32)
        self._known = np.zeros(standing.size, np.bool_)
        self._running: Gradual[None] | None = None

    @property
    def edges(self) -> Edges:
        """The edges for a search. It sees edges that are evaluated later, but no change of the map."""
        nx, ny = self.standing.shape[1:]
        order, spared = ORDER / DOUBT * self._prices, (ORDER / DOUBT - 1) * self._prices
        spared[np.isinf(spared)] = 0.0
        return Edges(self._edges, self._known, self.standing.ravel(), self._least, order, spared, nx, ny)

    @property
    def across(self) -> float:
        """Cost of a drive along two sides of the map on even ground."""
        return float(self._prices[:, : len(DRIVE_MOVES)].min()) / DOUBT * sum(self.standing.shape[1:])

    @property
    def complete(self) -> bool:
        """Whether all edges are evaluated."""
        return self._left == 0

    def missing(self) -> np.ndarray:
        """Returns all states without evaluated edges, flat indices int64 [n]."""
        return np.flatnonzero(self.standing.ravel() & ~self._known)

    def evaluate_all(self) -> Steps[None]:
        """Evaluates all edges that are not known."""
        while len(missing := self.missing()):
            yield from self._step(lambda missing=missing: self._mask(missing, 0))

    def evaluate(self, states: np.ndarray) -> Steps[None]:
        """Evaluates edges of states, flat indices int64 [n], and of states in the same blocks."""
        block = self.costs.block if isinstance(self.costs, BlockwiseCosts) else 0
        while not self._known[states].all():
            yield from self._step(lambda: self._mask(states[~self._known[states]], block))

    def _step(self, mask) -> Steps[None]:
        if self._running is None or self._running.done or self._running.failed:
            self._running = Gradual(self._evaluation(mask()))
        # An evaluation that a query with little time began is continued by the next one.
        self._running.step()
        yield

    def _mask(self, states: np.ndarray, block: int) -> np.ndarray:
        """States to evaluate, bool [16, nx, ny]: those given, and all in the same blocks."""
        mask = np.zeros(self.standing.shape, bool)
        k, a, b = np.unravel_index(states, mask.shape)
        mask[k, a, b] = True
        if block > 1:
            for heading, x, y in np.unique(np.column_stack([k, a // block, b // block]), axis=0).tolist():
                mask[heading, x * block : (x + 1) * block, y * block : (y + 1) * block] = True
        return mask & self.standing & ~self._known.reshape(mask.shape)

    def _evaluation(self, mask: np.ndarray) -> Steps[None]:
        (first_x, first_y), (end_x, end_y) = (0, 0), mask.shape[1:]
        if self.blockwise or self._known.any():  # costs without blocks and updates are asked for whole maps alone
            _, first_x, first_y = (int(at.min()) for at in np.nonzero(mask))
            _, end_x, end_y = (int(at.max()) + 1 for at in np.nonzero(mask))
        part = mask[:, first_x:end_x, first_y:end_y]
        region = None if part.shape == mask.shape else (first_x, first_y, end_x, end_y)
        found = yield from edge_steps(self.costs, self.terrain, part, region)
        if np.shape(found) != (*part.shape, N_ABSTRACT_ACTIONS):
            expected = (*part.shape, N_ABSTRACT_ACTIONS)
            raise InputError(f"abstract edges have shape {np.shape(found)}, expected {expected}")
        values = np.asarray(found, np.float32)[part]
        if not (values >= 0).all():
            raise InputError(f"abstract edges contain the cost {values[~(values >= 0)][0]}, costs must be >= 0")
        headings = np.nonzero(part)[0]
        if self.blockwise:
            values = np.maximum(values, self._least[headings].astype(np.float32))
        else:
            self._least = self._least.copy()
            for k in range(ABSTRACT_HEADINGS):
                self._least[k] = np.minimum(self._least[k], values[headings == k].min(axis=0, initial=np.inf))
        states = np.flatnonzero(mask)
        self._edges[states], self._known[states] = values, True
        self.evaluated, self._left = self.evaluated + len(states), self._left - len(states)

    def update(self, terrain: HeightMap, standing: np.ndarray, changed: np.ndarray) -> bool:
        """Takes over a changed map; edges that the change reaches are no longer known.

        Args:
            terrain: the map.
            standing: bool [16, nx, ny], states at which the robot can stand now.
            changed: bool [nx, ny], cells with other heights.

        Returns:
            Whether the costs know how far a change reaches; otherwise, everything has to start from nothing.
        """
        if not isinstance(self.costs, LocalCosts):
            return False
        self._running = None
        # States at which the robot could not stand before have no edges yet.
        self._known = self._known & standing.ravel() & ~self.costs.affected(changed).ravel()
        self.terrain, self.standing = terrain, standing
        self._left = len(self.missing())
        return True


def _prices(world: World) -> np.ndarray:
    """Prices of actions that the abstraction judges infeasible, float64 [16, 22]."""
    t = world.tables
    drives = CELLS_PER_ABSTRACT * t.drive_price[0, ::HEADINGS_PER_ABSTRACT, : len(t.move_dx)]
    turns = np.full((ABSTRACT_HEADINGS, 2), HEADINGS_PER_ABSTRACT * world.constants.turn)
    return DOUBT * np.concatenate([drives, turns], axis=1)
