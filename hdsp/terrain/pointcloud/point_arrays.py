"""Clouds as users give them, as arrays in metres."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.messages import shown
from hdsp.terrain.no_data import unmasked


def point_array(points: Any, name: str = "points") -> np.ndarray:
    """Returns a cloud as float64 [n, 3], with NaN for masked coordinates.

    Args:
        points: numbers [n, 3]: an array, a list, a table.
        name: the cloud in messages.

    Raises:
        InputError: texts, rows with different lengths, or another shape.
    """
    need = "need [n, 3]: x, y, z in metres"
    if isinstance(points, str | os.PathLike):
        raise InputError(f"{name} are {shown(points)}; {need} (read_points and HeightMap.load read files)")
    try:
        found = np.asarray(unmasked(points))
        values = found.astype(float) if found.dtype.kind in "iufO" else None
    except (TypeError, ValueError, OverflowError):
        values = None
    if values is None:
        raise InputError(f"{name} are {shown(points)}; {need}")
    if values.ndim != 2 or values.shape[1] != 3:
        raise InputError(f"{name} have shape {values.shape}; {need}")
    return values


def finite_points(points: Any, name: str = "points") -> np.ndarray:
    """Returns a cloud as float64 [n, 3] with at least one point; arguments as in `point_array`.

    Raises:
        InputError: as in `point_array`, or a coordinate is not finite, or there is no point.
    """
    values = point_array(points, name)
    if len(values) == 0:
        raise InputError(f"{name}: there is no point")
    if wrong := int((~np.isfinite(values)).any(axis=1).sum()):
        raise InputError(f"{name}: {wrong:,} of {len(values):,} are not finite")
    return values
