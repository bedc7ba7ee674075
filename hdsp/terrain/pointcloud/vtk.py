"""Points in legacy VTK files.

"VTK File Formats" (Kitware) defines the format: two title lines, a line ASCII or BINARY, and sections. The section
``POINTS n type`` contains n times x y z; binary numbers are big-endian. This module exists because libraries for all of
VTK need 150 MB, and small libraries do not read point clouds (POLYDATA).
"""

from __future__ import annotations

import re

import numpy as np

from hdsp.terrain.pointcloud.cloud_limits import DEFAULT_LIMITS, CloudLimits

_TYPES = {"float": ">f4", "double": ">f8"}
_POINTS = re.compile(rb"^POINTS\s+(\d+)\s+(\w+)[ \t]*\r?\n", re.MULTILINE)


def read_vtk(content: bytes, limits: CloudLimits = DEFAULT_LIMITS) -> np.ndarray:
    """Reads points [n, 3] from a file's contents.

    Raises:
        ValueError: if the file is no legacy VTK file, has no points, is cut off, or has numbers in another type.
        InputError: if there are more points than the limit.
    """
    lines = content[:1024].splitlines()
    if len(lines) < 3 or not lines[0].startswith(b"# vtk DataFile"):
        raise ValueError("not a legacy VTK file: the first line is not '# vtk DataFile Version ...'")
    encoding = lines[2].strip().upper()
    found = _POINTS.search(content)
    if encoding not in (b"ASCII", b"BINARY") or found is None:
        raise ValueError("no line ASCII or BINARY, or no section POINTS")
    count, kind = int(found[1]), found[2].decode().lower()
    limits.check_points(count)
    if encoding == b"ASCII":
        limits.check_rows(count)
    if kind not in _TYPES:
        raise ValueError(f"points of type {kind}; need {' or '.join(_TYPES)}")
    rest, numbers = content[found.end() :], 3 * count
    if encoding == b"BINARY":
        dtype = np.dtype(_TYPES[kind])
        if len(rest) < numbers * dtype.itemsize:
            raise ValueError(f"cut off: {len(rest)} bytes of {numbers * dtype.itemsize} for {count} points")
        return np.frombuffer(rest, dtype, numbers).reshape(count, 3)
    words = rest.split(maxsplit=numbers)[:numbers]
    if len(words) < numbers:
        raise ValueError(f"cut off: {len(words)} numbers of {numbers} for {count} points")
    return np.array(words, dtype=float).reshape(count, 3)
