"""Points in PCD files (Point Cloud Library), versions .5 to .7.

"The PCD (Point Cloud Data) file format" (PCL documentation) defines the format: header lines FIELDS, SIZE, TYPE, COUNT,
WIDTH, HEIGHT, POINTS and DATA, then ascii numbers, little-endian records, or LZF-compressed records sorted by field.
Padding fields are named ``_``; Ouster's files give them COUNT 0. ASCII numbers are read as float64 whatever their SIZE,
because writers print coordinates of a survey in full and still call them 4 bytes long. This module exists because
pypcd4 refuses such padding, names in capitals, and rounds ASCII coordinates to float32.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np

from hdsp.terrain.pointcloud.cloud_limits import DEFAULT_LIMITS, CloudLimits

_HEADER_BYTES = 65536  # far more than any header
_MOST_FIELDS = 1000
_KINDS = {"F": (2, 4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}
_LARGEST_GAIN = 300  # LZF stores at most 264 bytes in 3


class _Header(NamedTuple):
    """Description of the records: names, NumPy types and counts of the fields, encoding, offset of the data (bytes)."""

    names: list[str]
    types: list[str]
    counts: list[int]
    points: int
    encoding: str
    data: int

    @property
    def record(self) -> np.dtype:
        """Type of one point; fields are named by their number, because padding fields share a name."""
        parts = [(str(k), kind, (count,)) for k, (kind, count) in enumerate(zip(self.types, self.counts, strict=True))]
        return np.dtype([part for part in parts if part[2] != (0,)])

    def axes(self) -> list[int]:
        """Numbers of the fields x, y and z."""
        names = [name.lower() for name in self.names]
        found = [[k for k, name in enumerate(names) if name == axis and self.counts[k] == 1] for axis in "xyz"]
        if any(len(places) != 1 for places in found):
            raise ValueError(f"fields are {' '.join(self.names)}; need x, y and z once each, with COUNT 1")
        return [places[0] for places in found]


def read_pcd(content: bytes, limits: CloudLimits = DEFAULT_LIMITS) -> np.ndarray:
    """Reads points float64 [n, 3], in the file's units, from a file's contents.

    Raises:
        ValueError: if the header is no PCD header, x, y or z is missing, or the number of points is another one.
        InputError: if there are more points than the limit.
    """
    header = _header(content)
    limits.check_points(header.points)
    axes, body = header.axes(), content[header.data :]
    if header.encoding == "ascii":
        limits.check_rows(header.points)
        return _ascii(header, axes, body)
    if header.encoding == "binary_compressed":
        return _compressed(header, axes, body)
    record = header.record
    if len(body) < header.points * record.itemsize:
        raise ValueError(f"cut off: {len(body) // record.itemsize} of {header.points} points")
    if record.itemsize and len(body) // record.itemsize > header.points:
        raise ValueError(f"data of {len(body) // record.itemsize} points; the header says {header.points}")
    records = np.frombuffer(body, record, header.points)
    return np.stack([records[str(axis)][:, 0].astype(float) for axis in axes], axis=1)


def _header(content: bytes) -> _Header:
    entries: dict[str, list[str]] = {}
    at = 3 if content.startswith(b"\xef\xbb\xbf") else 0
    while "DATA" not in entries:
        end = content.find(b"\n", at, _HEADER_BYTES)
        if end < 0:
            raise ValueError("not a PCD file, or cut off: no line DATA")
        words = content[at:end].decode("utf-8", "replace").split("#")[0].split()
        if words:
            entries[words[0].upper()] = words[1:]
        at = end + 1
    names = entries.get("FIELDS") or entries.get("COLUMNS") or []
    width = len(names)
    if not 0 < width <= _MOST_FIELDS:
        raise ValueError("no line FIELDS with names")
    sizes, counts = _numbers(entries, "SIZE", width), _numbers(entries, "COUNT", width)
    kinds = [kind.upper() for kind in entries.get("TYPE", ["F"] * width)]
    if len(kinds) != width or any(size not in _KINDS.get(kind, ()) for kind, size in zip(kinds, sizes, strict=True)):
        raise ValueError(f"TYPE {' '.join(kinds)} with SIZE {sizes} for {width} fields; need F 2 4 8, or I, U 1 2 4 8")
    sides = [_numbers(entries, side, 1)[0] for side in ("WIDTH", "HEIGHT")] if "WIDTH" in entries else []
    points = _numbers(entries, "POINTS", 1)[0] if "POINTS" in entries or not sides else sides[0] * sides[1]
    if sides and points != sides[0] * sides[1]:
        raise ValueError(f"POINTS {points}, but WIDTH {sides[0]} and HEIGHT {sides[1]}")
    encoding = " ".join(entries["DATA"]).lower()
    if encoding not in ("ascii", "binary", "binary_compressed"):
        raise ValueError(f"DATA {encoding}; need ascii, binary or binary_compressed")
    types = [f"<{kind.lower()}{size}" for kind, size in zip(kinds, sizes, strict=True)]
    return _Header(names, types, counts, points, encoding, at)


def _numbers(entries: dict[str, list[str]], key: str, width: int) -> list[int]:
    words = entries.get(key, {"SIZE": ["4"] * width, "COUNT": ["1"] * width, "HEIGHT": ["1"]}.get(key, []))
    if len(words) != width or not all(word.isdecimal() and len(word) < 13 for word in words):
        raise ValueError(f"{key} {' '.join(words)[:80]}; need {width} whole number{'s' * (width > 1)}")
    return [int(word) for word in words]


def _ascii(header: _Header, axes: list[int], body: bytes) -> np.ndarray:
    lines = [line for line in body.decode("ascii").splitlines() if line.strip()]
    if len(lines) != header.points:
        kind = "cut off: " if len(lines) < header.points else ""
        raise ValueError(f"{kind}{len(lines)} lines for {header.points} points")
    if not lines:
        return np.zeros((0, 3))
    starts = np.cumsum([0, *header.counts])
    columns = [int(starts[axis]) for axis in axes]
    for number, line in enumerate(lines, 1):
        if len(line.split()) != starts[-1]:
            raise ValueError(f"point {number} has {len(line.split())} numbers; need {starts[-1]}")
    return np.loadtxt(lines, usecols=columns, comments=None, ndmin=2)


def _compressed(header: _Header, axes: list[int], body: bytes) -> np.ndarray:
    import lzf

    if len(body) < 8:
        raise ValueError("cut off: no compressed points")
    packed, size = struct.unpack_from("<II", body)
    record = header.record
    if size != header.points * record.itemsize or len(body) < 8 + packed or size > _LARGEST_GAIN * (packed + 1):
        raise ValueError(
            f"cut off or damaged: {size} bytes in {packed}, {len(body) - 8} here, for {header.points} points"
        )
    if size == 0:
        return np.zeros((0, 3))
    data = lzf.decompress(body[8 : 8 + packed], size)
    if data is None or len(data) != size:
        raise ValueError("damaged: the compressed points have another length")
    columns = []
    for axis in axes:  # all values of the first field come first
        before = sum(np.dtype(header.types[k]).itemsize * header.counts[k] for k in range(axis))
        columns.append(np.frombuffer(data, header.types[axis], header.points, before * header.points).astype(float))
    return np.stack(columns, axis=1)
