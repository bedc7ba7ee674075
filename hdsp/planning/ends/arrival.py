"""Goal states: one state, all states within a tolerance, or those of several goals."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeGuard

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.gradual import Steps, finished
from hdsp.base.messages import shown
from hdsp.detailed.actions.state_costs import separated, state_costs
from hdsp.detailed.causes import Cause
from hdsp.detailed.states import distinct_rows, pack_states
from hdsp.detailed.world.world import World
from hdsp.planning.arguments import number, pose_values
from hdsp.planning.ends.location import locate
from hdsp.planning.ends.nearby import states_at
from hdsp.robot.lattice import HEADINGS, Grid, cells, heading_angle
from hdsp.robot.robot import Robot

#: Distance (m) or distance and difference in heading (m, rad) from a goal within which a plan may end.
Tolerance = float | tuple[float, float]
#: Bytes for a state at a goal, with the work on it.
STATE_BYTES = 400
_ROUNDING = 1e-9  # m
_FEET_AT_ONCE = 30_000  # foot configurations between two looks at the clock
_CELLS_AT_ONCE = 30_000  # cells near a goal, likewise
_AT_ONCE = 256  # poses between two looks at the clock, on ground where T_a->d takes long


@dataclass(frozen=True, eq=False)
class Arrival:
    """States at which a plan may end.

    Attributes:
        states: int64 [n, 7], lattice units, valid; empty if the robot can stand at no goal.
        goal: int64 [n], number of the goal to which each state belongs.
        exact: whether the states are one state for each goal.
        faults: faults of the first goal, and further words; empty if there is a state.
    """

    states: np.ndarray
    goal: np.ndarray
    exact: bool
    faults: tuple[Cause | str, ...] = ()


def arrival(world: World, grid: Grid, robot: Robot, goals: Sequence, tolerance: Tolerance | None) -> Arrival:
    """Does the work of ``arrival_steps`` at once."""
    return finished(arrival_steps(world, grid, robot, goals, tolerance))


def arrival_steps(
    world: World, grid: Grid, robot: Robot, goals: Sequence, tolerance: Tolerance | None, memory: float = math.inf
) -> Steps[Arrival]:
    """Finds the states at which a plan may end, in steps.

    A goal without tolerance and with a heading is the nearest pose on the lattice, on the given feet. Without feet, it
    is on neutral feet if T_a->d chooses them; else the robot may arrive on any feet on which it stands, since few feet
    lead to a pose on rough ground. A tolerance adds all poses of the lattice within it. The robot stands there on the
    given feet; without them on neutral feet, or where it cannot, on the feet from T_a->d.

    Args:
        world: terrain and robot, compiled.
        grid: place of the terrain in the world.
        robot: its limits.
        goals: poses as for ``locate``; the heading may be None, then any heading counts.
        tolerance: see ``Tolerance``; a distance alone leaves the heading as it is.
        memory: bytes for these states.

    Raises:
        InputError: a pose or a tolerance has other values, a pose lies off the map, or the states take more memory.
    """
    within = _checked(tolerance)
    found, numbers, faults, exact = [], [], [], True
    for k, goal in enumerate(goals):
        if k > 0:
            yield
        pose, free = with_heading(goal)
        name = "goal" if len(goals) == 1 else f"goal {k}"
        state, wrong = locate(world, grid, robot, pose, name)
        if free or within is not None:
            exact = False
            distance, turn = within or (0.0, 0.0)
            values = pose_values(pose, name, robot)
            around = yield from _around(world, grid, values, state, distance, math.pi if free else turn, memory)
            states = around if wrong else _with_state(around, state)
        elif wrong or len(pose_values(pose, name, robot)) == 7 or not state[3:].any():
            states = state[None][: 0 if wrong else 1]
        else:
            states = yield from _on_any_feet(world, state, memory)
            exact = exact and len(states) == 1
        if len(states) == 0:
            faults.append(wrong)
        memory -= STATE_BYTES * len(states)
        found.append(states)
        numbers.append(np.full(len(states), k))
    states, numbers_of = np.concatenate(found), np.concatenate(numbers)
    if len(states):
        # A search counts each state once, also between goals that overlap; those of one goal differ.
        first = np.sort(distinct_rows(states)) if len(goals) > 1 else slice(None)
        return Arrival(states[first], numbers_of[first], exact)
    words: list[Cause | str] = list(faults[0])
    if not exact:
        words.append("nor at any other pose within the tolerance")
    if len(goals) > 1:
        words.append("nor at any other goal")
    return Arrival(states, numbers_of, exact, tuple(words))


def poses_of(start, goal) -> tuple[np.ndarray, ...]:
    """Returns a start and the first goal as arrays, a free heading as 0; the start alone if the goal is no pose."""
    first = (several(goal) or [goal])[0]
    try:
        return np.array(start, float), np.array(with_heading(first)[0], float)
    except (TypeError, ValueError):
        return (np.array(start, float),)


def several(goal) -> list | None:
    """Returns the poses of a sequence of goals; None if the argument is one pose."""
    if not _is_row(goal):
        return None
    if len(goal) == 0:
        raise InputError("goal is empty: need a pose, or a sequence of poses")
    return list(goal) if all(_is_row(each) for each in goal) else None


def with_heading(goal) -> tuple[object, bool]:
    """Returns a goal with a number for its heading, and whether it leaves the heading free."""
    if _is_row(goal) and len(goal) in (3, 7) and goal[2] is None:
        return (*goal[:2], 0.0, *goal[3:]), True
    return goal, False


def _is_row(value: object) -> TypeGuard[Sequence | np.ndarray]:
    """Whether a value has entries; a text has none, nor has an array of numpy without axes."""
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, Sequence) and not isinstance(value, str | bytes)


def _checked(tolerance: Tolerance | None) -> tuple[float, float] | None:
    if tolerance is None:
        return None
    if not _is_row(tolerance) and not isinstance(tolerance, str):
        return number("tolerance", tolerance, 0.0), 0.0
    if isinstance(tolerance, str) or len(tolerance) != 2:
        raise InputError(f"tolerance is {shown(tolerance)}; it must be a number >= 0 in m, or a pair (m, rad)")
    return number("tolerance in m", tolerance[0], 0.0), number("tolerance in rad", tolerance[1], 0.0)


def _check_memory(states: int, memory: float) -> None:
    needed = STATE_BYTES * states
    if needed > memory:
        raise InputError(f"{states} states at the goal need {needed} bytes at least; {max(int(memory), 0)} are left")


def _on_any_feet(world: World, state: np.ndarray, memory: float) -> Steps[np.ndarray]:
    """Finds the valid states, int64 [n, 7], at the pose of a state, the state first."""
    t = world.tables
    _check_memory(t.n_offsets**4, memory)
    feet = _all_feet(t.lowest, t.n_offsets, 2 * world.constants.neutral_x - world.constants.min_separation)
    found = [state[None]]
    for part in np.array_split(feet, range(_FEET_AT_ONCE, len(feet), _FEET_AT_ONCE)):
        if len(found) > 1:
            yield
        states = np.column_stack([np.broadcast_to(state[:3], (len(part), 3)), part])
        states = states[np.isfinite(state_costs(world, pack_states(states, t.lowest)))]
        found.append(states[(states != state).any(axis=1)])
    return np.concatenate(found)


@lru_cache(maxsize=4)
def _all_feet(lowest: int, n_offsets: int, apart: float) -> np.ndarray:
    """Foot offsets, int64 [n, 4], whose sides stay apart."""
    offsets = np.arange(lowest, lowest + n_offsets)
    feet = np.stack(np.meshgrid(*[offsets] * 4, indexing="ij"), axis=-1).reshape(-1, 4)
    return feet[(feet[:, 1] - feet[:, 0] <= apart) & (feet[:, 2] - feet[:, 3] <= apart)]


def _with_state(states: np.ndarray, state: np.ndarray) -> np.ndarray:
    """States int64 [n, 7] in lexicographic order, together with another one; base poses of ``states`` differ."""
    x, y, heading = state[:3]
    same_row = states[:, 0] == x
    before = (states[:, 0] < x) | (same_row & (states[:, 1] < y))
    same = np.flatnonzero(same_row & (states[:, 1] == y))
    place = int(np.count_nonzero(before) + np.count_nonzero(states[same, 2] < heading))
    beside = states[place : place + 1]
    if (beside == state).all(axis=1).any():
        return states
    place += bool((beside[:, :3] == state[:3]).all(axis=1).any() and beside[0, 3:].tolist() < state[3:].tolist())
    return np.insert(states, place, state, axis=0)


def _around(
    world: World, grid: Grid, values: np.ndarray, state: np.ndarray, distance: float, turn: float, memory: float
) -> Steps[np.ndarray]:
    """Finds the valid states, int64 [n, 7], at the poses within a distance (m) and a difference in heading (rad)."""
    t, given = world.tables, len(values) == 7
    feet = state[3:]
    if given and ((feet < t.lowest).any() or (feet >= t.lowest + t.n_offsets).any()):
        return np.empty((0, 7), dtype=np.int64)
    off = np.mod(heading_angle(np.arange(HEADINGS)) - values[2] + math.pi, 2 * math.pi) - math.pi
    headings = np.flatnonzero((abs(off) <= turn + _ROUNDING) | (np.arange(HEADINGS) == state[2]))
    count = 0
    for at in _positions(grid, state, values, distance):
        if count:
            yield
        count += len(at)
    _check_memory(count * len(headings), memory)
    found: list[np.ndarray] = []
    rows = max(_AT_ONCE // len(headings), 1)
    for at in _positions(grid, state, values, distance):
        for part in np.array_split(at, range(rows, len(at), rows)):
            if found:
                yield
            bases = np.column_stack([np.repeat(part, len(headings), axis=0), np.tile(headings, len(part))])
            found.append(_standing_at(world, bases, feet if given else None))
    return np.concatenate(found)


def _positions(grid: Grid, state: np.ndarray, values: np.ndarray, distance: float) -> Iterator[np.ndarray]:
    """Yields the cells, int64 [n, 2], within a distance (m) of a pose, and that of its state; some rows at a time."""
    reach = math.ceil(min(cells(distance), max(grid.shape))) + 1
    low, high = np.maximum(state[:2] - reach, 0), np.minimum(state[:2] + reach + 1, grid.shape)
    (x0, y0), (x1, y1) = low.tolist(), high.tolist()
    rows = max(_CELLS_AT_ONCE // (y1 - y0), 1)
    for x in range(x0, x1, rows):
        span = np.arange(x, min(x + rows, x1)), np.arange(y0, y1)
        at = np.stack(np.meshgrid(*span, indexing="ij"), axis=-1).reshape(-1, 2)
        away = np.hypot(*(grid.center(at) - values[:2]).T)
        yield at[(away <= distance + _ROUNDING) | (at == state[:2]).all(axis=1)]


def _standing_at(world: World, bases: np.ndarray, feet: np.ndarray | None) -> np.ndarray:
    """Valid states, int64 [n, 7], at base poses [m, 3], on given feet [4], or on feet as from ``states_at``."""
    if feet is None or len(bases) == 0:
        states, stands = states_at(world, bases)
        return states[stands]
    states = np.column_stack([bases, np.broadcast_to(feet, (len(bases), 4))])
    keys = pack_states(states, world.tables.lowest)
    return states[np.isfinite(state_costs(world, keys)) & separated(world.constants, int(keys[0]))]
