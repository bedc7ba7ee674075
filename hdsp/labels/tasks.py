"""Arrays with labelled tasks: label makers produce them; learning and evaluation use them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.notebook import html_of, png_of
from hdsp.base.short_repr import shortened
from hdsp.robot.lattice import HEADINGS, N_ABSTRACT_ACTIONS, PATCH_CELLS

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

#: The same for arrays that a set may lack.
OPTIONAL_FIELDS = {"planning_cost": (np.float32, _GOALS)}

#: Allowed values, in words.
_NEEDS = {
    "feasible": "True or False, or 1 or 0",
    "reason": "whole numbers from 0 to 255",
    "index": "whole numbers of 64 bits",
    "seed": "whole numbers of 64 bits",
    "heading": f"whole numbers from 0 to {HEADINGS - 1}",
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
        planning_cost: float32 [n, 22], cost for planning (`hdsp.abstract.CostKind`), 0 where infeasible; None = labels
            without it, such as published ones.

    Raises:
        InputError: if an array has the wrong shape, a value does not fit its type or range, or a cost, goal or start is
            not finite; the message names the array.
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
    planning_cost: np.ndarray | None = None

    def __post_init__(self):
        category = np.asarray(self.category, dtype=np.str_)
        if category.ndim != 1:
            raise InputError(f"task set: category has shape {category.shape}; need one name for each map")
        object.__setattr__(self, "category", category)
        optional = {name: kind for name, kind in OPTIONAL_FIELDS.items() if getattr(self, name) is not None}
        for name, (dtype, shape) in {**FIELDS, **optional}.items():
            array = _array_of(name, getattr(self, name))
            if array.shape != (len(category), *shape):
                raise InputError(f"task set: {name} has shape {array.shape}; need {(len(category), *shape)}")
            object.__setattr__(self, name, _as_type(name, array, np.dtype(dtype)))
        for name in ("cost", *optional):
            if not np.isfinite(getattr(self, name)).all():
                raise InputError(
                    f"task set: {name} is not finite somewhere; infeasible tasks have feasible False and cost 0"
                )
        for name in ("goals", "start", "goal"):
            if not np.isfinite(getattr(self, name)).all():
                raise InputError(f"task set: {name} is not finite somewhere")
        if np.inf in (np.fmax.reduce(self.heights, None, initial=0), -np.fmin.reduce(self.heights, None, initial=0)):
            raise InputError("task set: heights are infinite somewhere; unknown ground is NaN")

    def __repr__(self) -> str:
        if not len(self):
            return "TaskSet(no maps)"
        names, counts = np.unique(self.category, return_counts=True)
        kinds = [f"{count} {name}" for name, count in zip(names[:3], counts[:3], strict=True)]
        if len(names) > len(kinds):
            kinds.append(f"{counts[3:].sum()} in {len(names) - 3} other categories")
        return shortened(f"TaskSet({len(self)} maps: {', '.join(kinds)}; {self.feasible.mean():.0%} of tasks feasible)")

    def _repr_html_(self) -> str | None:
        return html_of(self)

    def _repr_png_(self) -> bytes | None:
        return png_of(self)

    def __len__(self) -> int:
        return len(self.category)

    def __getitem__(self, maps) -> "TaskSet":
        """Maps selected by a slice, an index array or a mask."""
        arrays = {name: array[maps] for name, array in self.arrays().items()}
        if (shape := arrays["category"].shape) != (arrays["category"].size,):
            raise InputError(f"task set: selected maps have shape {shape}; need a slice, an index array or a mask")
        return self._of_checked(arrays)

    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays by name, without copies and without those that the set lacks."""
        arrays = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: array for name, array in arrays.items() if array is not None}

    @classmethod
    def empty(cls) -> "TaskSet":
        """A task set without maps."""
        arrays: dict[str, Any] = {name: np.zeros((0, *shape), dtype) for name, (dtype, shape) in FIELDS.items()}
        return cls(category=np.zeros(0, np.str_), **arrays)

    @classmethod
    def concatenate(cls, sets: Sequence["TaskSet"]) -> "TaskSet":
        """Maps of all ``sets``, in their order; an optional array that one set lacks is left out."""
        if not sets:
            return cls.empty()
        arrays = [tasks.arrays() for tasks in sets if len(tasks)] or [sets[0].arrays()]
        shared = [name for name in arrays[0] if all(name in each for each in arrays)]
        return cls._of_checked({name: np.concatenate([each[name] for each in arrays]) for name in shared})

    @classmethod
    def _of_checked(cls, arrays: Mapping[str, np.ndarray]) -> "TaskSet":
        """A set with maps from other sets, whose values are not checked again: that reads all heights."""
        tasks = object.__new__(cls)
        for field in fields(cls):
            object.__setattr__(tasks, field.name, arrays.get(field.name))
        return tasks


def _array_of(name: str, values: Any) -> np.ndarray:
    """Numbers or truth values as an array in their own type."""
    try:
        array = np.asarray(values)
    except (TypeError, ValueError) as error:  # rows with different lengths
        raise InputError(f"task set: {name}: {' '.join(str(error).split())}") from None
    if array.dtype.kind not in "biuf":
        raise InputError(f"task set: {name} has values of type {array.dtype}; need {_NEEDS.get(name, 'numbers')}")
    return array


def _as_type(name: str, array: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """The array in another type, which holds the same values; only rounding changes them."""
    with np.errstate(invalid="ignore", over="ignore"):  # NaN in an array of integers; a number beyond float32
        cast = np.asarray(array, dtype)
    wrong = cast != array if dtype.kind != "f" else np.zeros(0, bool)
    if name == "heading":
        wrong = wrong | (array >= HEADINGS)
    if wrong.any():
        raise InputError(f"task set: {name} holds {array[wrong][0]}; need {_NEEDS[name]}")
    return cast


def columns_of(rows: Sequence[Any]) -> dict[str, np.ndarray]:
    """Arrays of a task set by name, from named tuples with the labels of one map each; ``None`` fields are left out."""
    columns = zip(rows[0]._fields, zip(*rows, strict=True), strict=True)
    return {name: np.array(column) for name, column in columns if column[0] is not None}
