"""Vertices in PLY files: ascii, binary little-endian and binary big-endian.

Turk's "The PLY Polygon File Format" (1994) defines the format: a text header with elements and their properties, then
the elements in this order. Only the element ``vertex`` is read, and all elements before it are skipped; faces, texture
coordinates and other lists after it do not matter. This module exists because mesh libraries split and merge vertices
for their faces, and read all faces of a mesh first.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hdsp.terrain.pointcloud.cloud_limits import DEFAULT_LIMITS, CloudLimits

_HEADER_BYTES = 1 << 20
_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4"},
    **{"double": "f8", "float64": "f8", "int64": "i8", "uint64": "u8", "float16": "f2"},
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


class _Property(NamedTuple):
    """A property: its name, the NumPy type of its values, and for a list the type of the number of values."""

    name: str
    kind: str
    length: str = ""


class _Element(NamedTuple):
    name: str
    number: int
    properties: list[_Property]

    @property
    def has_lists(self) -> bool:
        return any(part.length for part in self.properties)


def read_ply(content: bytes, limits: CloudLimits = DEFAULT_LIMITS) -> np.ndarray:
    """Reads the vertices float64 [n, 3], in the file's units, in their order, from a file's contents.

    Raises:
        ValueError: if the header is damaged, no element ``vertex`` has x, y and z, or vertices are missing.
        InputError: if there are more vertices, or more rows with lists before them, than the limits.
    """
    order, elements, at = _header(content)
    position = [element.name for element in elements].index("vertex") if elements else -1
    before, vertex = elements[:position], elements[position]
    names = [part.name.lower() for part in vertex.properties]
    columns = [[k for k, name in enumerate(names) if name == axis] for axis in "xyz"]
    if any(len(column) != 1 or vertex.properties[column[0]].length for column in columns):
        raise ValueError(f"a vertex has the properties {', '.join(names) or 'none'}; need x, y and z once each")
    axes = [column[0] for column in columns]
    if vertex.number == 0:
        return np.zeros((0, 3))
    limits.check_points(vertex.number)
    limits.check_rows(_slow_rows(order, before, vertex), "rows")
    if order == "":
        return _ascii(content[at:], sum(element.number for element in before if element.properties), vertex, axes)
    for element in before:
        at = _after(content, at, element, order)
    if vertex.has_lists:
        return _rows(content, at, vertex, order, axes)
    record = _record(vertex, order)
    if len(content) - at < vertex.number * record.itemsize:
        raise ValueError(f"cut off: {max(0, len(content) - at) // record.itemsize} of {vertex.number} vertices")
    records = np.frombuffer(content, record, vertex.number, at)
    return np.stack([records[str(axis)].astype(float) for axis in axes], axis=1)


def _header(content: bytes) -> tuple[str, list[_Element], int]:
    """Byte order ("" = ascii), elements, and offset of the data in bytes."""
    head = content[:_HEADER_BYTES]
    if not head.lstrip(b"\xef\xbb\xbf").startswith(b"ply"):
        raise ValueError("not a PLY file: the first line is not 'ply'")
    order, elements, at = None, [], 0
    while True:
        ends = [end for end in (head.find(b"\n", at), head.find(b"\r", at)) if end >= 0]
        if not ends:
            raise ValueError("cut off: no line end_header")
        end = min(ends)
        words = head[at:end].decode("utf-8", "replace").split()
        at = end + (2 if head[end : end + 2] == b"\r\n" else 1)
        match words:
            case ["end_header"]:
                break
            case ["format", name, *_]:
                order = _ORDERS.get(name)
            case ["element", name, count] if count.isdecimal() and len(count) < 13:
                elements.append(_Element(name, int(count), []))
            case ["property", "list", length, kind, name] if elements and {length, kind} <= _TYPES.keys():
                elements[-1].properties.append(_Property(name, _TYPES[kind], _TYPES[length]))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append(_Property(name, _TYPES[kind]))
            case ["ply" | "comment" | "obj_info" | "\ufeffply", *_] | []:
                pass
            case _:
                raise ValueError(f"header line {' '.join(words)[:60]!r} is not understood")
    if order is None:
        raise ValueError(f"no line format with one of {', '.join(_ORDERS)}")
    if "vertex" not in [element.name for element in elements]:
        raise ValueError("no element vertex")
    return order, elements, at


def _slow_rows(order: str, before: list[_Element], vertex: _Element) -> int:
    """Number of rows that are read one by one."""
    if order == "":
        return vertex.number
    return sum(element.number for element in (*before, vertex) if element.has_lists)


def _record(element: _Element, order: str) -> np.dtype:
    return np.dtype([(str(k), order + part.kind) for k, part in enumerate(element.properties)])


def _ascii(body: bytes, skipped: int, vertex: _Element, axes: list[int]) -> np.ndarray:
    lines = [line for line in body.decode("ascii").splitlines() if line.strip()][skipped : skipped + vertex.number]
    if len(lines) < vertex.number:
        raise ValueError(f"cut off: {len(lines)} of {vertex.number} vertices")
    width = len(vertex.properties)
    if not vertex.has_lists:
        for number, line in enumerate(lines, 1):
            if len(line.split()) != width:
                raise ValueError(f"vertex {number} has {len(line.split())} numbers; need {width}")
        return np.loadtxt(lines, usecols=axes, comments=None, ndmin=2)
    points = np.empty((vertex.number, 3))
    for point, line in zip(points, lines, strict=True):
        words, starts, at = line.split(), [], 0
        for part in vertex.properties:
            starts.append(at)
            at += 1 + (int(words[at]) if part.length else 0)
        point[:] = [float(words[starts[axis]]) for axis in axes]
    return points


def _after(content: bytes, at: int, element: _Element, order: str) -> int:
    """Offset in bytes after a binary element."""
    if not element.has_lists:
        return at + element.number * (_record(element, order).itemsize if element.properties else 0)
    for _ in range(element.number):
        at = _starts(content, at, element, order)[-1]
    return at


def _rows(content: bytes, at: int, vertex: _Element, order: str, axes: list[int]) -> np.ndarray:
    points = []
    for _ in range(vertex.number):
        starts = _starts(content, at, vertex, order)
        kinds = [order + vertex.properties[axis].kind for axis in axes]
        points.append([_value(content, starts[axis], kind) for axis, kind in zip(axes, kinds, strict=True)])
        at = starts[-1]
    return np.array(points, dtype=float)


def _starts(content: bytes, at: int, element: _Element, order: str) -> list[int]:
    """Offsets in bytes of the properties in one row with lists, and of the next row."""
    starts = [at]
    for part in element.properties:
        size = np.dtype(part.kind).itemsize
        if part.length:
            number = int(_value(content, at, order + part.length))
            at += np.dtype(part.length).itemsize + max(number, 0) * size
        else:
            at += size
        starts.append(at)
    if at > len(content):
        raise ValueError(f"cut off in the element {element.name}")
    return starts


def _value(content: bytes, at: int, kind: str) -> float:
    return float(np.frombuffer(content, kind, 1, at)[0])
