"""Point cloud files: PCD, PLY, OBJ, LAS, LAZ, legacy VTK, OctoMap (.bt) and text, plain or packed by gzip or bzip2."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.files import as_path, existing_file
from hdsp.base.messages import shown
from hdsp.base.scalars import real
from hdsp.terrain.pointcloud.cloud_limits import DEFAULT_LIMITS, CloudLimits
from hdsp.terrain.pointcloud.las import read_las
from hdsp.terrain.pointcloud.las_units import metres_in_las
from hdsp.terrain.pointcloud.octree import read_octree
from hdsp.terrain.pointcloud.pcd import read_pcd
from hdsp.terrain.pointcloud.ply import read_ply
from hdsp.terrain.pointcloud.text import decoded_text, read_text, text_points
from hdsp.terrain.pointcloud.vtk import read_vtk

_PACKED = (".gz", ".bz2")

#: Axes by name, as (index, sign).
_AXES = {f"{sign}{name}": (k, -1.0 if sign == "-" else 1.0) for k, name in enumerate("xyz") for sign in ("", "+", "-")}


def read_points(
    path: str | os.PathLike,
    units: float | None = None,
    axes: Sequence[str] = ("x", "y", "z"),
    *,
    max_points: int | None = None,
    max_bytes: int | None = None,
) -> np.ndarray:
    """Reads the points in a file and drops points that are not finite (no echo).

    Args:
        path: the file; its suffix selects the format (`FORMATS`), and .gz or .bz2 may follow.
        units: metres per unit in the file, e.g. 0.001 for millimetres. None: LAS and LAZ by their CRS, texts by
            their header, others metres.
        axes: the file's axes for our x (forward), y (left) and z (up), e.g. ("z", "-x", "-y") for a camera.
        max_points: largest number of points; None = 50 million in binary formats, 10 million lines in texts.
        max_bytes: largest contents, unpacked; None = 1 GiB.

    Returns:
        float64 [n, 3], metres.

    Raises:
        InputError: if the file is missing, damaged or too large, has another format or no finite point, or units or
            axes are invalid.
    """
    limits, turn = CloudLimits.of(max_points, max_bytes), _turn(axes)
    units = None if units is None else _positive(units)
    suffixes = [suffix.lower() for suffix in as_path(path, "points").suffixes[-2:]]
    packed = bool(suffixes) and suffixes[-1] in _PACKED
    suffix = (suffixes[-2] if len(suffixes) > 1 else "") if packed else (suffixes[-1] if suffixes else "")
    if suffix not in FORMATS:
        raise InputError(
            f"point cloud {path}: suffix {suffix!r}; need one of {', '.join(FORMATS)}, or these + .gz, .bz2"
        )
    path = existing_file(path, "point cloud")
    own: Any = 1.0
    try:
        content = limits.read(path, suffix in _TEXTS)
        if not content:
            raise InputError("the file is empty")
        if FORMATS[suffix] is read_text:
            points, own = text_points(content, limits)
        else:
            points = np.asarray(FORMATS[suffix](content, limits), dtype=float)
            if FORMATS[suffix] is read_las and units is None:
                own = metres_in_las(content)
    except ImportError as error:
        raise InputError(
            f"point cloud {path}: {error}; install the extra 'scans': pip install 'hdsp[scans]'"
        ) from error
    except InputError as error:
        raise InputError(f"point cloud {path}: {error}") from None
    except MemoryError:
        raise InputError(f"point cloud {path}: it needs more memory than there is") from None
    except Exception as error:  # file libraries raise errors of many types for damaged files
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"point cloud {path} cannot be read: {reason}") from error
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"point cloud {path}: points have shape {points.shape}; need [n, 3]")
    finite = points[np.isfinite(points).all(axis=1)]
    if len(finite) == 0:
        raise InputError(f"point cloud {path}: none of its {len(points)} points is finite")
    indices, signs = turn
    return (finite * (own if units is None else units))[:, indices] * signs


def _read_obj(content: bytes, limits: CloudLimits = DEFAULT_LIMITS) -> np.ndarray:
    """Reads the vertices of a Wavefront file, lines ``v x y z``, in their order; faces and textures do not matter."""
    text = re.sub(r"\\[ \t]*(\r\n|\n|\r)", " ", decoded_text(content))  # a backslash joins two lines
    words = (line.split() for line in text.splitlines())
    lines = [line[1:4] for line in words if line[:1] == ["v"]]
    limits.check_rows(len(lines))
    if any(len(words) < 3 for words in lines):
        raise ValueError("a vertex has fewer than three numbers")
    return np.array(lines, dtype=float).reshape(-1, 3)


#: Reader for each suffix: file contents, limits of size -> points [n, 3] in the file's units.
FORMATS: dict[str, Callable[[bytes, CloudLimits], np.ndarray]] = {
    ".pcd": read_pcd,
    ".ply": read_ply,
    ".obj": _read_obj,
    ".las": read_las,
    ".laz": read_las,
    ".vtk": read_vtk,
    ".bt": read_octree,
    ".xyz": read_text,
    ".asc": read_text,
    ".txt": read_text,
    ".csv": read_text,
    ".dat": read_text,
}
_TEXTS = {suffix for suffix, reader in FORMATS.items() if reader in (read_text, _read_obj)}


def _turn(axes: Sequence[str]) -> tuple[list[int], list[float]]:
    """A file's axes, as their numbers and signs."""
    if not isinstance(axes, Sequence):
        raise InputError(f"axes are {shown(axes)}; need each of x, y, z once, perhaps with a minus sign")
    picked = [_AXES.get(str(name).lower()) for name in axes]
    indices = [axis[0] for axis in picked if axis]
    signs = [axis[1] for axis in picked if axis]
    if sorted(indices) != [0, 1, 2]:
        raise InputError(f"axes are {list(axes)}; need each of x, y, z once, perhaps with a minus sign")
    order = np.zeros((3, 3))
    order[range(3), indices] = signs
    if np.linalg.det(order) < 0:
        raise InputError(f"axes are {list(axes)}: they mirror the scan; need a right-handed choice, e.g. z, -x, -y")
    return indices, signs


def _positive(units: Any) -> float:
    if not 0 < real(units) < math.inf:
        raise InputError(f"units is {shown(units)}; need a positive number of metres per unit of the file")
    return real(units)
