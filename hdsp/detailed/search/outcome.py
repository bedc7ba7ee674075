"""End of a search: status, limits and result."""

from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

import numpy as np


class Status(IntEnum):
    """Final status of a search, or of one of its goals."""

    SOLVED = 0
    INFEASIBLE = 1  # proven: all reachable states were expanded
    COST_LIMIT = 2  # proven: no plan costs less than the limit
    EXPANSION_LIMIT = 3
    MEMORY_LIMIT = 4
    TIME_LIMIT = 5
    INVALID_START = 6
    INVALID_GOAL = 7
    CANCELLED = 8  # by another thread

    def __str__(self) -> str:
        return self.name.lower()


@dataclass(frozen=True)
class Limits:
    """Limits that end a search. ``cost`` decides feasibility; the others leave it open.

    Attributes:
        cost: plans above this cost are of no interest.
        expansions: number of expanded states.
        memory: bytes in the store and the open lists; a growing array counts together with its larger copy.
        time: seconds.
    """

    cost: float = np.inf
    expansions: int = 50_000_000
    memory: int = 4 << 30
    time: float = 600.0


class Path(NamedTuple):
    """Path to a goal.

    Attributes:
        states: int64 [n, 7] from start to goal, lattice units.
        actions: uint8 [n - 1], action codes.
        costs: float64 [n - 1], cost per action.
    """

    states: np.ndarray
    actions: np.ndarray
    costs: np.ndarray

    @property
    def cost(self) -> float:
        return float(self.costs.sum())


@dataclass
class SearchResult:
    """Result of a search from one start to one or several goals.

    Attributes:
        status: one per goal, in the given order.
        cost: float64 [goals], inf where not solved.
        paths: one per goal, None where not solved; empty if no paths were requested.
        reached: index of the goal reached in a search to the nearest of several goals; None for other searches and
            without a plan.
        lower_bound: proven for one status: no plan costs less; 0 without a proof.
        bound: proven for one status: the plan costs at most ``bound`` times the least possible cost; inf without a
            proof.
        expansions: states expanded.
        expansions_by: expansions per open list, the anchor first; multi-heuristic search only.
        seen: states generated.
        memory: bytes at the end, store and open lists.
        open_memory: bytes in the open lists, part of ``memory``.
        seconds: time spent.
    """

    status: list[Status]
    cost: np.ndarray
    paths: list[Path | None] = field(default_factory=list)
    reached: int | None = None
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
        """Builds the result for these paths.

        The cost of a plan is the sum over its actions, because the store has only single precision.
        """
        return cls(status, np.array([np.inf if path is None else path.cost for path in paths]), paths)
