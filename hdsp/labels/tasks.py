"""Arrays with labelled tasks: label makers produce them; learning and evaluation use them."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.robot.lattice import N_ABSTRACT_ACTIONS, PATCH_CELLS

#: `TaskSet.reason` for labels without a reason. `hdsp.detailed.search.outcome.Status` defines the other values.
REASON_UNKNOWN = 255

_PATCH = (PATCH_CELLS, PATCH_CELLS)
_GOALS = (N_ABSTRACT_ACTIONS,)

#: dtype and shape per map for each array in a `TaskSet`, except `category`.
FIELDS = {
    "heights": (np.float32, _PATCH),
    "goals": (np.float32, (*_GOALS, 3)),
    "feasible": (np.bool_, _GOALS),
    "cost": (np.float32, _GOALS),
    "reason": (np.uint8, _GOALS),
    "index": (np.int64, ()),
    "seed": (np.int64, ()),
    "heading": (np.uint8, ()),
    "start": (np.float32, (7,)),
    "goal": (np.float32, (*_GOALS, 7)),
}


@dataclass(frozen=True, eq=False)
class TaskSet:
    """The 22 tasks of n maps, with their labels.

    Convention: patches and goals are in the robot frame (see `hdsp.terrain.height_map`). Goals are in abstract steps
    (10 cm, 22.5 degrees), in the order of `hdsp.robot.lattice.ABSTRACT_ACTIONS`.

    Attributes:
        heights: float32 [n, 72, 72], m, NaN = unknown.
        goals: float32 [n, 22, 3], (dx, dy, dtheta) in abstract steps.
        feasible: bool [n, 22].
        cost: float32 [n, 22], 0 where infeasible.
        reason: uint8 [n, 22], ``Status`` of the search for each goal.
        category: str [n], kind of terrain.
        index: int64 [n], map number in its category and split, or in its file.
        seed: int64 [n], seed of the split.
        heading: uint8 [n], start heading on the detailed lattice, [0, 64).
        start: float32 [n, 7], detailed start state: m, m, rad, 4 x m.
        goal: float32 [n, 22, 7], detailed goal states.

    Raises:
        InputError: if an array has the wrong shape, or a cost is not finite; the message names the array.
    """

    heights: np.ndarray
    goals: np.ndarray
    feasible: np.ndarray
    cost: np.ndarray
    reason: np.ndarray
    category: np.ndarray
    index: np.ndarray
    seed: np.ndarray
    heading: np.ndarray
    start: np.ndarray
    goal: np.ndarray

    def __post_init__(self):
        category = np.asarray(self.category, dtype=np.str_)
        if category.ndim != 1:
            raise InputError(f"task set: category has shape {category.shape}; need one name for each map")
        object.__setattr__(self, "category", category)
        for name, (dtype, shape) in FIELDS.items():
            array = np.asarray(getattr(self, name), dtype=dtype)
            if array.shape != (len(category), *shape):
                raise InputError(f"task set: {name} has shape {array.shape}; need {(len(category), *shape)}")
            object.__setattr__(self, name, array)
        if not np.isfinite(self.cost).all():
            raise InputError("task set: cost is not finite somewhere; infeasible tasks have feasible False and cost 0")

    def __len__(self) -> int:
        return len(self.category)

    def __getitem__(self, maps) -> "TaskSet":
        """Maps selected by a slice, an index array or a mask."""
        return TaskSet(**{name: array[maps] for name, array in self.arrays().items()})

    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays by name, without copies."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @classmethod
    def empty(cls) -> "TaskSet":
        """A task set without maps."""
        arrays: dict[str, Any] = {name: np.zeros((0, *shape), dtype) for name, (dtype, shape) in FIELDS.items()}
        return cls(category=np.zeros(0, np.str_), **arrays)

    @classmethod
    def concatenate(cls, sets: Sequence["TaskSet"]) -> "TaskSet":
        """Maps of all ``sets``, in their order."""
        if not sets:
            return cls.empty()
        return cls(**{name: np.concatenate([tasks.arrays()[name] for tasks in sets]) for name in sets[0].arrays()})
