"""Points in LAS files, plain and compressed (LAZ).

"LAS Specification 1.4" (ASPRS) defines the format: a header with scales, offsets and the number of points, records of
variable length, then point records. Every point record begins with x, y and z as int32. Plain records are read here,
since laspy trusts all numbers of records and reads on for hours. Compressed points go through laspy and lazrs in a
process of their own (`laz_program`), which costs about a second for each file.

Points that the file calls noise, or withheld, are left out.
"""

from __future__ import annotations

import struct
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hdsp.base.separate_process import array_from_process
from hdsp.terrain.pointcloud.cloud_limits import DEFAULT_LIMITS, CloudLimits

_PROGRAM = Path(__file__).with_name("laz_program.py")
#: First number of compressed point formats.
_COMPRESSED = 128
#: First point format with the classification in a byte of its own; its class 18 is high noise, as 7 is low noise.
_WITH_FLAGS = 6
_NOISE, _HIGH_NOISE = 7, 18
#: Bytes of the separate process: for Python and libraries, and for each point and each byte of the file.
_MEMORY, _PER_POINT, _PER_BYTE = 1 << 30, 400, 4
#: CPU seconds of the separate process: for its start, and points in each further second.
_SECONDS, _POINTS_IN_A_SECOND = 5, 200_000


class _LasHeader(NamedTuple):
    points: int
    start: int
    kind: int
    length: int
    scales: np.ndarray
    offsets: np.ndarray


def read_las(content: bytes, limits: CloudLimits = DEFAULT_LIMITS) -> np.ndarray:
    """Reads points float64 [n, 3], in the file's units, from a file's contents; NaN = noise, or withheld.

    Warns:
        UserWarning: there are points called noise or withheld.

    Raises:
        ValueError: if the file is no LAS file, cut off or damaged.
        InputError: if there are more points than the limit.
        ImportError: if laspy or lazrs is missing, for compressed points.
    """
    header = _header(content)
    limits.check_points(header.points)
    points = _plain(content, header) if header.kind < _COMPRESSED else _compressed(content, header)
    if dropped := int(np.isnan(points[:, 0]).sum()):
        warnings.warn(f"{dropped:,} points called noise or withheld left out", stacklevel=2)
    return points


def _compressed(content: bytes, header: _LasHeader) -> np.ndarray:
    import laspy  # noqa: F401, a missing package is named here
    import lazrs  # noqa: F401

    memory = _MEMORY + _PER_POINT * header.points + _PER_BYTE * len(content)
    points = array_from_process(_PROGRAM, content, memory, _SECONDS + header.points // _POINTS_IN_A_SECOND)
    if points.shape != (header.points, 3):
        raise ValueError(f"damaged: {len(points)} of {header.points} points")
    return points


def _header(content: bytes) -> _LasHeader:
    if len(content) < 227 or content[:4] != b"LASF":
        raise ValueError("not a LAS file, or cut off")
    size, start, variable = struct.unpack_from("<HII", content, 94)
    if not size <= start <= len(content) or 54 * variable > start - size:
        raise ValueError(f"cut off or damaged: {variable} records of variable length, points at byte {start}")
    if content[25] >= 4 and len(content) >= 375:
        at, extended = struct.unpack_from("<QI", content, 235)
        if extended and at + 60 * extended > len(content):
            raise ValueError(f"cut off or damaged: {extended} extended records at byte {at}")
        points = struct.unpack_from("<Q", content, 247)[0]
    else:
        points = struct.unpack_from("<I", content, 107)[0]
    kind, length = struct.unpack_from("<BH", content, 104)
    numbers = np.frombuffer(content, "<f8", 6, 131)
    if not (np.isfinite(numbers).all() and (numbers[:3] != 0).all()):
        raise ValueError(f"damaged: scales and offsets are {numbers.tolist()}")
    return _LasHeader(points, start, kind, length, numbers[:3], numbers[3:])


def _plain(content: bytes, header: _LasHeader) -> np.ndarray:
    if header.length < 20 or header.start + header.points * header.length > len(content):
        raise ValueError(f"cut off: {(len(content) - header.start) // max(1, header.length)} of {header.points} points")
    # Bytes 15 and 16: class and flags in one, or flags and class.
    kinds = [("<i4", 3), "u1", "u1"]
    record = np.dtype(
        {"names": ["xyz", "flags", "class"], "formats": kinds, "offsets": [0, 15, 16], "itemsize": header.length}
    )
    records = np.frombuffer(content, record, header.points, header.start)
    if header.kind < _WITH_FLAGS:
        dropped = (records["flags"] & 0x1F == _NOISE) | (records["flags"] & 0x80 > 0)
    else:
        dropped = np.isin(records["class"], (_NOISE, _HIGH_NOISE)) | (records["flags"] & 0x04 > 0)
    points = records["xyz"] * header.scales + header.offsets
    points[dropped] = np.nan
    return points
