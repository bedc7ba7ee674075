"""The contract of heuristics."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from copy import copy
from typing import Self

import numpy as np

from hdsp.abstract.abstract_costs import Region
from hdsp.base.errors import InputError
from hdsp.base.gradual import Steps
from hdsp.detailed.search.estimate import Estimate, final_estimates, geometric_estimate
from hdsp.detailed.states import pack_states
from hdsp.detailed.world.world import World
from hdsp.terrain.height_map import HeightMap


class Heuristic(ABC):
    """Estimates the cost from any detailed state to one goal, or to the nearest of several goals.

    A heuristic belongs to one terrain and one robot. Its life: ``prepare`` once per map, ``set_goal`` or ``set_goals``
    once per query, ``update`` after a change in the map, ``clear`` to forget the last goal.

    A subclass implements ``estimate_for``, and ``estimate_for_nearest`` if it can guide to several goals. They return a
    flat array and a lookup rule (``Estimate``), so that the search kernels never call Python. A call on the heuristic
    evaluates the same rule for any states.

    Convention: states are in lattice units (ix, iy, heading, 4 foot offsets); see ``hdsp.robot.lattice``.
    """

    name: str
    #: True if no estimate exceeds the true cost. Weighted A* then keeps its bound, W times the optimum.
    admissible: bool
    #: True if no action lowers the estimate by more than its cost and the estimate at the goal is 0. A consistent
    #: heuristic is admissible. Weighted A* then keeps its bound without reopening (``solve(..., reopen=False)``).
    consistent: bool = False

    def __init__(self, world: World):
        self.world = world
        self._estimate: Estimate | None = None

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r}, map of {self.world.nx} x {self.world.ny} cells)"

    @abstractmethod
    def estimate_for(self, goal: np.ndarray) -> Estimate:
        """Returns the estimate for a goal, int64 [7], lattice units."""

    def estimate_for_nearest(self, goals: np.ndarray, groups: np.ndarray) -> Estimate:
        """Returns the estimate for the nearest of several goals; here, the geometric estimate, for all subclasses.

        Args:
            goals: int64 [n, 7], lattice units.
            groups: int64 [n], number of the disc around each goal, 0, 1, ...; see ``geometric_estimate``.
        """
        return geometric_estimate(self.world, goals, groups)

    def prepare(self) -> None:  # noqa: B027, a hook that few heuristics need
        """Computes everything that holds for the whole map, independent of the goal."""

    def set_goal(self, goal: np.ndarray) -> Estimate:
        """Prepares for a goal, int64 [7]; returns the estimate for the kernels."""
        self._estimate = self.estimate_for(np.asarray(goal, dtype=np.int64))
        return self._estimate

    def set_goals(self, goals: np.ndarray, groups: np.ndarray) -> Estimate:
        """Prepares for the nearest of several goals, as in ``estimate_for_nearest``; returns the estimate."""
        goals, groups = np.asarray(goals, dtype=np.int64), np.asarray(groups, dtype=np.int64)
        self._estimate = self.estimate_for_nearest(goals, groups)
        return self._estimate

    def steps_to(self, goals: np.ndarray, groups: np.ndarray | None = None) -> Steps[Estimate]:
        """Does the work of ``prepare``, then of ``set_goal`` or ``set_goals``, in steps; returns the estimate.

        A query with a time limit stops between two steps. A subclass that takes seconds to prepare overrides this
        method, and keeps completed work for the next query.

        Args:
            goals: int64 [n, 7], lattice units.
            groups: as for ``set_goals``; None for one goal, as for ``set_goal``.
        """
        self.prepare()
        yield
        return self.set_goal(goals[0]) if groups is None else self.set_goals(goals, groups)

    def steps_from(self, start: np.ndarray, goals: np.ndarray, groups: np.ndarray | None = None) -> Steps[Estimate]:
        """Does the work of ``steps_to`` for searches from one start; here, the same work.

        A subclass may leave out work that these searches do not need. States far from their ways then have other
        estimates.

        Args:
            start: int64 [7], lattice units.
            goals, groups: as for ``steps_to``.
        """
        return (yield from self.steps_to(goals, groups))

    def others(self) -> Sequence[Heuristic]:
        """Heuristics that take turns with this one in a long search, in which this one may be wrong; here, none."""
        return ()

    def needed_memory(self) -> int:
        """Bytes that queries take beside their searches, at most; here, none.

        The preparation counts, and results for the whole map, also those of earlier queries.
        """
        return 0

    def keep_within(self, memory: int) -> None:  # noqa: B027, for heuristics that keep further work
        """Sets a limit, in bytes, for work that is kept for later queries and that they can do without."""

    def kept(self) -> int:
        """Bytes of this work."""
        return 0

    def covers_map(self, estimate: Estimate) -> bool:
        """Whether an estimate from ``steps_from`` is as good as from ``steps_to``; False after less work."""
        return True

    def __call__(self, states: np.ndarray) -> np.ndarray:
        """Estimated costs, float64 [n], for detailed states [n, 7].

        Raises:
            InputError: without a goal.
        """
        if self._estimate is None:
            raise InputError(f"{self.name} heuristic: call set_goal first")
        return final_estimates(self.world, self._estimate, pack_states(states, self.world.tables.lowest))

    def clear(self) -> None:
        """Forgets the last goal; results for the whole map stay."""
        self._estimate = None

    def updated(self, world: World, terrain: HeightMap, region: Region | None = None) -> Self:
        """Returns the heuristic for a changed terrain; arguments as for ``update``. This one stays as it is."""
        result = copy(self)
        result.update(world, terrain, region)
        return result

    def update(self, world: World, terrain: HeightMap, region: Region | None = None) -> None:
        """Takes over a changed terrain and forgets the goal.

        A planner updates a shallow copy, and drops it after an error. A subclass therefore assigns new objects to its
        attributes, and leaves those that it has unchanged.

        Args:
            world: the terrain, compiled.
            terrain: the terrain.
            region: rectangle (first ix, first iy, end ix, end iy) in cells; outside, the map is unchanged. None: the
                change may be anywhere.
        """
        self.world, self._estimate = world, None
