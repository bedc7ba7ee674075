"""How a search ends: its status, the limits that end it, and its result."""

from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

import numpy as np


class Status(IntEnum):
    """How a search, or one of its goals, ended."""

    SOLVED = 0
    INFEASIBLE = 1  # proved: all states within reach were expanded
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
    """When a search gives up. ``cost`` decides feasibility; the others leave it open.

    Attributes:
        cost: no plan above this cost is of interest.
        expansions: number of expanded states.
        memory: bytes of the store and the open lists; the larger copy counts while an array grows.
        time: seconds.
    """

    cost: float = np.inf
    expansions: int = 50_000_000
    memory: int = 4 << 30
    time: float = 600.0


class Path(NamedTuple):
    """The way to a goal.

    Attributes:
        states: int64 [n, 7] from start to goal, lattice units.
        actions: uint8 [n - 1], action codes.
        costs: float64 [n - 1], of the actions.
    """

    states: np.ndarray
    actions: np.ndarray
    costs: np.ndarray

    @property
    def cost(self) -> float:
        return float(self.costs.sum())


@dataclass
class SearchResult:
    """Outcome of a search from one start to one or several goals.

    Attributes:
        status: of each goal, in the order given.
        cost: float64 [goals], inf where not solved.
        paths: one per goal, None where not solved; empty if no paths were asked for.
        lower_bound: proved, with one goal: no plan costs less. 0 if nothing is proved.
        bound: proved, with one goal: the plan costs at most so many times the least possible cost. inf if nothing is
            proved.
        expansions: states expanded.
        expansions_by: share of each open list in ``expansions``, the anchor first; multi-heuristic search alone.
        seen: states generated.
        memory: bytes at the end: store and open lists.
        open_memory: bytes of the open lists, part of ``memory``.
        seconds: time spent.
    """

    status: list[Status]
    cost: np.ndarray
    paths: list[Path | None] = field(default_factory=list)
    lower_bound: float = 0.0
    bound: float = np.inf
    expansions: int = 0
    expansions_by: tuple[int, ...] = ()
    seen: int = 0
    memory: int = 0
    open_memory: int = 0
    seconds: float = 0.0

    @classmethod
    def of(cls, status: list[Status], paths: list[Path | None]) -> "SearchResult":
        """The result with these paths. A store keeps single precision, so the cost of a plan is the sum of its
        actions."""
        return cls(status, np.array([np.inf if path is None else path.cost for path in paths]), paths)
