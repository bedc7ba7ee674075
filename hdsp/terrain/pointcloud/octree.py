"""Occupied cells in OctoMap's binary octrees (.bt) as points.

Sources for the format: Hornung et al. 2013, and the documentation of octomap::OccupancyOcTreeBase. A file begins with
text lines, from ``# Octomap OcTree binary file`` to ``data``; among them are ``id``, ``size`` (number of nodes) and
``res`` (smallest cell size in metres). The nodes follow, parents before children, first child first. A node with
children takes two bytes: two bits for each of eight children, lowest bits first, with 0 unknown, 1 free, 2 occupied, 3
has children. Child number ``x + 2 y + 4 z`` is the upper half along each axis with digit 1. The tree has 16 levels
around the origin.
"""

from __future__ import annotations

import numpy as np

from hdsp.terrain.pointcloud.cloud_limits import DEFAULT_LIMITS, CloudLimits

_LEVELS = 16
_OCCUPIED, _INNER = 2, 3


def read_octree(content: bytes, limits: CloudLimits = DEFAULT_LIMITS) -> np.ndarray:
    """Reads the centres of the smallest occupied cells, [n, 3], in metres.

    A larger occupied cell contributes the smallest cells on its surface.

    Raises:
        ValueError: if the file has another format or is cut off.
        InputError: if it has more nodes or cells than the limits.
    """
    header, resolution = _header(content)
    limits.check_rows((len(content) - header) // 2, "nodes")
    nodes = np.frombuffer(content, np.uint8, offset=header)
    lows, sizes = _occupied(nodes.tobytes())
    if not len(lows):
        return np.zeros((0, 3))
    limits.check_rows(
        sum(_surface_size(int(size)) * int(count) for size, count in _numbers_of(sizes)), "occupied cells"
    )
    cells = np.concatenate([_cells(lows[sizes == size], int(size)) for size in np.unique(sizes)])
    return (cells - 2 ** (_LEVELS - 1) + 0.5) * resolution


def _header(content: bytes) -> tuple[int, float]:
    """Reads the offset of the first node, and the resolution."""
    if not content.startswith(b"# Octomap OcTree binary file"):
        raise ValueError("not a binary octree: the first line is not '# Octomap OcTree binary file'")
    end = content.find(b"\ndata\n")
    if end < 0:
        raise ValueError("no line 'data'")
    entries = dict(line.split(maxsplit=1) for line in content[:end].splitlines() if len(line.split(maxsplit=1)) == 2)
    if (resolution := float(entries.get(b"res", b"nan"))) > 0:
        return end + len(b"\ndata\n"), resolution
    raise ValueError("no positive resolution in a line 'res'")


def _occupied(nodes: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Lower corners int64 [n, 3] and sizes int64 [n] of occupied leaves, both in smallest cells."""
    leaves: list[tuple[int, int, int, int]] = []
    at = 0
    stack = [(0, 0, 0, 2**_LEVELS)] if nodes else []
    while stack:
        x, y, z, size = stack.pop()
        if at + 2 > len(nodes) or size == 1:
            raise ValueError("cut off or damaged: the nodes end too early or go too deep")
        bits, half, inner = nodes[at] | nodes[at + 1] << 8, size // 2, []
        at += 2
        for child in range(8):
            kind = bits >> 2 * child & 3
            place = (x + half * (child & 1), y + half * (child >> 1 & 1), z + half * (child >> 2), half)
            if kind == _OCCUPIED:
                leaves.append(place)
            elif kind == _INNER:
                inner.append(place)
        stack += reversed(inner)  # the first child is read first
    array = np.array(leaves, dtype=np.int64).reshape(-1, 4)
    return array[:, :3], array[:, 3]


def _numbers_of(sizes: np.ndarray) -> zip:
    return zip(*np.unique(sizes, return_counts=True), strict=True)


def _surface_size(size: int) -> int:
    """Number of smallest cells on the surface of a cube with a side of ``size`` cells."""
    if size > 64:
        raise ValueError(f"an occupied cell of {size} smallest cells; a map of that is no scan")
    return size**3 - max(0, size - 2) ** 3


def _cells(lows: np.ndarray, size: int) -> np.ndarray:
    """Smallest cells on the surfaces of cubes, int64 [n, 3], from their lower corners [m, 3]."""
    return (lows[:, None] + _surface(size)).reshape(-1, 3)


def _surface(size: int) -> np.ndarray:
    """Smallest cells on the surface of a cube with a side of ``size`` cells, int64 [n, 3]."""
    cells = np.stack(np.meshgrid(*[np.arange(size)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return cells[((cells == 0) | (cells == size - 1)).any(axis=1)]
