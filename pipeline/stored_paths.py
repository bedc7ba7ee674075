"""The paths of the planning experiment as a file, data/paths.npz, for the pages that draw them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.files import replacing
from hdsp.detailed.actions.action import Action, ActionKind
from hdsp.robot.robot import FEET

_KINDS = tuple(ActionKind)
_SEPARATOR = "|"


class PathKey(NamedTuple):
    """A search: its task, heuristic and weight."""

    task: str
    heuristic: str
    weight: float


class StoredPath(NamedTuple):
    """A path.

    Attributes:
        states: float64 [n, 7], world coordinates.
        actions: the n - 1 actions between the states.
    """

    states: np.ndarray
    actions: tuple[Action, ...]


def write_paths(path: Path, found: Mapping[PathKey, tuple[np.ndarray, Sequence[Action]]]) -> None:
    """Writes all paths with at least one action.

    Args:
        path: the file, .npz.
        found: states and actions of each search.
    """
    arrays: dict[str, Any] = {}
    for key, (states, actions) in found.items():
        if len(actions):
            name = _SEPARATOR.join([key.task, key.heuristic, repr(key.weight)])
            arrays[f"{name}{_SEPARATOR}states"] = np.asarray(states, np.float64)
            arrays[f"{name}{_SEPARATOR}actions"] = np.array([_row(action) for action in actions])
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)


def read_paths(path: Path) -> dict[PathKey, StoredPath]:
    """Reads the paths of a file.

    Raises:
        InputError: the file does not exist.
    """
    if not path.is_file():
        raise InputError(f"no paths in {path}; the stage plan writes them")
    found = {}
    with np.load(path, allow_pickle=False) as arrays:
        for name in arrays.files:
            *parts, kind = name.split(_SEPARATOR)
            if kind == "states":
                actions = tuple(map(_action, arrays[_SEPARATOR.join([*parts, "actions"])]))
                found[PathKey(parts[0], parts[1], float(parts[2]))] = StoredPath(arrays[name], actions)
    return found


def _row(action: Action) -> tuple[float, float, float]:
    """Kind, foot and length as numbers; -1 and NaN stand for None."""
    foot = -1 if action.foot is None else FEET.index(action.foot)
    return _KINDS.index(action.kind), foot, np.nan if action.length is None else action.length


def _action(row: np.ndarray) -> Action:
    kind, foot, length = row
    return Action(_KINDS[int(kind)], None if foot < 0 else FEET[int(foot)], None if np.isnan(length) else float(length))
