"""A network's judgements of tasks, from any evaluation."""

from typing import NamedTuple

import numpy as np


class Judgements(NamedTuple):
    """Judgements of n patches with G goals each, float32 [n, G].

    Attributes:
        cost: label costs, meaningful for feasible tasks.
        logits: feasibility logits.
        planning_cost: costs for planning, in the same manner; None = the network does not predict them.
    """

    cost: np.ndarray
    logits: np.ndarray
    planning_cost: np.ndarray | None = None

    def store(self, rows: np.ndarray | slice, part: "Judgements") -> None:
        """Writes the judgements of some patches into these arrays."""
        for own, other in zip(self, part, strict=True):
            if own is not None:
                own[rows] = other

    @classmethod
    def empty(cls, shape: tuple[int, int], planning: bool) -> "Judgements":
        """Returns arrays to be filled."""
        return cls(*np.empty((3 if planning else 2, *shape), np.float32))
