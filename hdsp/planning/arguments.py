"""Arguments of a query: checked before anything is computed, with the argument's name in each message."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.messages import coordinates, shown
from hdsp.base.scalars import integer, real
from hdsp.detailed.search.life_cycle import Progress
from hdsp.detailed.search.outcome import Limits
from hdsp.robot.lattice import Grid, metres
from hdsp.robot.robot import Robot

#: Largest heading, rad. A larger one is more than a turn, and probably meant in degrees.
_TURN = 2 * math.pi + 1e-6
#: Largest weight of a search. Costs count as float32 there; with more, nothing but the heuristic would count.
MOST_WEIGHT = 1e6
#: Largest deviation of a rounded quaternion's norm from 1.
_UNIT = 0.02
#: Lengths in other units, as a factor to metres.
_UNITS = {"centimetres": 0.01, "millimetres": 0.001}


def number(name: str, value: Any, least: float, *, infinite: bool = False) -> float:
    """Returns an argument as float.

    Args:
        name: the argument in messages.
        value: its value: a Python or numpy number, no text, no truth value.
        least: smallest allowed value.
        infinite: whether inf is allowed.

    Raises:
        InputError: another type, NaN, a smaller value, or inf where it is not allowed. A number beyond the range of
            float counts as inf.
    """
    found = real(value)
    if not found >= least or (math.isinf(found) and not infinite):
        allowed = f"a number >= {least:g}, or inf" if infinite else f"a finite number >= {least:g}"
        raise InputError(f"{name} is {shown(value)}; it must be {allowed}")
    return found


def factor(name: str, value: Any) -> float:
    """Returns a weight of a search as float; arguments as in `number`.

    Raises:
        InputError: no number from 1 to ``MOST_WEIGHT``.
    """
    found = number(name, value, 1.0)
    if found > MOST_WEIGHT:
        raise InputError(f"{name} is {shown(value)}; it must be at most {MOST_WEIGHT:,.0f}")
    return found


def whole(name: str, value: Any, least: int = 0) -> int:
    """Returns an argument as int; arguments as in `number`. A float like ``1e6`` counts as whole.

    Raises:
        InputError: another type, a fraction, or a smaller value.
    """
    found = integer(value)
    if found is None or found < least:
        raise InputError(f"{name} is {shown(value)}; it must be a whole number >= {least}")
    return found


def choice(name: str, value: Any) -> bool:
    """Returns an argument as bool.

    Raises:
        InputError: the value is neither True nor False.
    """
    if not isinstance(value, bool | np.bool_):
        raise InputError(f"{name} is {shown(value)}; it must be True or False")
    return bool(value)


def falling_weights(values: Any) -> tuple[float, ...]:
    """Returns the weights of an anytime search.

    Raises:
        InputError: no sequence, no entry, an entry below 1 or above ``MOST_WEIGHT``, or weights that do not fall.
    """
    if isinstance(values, str) or not isinstance(values, Sequence | np.ndarray) or np.ndim(values) != 1:
        raise InputError(f"weights is {shown(values)}; it must be a sequence of falling numbers >= 1")
    weights = tuple(factor("weight", value) for value in values)
    if not weights:
        raise InputError("weights are empty; need one or more falling numbers >= 1")
    if any(after >= before for before, after in pairwise(weights)):
        raise InputError(f"weights are {shown(weights)}; each must be smaller than the one before it")
    return weights


def limits_of(cost: Any, expansions: Any, memory: int, time: Any) -> Limits:
    """Returns the limits of a query; ``memory`` was examined before.

    Raises:
        InputError: a limit is no number, negative, or NaN.
    """
    return Limits(
        cost=number("cost", cost, 0.0, infinite=True),
        expansions=whole("expansions", expansions),
        memory=memory,
        time=number("time", time, 0.0, infinite=True),
    )


def callback(name: str, value: Progress | None) -> Callable | None:
    """Returns an argument that is called later.

    Raises:
        InputError: neither a function nor None.
    """
    if value is not None and not callable(value):
        raise InputError(f"{name} is {shown(value)}; it must be a function, or None")
    return value


def pose_values(pose: Any, name: str, robot: Robot) -> np.ndarray:
    """Returns a pose as float64 [3] (x, y, heading in m, m, rad), or [7] with four foot offsets in m.

    Args:
        pose: the values.
        name: the pose in messages.
        robot: limits of its feet; they tell foot offsets from a quaternion.

    Raises:
        InputError: other values, a heading of more than a turn, or a position with a quaternion.
    """
    values = _numbers(pose)
    if values is None or values.shape not in ((3,), (7,)) or not np.isfinite(values).all():
        raise InputError(f"{name} {shown(pose)}: need (x, y, theta) or these and 4 foot offsets, all finite numbers")
    if len(values) == 7 and _is_quaternion(values[3:], robot):
        x, y, z, w = values[3:].tolist()
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        raise InputError(
            f"{name} {shown(values.tolist())}: a position with a quaternion (x, y, z, qx, qy, qz, qw)? need "
            f"(x, y, theta), here ({coordinates(values[:2])}, {yaw:.4f})"
        )
    if abs(values[2]) > _TURN:
        raise InputError(
            f"{name} {shown(values.tolist())}: the heading {values[2]:g} is more than a turn; degrees? need radians, "
            f"{values[2]:g} degrees are {math.radians(values[2]):.4f}"
        )
    return values


def lattice_state(grid: Grid, values: np.ndarray, name: str) -> np.ndarray:
    """Returns the nearest detailed state, int64 [7], to pose values from `pose_values`; neutral feet without offsets.

    Raises:
        InputError: the pose lies off the map; the message asks for another unit if the pose lies on the map in it.
    """
    feet = values[3:] if len(values) == 7 else np.zeros(4)
    # Integers hold lattice units only up to a limit; larger values are off the map, or out of reach, as well.
    bounded = np.clip(values[:2], -1e12, 1e12)
    try:
        return grid.to_lattice((*bounded, values[2]), np.clip(feet, -1e6, 1e6))
    except InputError as error:
        # A pose a little off the map is in metres.
        middle = np.asarray(grid.center(np.array(grid.shape) // 2))
        far = np.abs(bounded - middle).max() > 2 * metres(float(max(grid.shape)))
        units = [unit for unit, size in _UNITS.items() if far and grid.contains(grid.cell(bounded * size))]
        asked = f"; {units[0]}? need metres" if units else ""
        raise InputError(f"{name}: {error}{asked}") from None


def _numbers(values: Any) -> np.ndarray | None:
    """Float64 array of numbers; None for texts, truth values, masked entries and everything else."""
    if np.ma.is_masked(values):
        return None
    try:
        found = np.asarray(values)
        truths = any(isinstance(value, bool | np.bool_) for value in np.asarray(values, dtype=object).flat)
    except (TypeError, ValueError):
        return None
    return None if truths or found.dtype.kind not in "iuf" else found.astype(float)


def _is_quaternion(four: np.ndarray, robot: Robot) -> bool:
    """Whether four values have the norm of a rotation, and are no offsets that the robot's feet can have."""
    within = (four >= robot.feet.offset_min - 1e-9) & (four <= robot.feet.offset_max + 1e-9)
    return abs(math.hypot(*four) - 1) < _UNIT and not bool(within.all())
