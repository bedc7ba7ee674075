"""Edges of a map that a heuristic knows: all of them, or the edges that queries needed."""

from __future__ import annotations

import itertools
import math
import threading

import numpy as np

from hdsp.abstract.abstract_costs import (
    AbstractCosts,
    BoundedCosts,
    LocalCosts,
    Region,
    RememberingCosts,
    edge_steps,
)
from hdsp.abstract.prepared_graph import PreparedGraph, copy_edges, enter_edges, enter_least, replace_edges
from hdsp.base.errors import InputError
from hdsp.base.gradual import Gradual, Steps, finished
from hdsp.robot.lattice import ABSTRACT_ACTIONS, ABSTRACT_HEADINGS, N_ABSTRACT_ACTIONS
from hdsp.terrain.height_map import HeightMap

#: States whose edges are evaluated at once. They take 23 MB, which the C library keeps from one part to the next.
PART = 1 << 18


class KnownEdges:
    """Edges from the states of a map at which the robot can stand, as far as they were evaluated.

    Edges of ``BoundedCosts`` that are not evaluated have their least cost; others are missing. Several threads may
    evaluate edges. Memory for all edges of a large map is taken when ``incoming`` is first read.

    Args:
        terrain: the map.
        costs: the abstraction.
        standing: bool [16, nx, ny], states at which the robot can stand.

    Attributes:
        least: float32 [16, 22], least cost of an action by heading; None for costs without known bounds.
        evaluated: bool [16, nx, ny], states whose edges are known.
        from_evaluated: float32 [16, nx, ny, 22], edges by end state, see ``PreparedGraph``; without meaning where the
            start is not evaluated.
        version: another object after each evaluation.
    """

    def __init__(self, terrain: HeightMap, costs: AbstractCosts, standing: np.ndarray):
        self.terrain, self.costs, self.standing = terrain, costs, standing
        stated = costs.least if isinstance(costs, BoundedCosts) else None
        self.least = None if stated is None else np.array(stated, np.float32, order="C")
        self.evaluated, self.version = np.zeros(standing.shape, bool), object()
        self.from_evaluated = np.empty((*standing.shape, N_ABSTRACT_ACTIONS), np.float32)
        self._memory = costs.new_memory(terrain) if isinstance(costs, RememberingCosts) else None
        self._cheapest, self._most_expensive = np.inf, 0.0
        self._parts, self._writing = 0, threading.Lock()
        self._bounding = Gradual(self._bounding_steps())
        self._graph: PreparedGraph | None = None
        self._running: Gradual[None] | None = None

    @property
    def incoming(self) -> np.ndarray:
        """Edges by end state, float32 [16, nx, ny, 22], see ``PreparedGraph``, with least costs of other edges."""
        finished(self.bounded())
        return self.from_evaluated

    def bounded(self) -> Steps[None]:
        """Enters the costs of edges that are not evaluated, in steps."""
        while not self._bounding.step():
            yield

    def _bounding_steps(self) -> Steps[None]:
        bounds = np.full((ABSTRACT_HEADINGS, N_ABSTRACT_ACTIONS), np.inf, np.float32)
        if self.least is not None:
            bounds[:] = self.least
        for heading in range(ABSTRACT_HEADINGS):
            with self._writing:
                if self.least is None and not self.evaluated.any():
                    self.from_evaluated[heading] = np.inf
                else:
                    enter_least(self.from_evaluated, heading, self.standing, self.evaluated, bounds, ABSTRACT_ACTIONS)
            yield

    @property
    def share(self) -> float:
        """Share of the states at which the robot can stand whose edges are evaluated."""
        return float(self.evaluated.sum() / max(self.standing.sum(), 1))

    @property
    def complete(self) -> bool:
        """Whether all edges are evaluated."""
        return bool(self.evaluated[self.standing].all())

    @property
    def extremes(self) -> tuple[float, float]:
        """Bounds on the finite costs of evaluated edges, the cheapest first."""
        return self._cheapest, self._most_expensive

    @property
    def graph(self) -> PreparedGraph:
        """The graph of all edges; only after ``evaluate_all``."""
        if self._graph is None:
            self._graph = PreparedGraph(self.incoming, self._cheapest, self._most_expensive)
        return self._graph

    def keep_within(self, memory: int) -> None:
        """Sets a limit, in bytes, for the parts of the costs' work that later evaluations reuse."""
        if self._memory is not None:
            self._memory.most = memory

    def kept(self) -> int:
        """Bytes of these parts."""
        return 0 if self._memory is None else self._memory.nbytes()

    def evaluate_all(self) -> Steps[None]:
        """Evaluates all edges that are not known."""
        yield from self.bounded()
        yield from self.evaluate(self.standing)

    def evaluate(self, states: np.ndarray) -> Steps[None]:
        """Evaluates edges of states, bool [16, nx, ny], at which the robot can stand."""
        while (missing := states & ~self.evaluated).any():
            running, parts = self._running, self._parts
            # An evaluation that a query with little time began is continued by the next one.
            if running is None or running.done or running.failed:
                running = self._running = Gradual(self._evaluation(missing))
            while self._parts == parts and not running.done:
                running.step()
                yield

    def _evaluation(self, mask: np.ndarray) -> Steps[None]:
        if mask.size <= PART and np.array_equal(mask, self.standing):
            yield from self._part(mask, (0, 0, *mask.shape[1:]))
            return
        low_x, low_y, end_x, end_y = _rectangle(mask)
        # Edges of a part at once, because those of a large map take as much memory as the graph. Costs look at the
        # ground around a part, too, of which a square has least.
        side = max(math.isqrt(PART // ABSTRACT_HEADINGS), 1)
        for x, y in itertools.product(range(low_x, end_x, side), range(low_y, end_y, side)):
            region = x, y, min(x + side, end_x), min(y + side, end_y)
            part = mask[:, region[0] : region[2], region[1] : region[3]]
            if part.any():
                yield from self._part(part, region)

    def _part(self, part: np.ndarray, region: Region) -> Steps[None]:
        """Evaluates the edges of some states, bool [16, nx, ny], in a region."""
        # Edges of a whole map may come from a file, or take less time than by regions.
        whole = part.shape == self.standing.shape
        edges = yield from edge_steps(self.costs, self.terrain, part, None if whole else region, self._memory)
        expected = (*part.shape, N_ABSTRACT_ACTIONS)
        if np.shape(edges) != expected:
            raise InputError(f"abstract edges have shape {np.shape(edges)}, expected {expected}")
        edges = np.ascontiguousarray(edges, np.float32)
        least = np.zeros((ABSTRACT_HEADINGS, N_ABSTRACT_ACTIONS), np.float32) if self.least is None else self.least
        corner = np.array(region[:2])
        with self._writing:
            wrong, *extremes = enter_edges(self.from_evaluated, edges, part, corner, least, ABSTRACT_ACTIONS)
            if not wrong >= 0:
                raise InputError(f"abstract edges contain the cost {wrong}, costs must be >= 0")
            self._cheapest, self._most_expensive = (
                min(self._cheapest, extremes[0]),
                max(self._most_expensive, extremes[1]),
            )
            self._graph = None
            # A search that saw the former edges finds another version before it finds these states evaluated.
            self.version = object()
            self.evaluated[:, region[0] : region[2], region[1] : region[3]] |= part
            self._parts += 1

    def updated(self, terrain: HeightMap, standing: np.ndarray, changed: np.ndarray) -> KnownEdges | None:
        """Returns the edges of a changed map, without edges that the change reaches.

        Args:
            terrain: the map after the change.
            standing: bool [16, nx, ny], states at which the robot can stand now.
            changed: bool [nx, ny], cells with other heights.

        Returns:
            None if the costs do not know how far a change reaches.
        """
        if not isinstance(self.costs, LocalCosts):
            return None
        result = object.__new__(KnownEdges)
        result.__dict__.update(self.__dict__, terrain=terrain, standing=standing, _graph=None, _running=None)
        result._writing = threading.Lock()
        result._memory = None if self._memory is None else self._memory.after(changed)
        # States at which the robot could not stand before have no edges yet.
        result.evaluated = self.evaluated & standing & ~self.costs.affected(changed)
        if not self._bounding.done:
            result._bounding = Gradual(result._bounding_steps())
            result.from_evaluated = np.empty_like(self.from_evaluated)
            copy_edges(self.from_evaluated, result.from_evaluated, np.argwhere(result.evaluated), ABSTRACT_ACTIONS)
            return result
        result.from_evaluated = self.from_evaluated.copy()
        states = np.ascontiguousarray(np.argwhere((self.evaluated & ~result.evaluated) | (self.standing != standing)))
        bounds = np.full((len(states), N_ABSTRACT_ACTIONS), np.inf, np.float32)
        if self.least is not None:
            known = standing[tuple(states.T)]
            bounds[known] = self.least[states[known, 0]]
        replace_edges(result.from_evaluated, states, bounds, ABSTRACT_ACTIONS)
        return result


def _rectangle(mask: np.ndarray) -> Region:
    """Smallest region with all marked states, bool [16, nx, ny]."""
    cells = np.asarray(mask.any(axis=0))
    x, y = np.flatnonzero(cells.any(axis=1)), np.flatnonzero(cells.any(axis=0))
    return int(x[0]), int(y[0]), int(x[-1]) + 1, int(y[-1]) + 1
