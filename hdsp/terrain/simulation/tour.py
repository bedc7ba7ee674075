"""A tour: a path from which a robot sees all free ground in an arena from near."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from hdsp.base.errors import InputError
from hdsp.robot import lattice
from hdsp.terrain.arenas import Arena

_COARSE = 2  # cells of the height map in a cell of the tour's grid
_DRIVABLE = 0.05  # m; higher edges take space from the robot


def tour(arena: Arena, start: tuple[float, float], clearance: float = 0.3, spacing: float = 1.2) -> np.ndarray:
    """Plans a path over free ground that comes near all of it.

    Args:
        arena: the arena.
        start: (x, y), first position, m.
        clearance: distance between the path and edges, m.
        spacing: largest distance between free ground connected to the start and the nearest visited place, m.

    Returns:
        float64 [n, 2], corners, m.

    Raises:
        InputError: if the start is not free.
    """
    free = _free_ground(arena, clearance)
    cell = lattice.metres(_COARSE)
    index = np.floor(np.asarray(start[:2], float) / cell).astype(int)
    if not ((index >= 0) & (index < len(free))).all() or not free[tuple(index)]:
        raise InputError(f"tour: start {tuple(start)} is not on free ground with {clearance} m around it")
    graph, number = _graph(free)
    first = number[tuple(index)]
    # Choice of places: the farthest cell from all chosen places is added until every cell is near a place.
    places, nearest = [first], dijkstra(graph, indices=first)
    reachable = np.isfinite(nearest)
    while np.max(nearest, where=reachable, initial=0) > spacing / cell:
        places.append(int(np.argmax(np.where(reachable, nearest, -1))))
        nearest = np.minimum(nearest, dijkstra(graph, indices=places[-1]))
    # Order: the nearest unvisited place comes next.
    way, rest, here = [first], set(places[1:]), first
    while rest:
        distance, before = dijkstra(graph, indices=here, return_predecessors=True)
        there = min(rest, key=lambda place: (distance[place], place))
        leg = [there]
        while leg[-1] != here:
            leg.append(int(before[leg[-1]]))
        way += leg[-2::-1]
        rest -= set(leg)
        here = there
    return (np.argwhere(free)[way] + 0.5) * cell


def _free_ground(arena: Arena, clearance: float) -> np.ndarray:
    """Coarse cells over which the sensor may be carried, bool [n, n]: low ground, away from edges."""
    heights = arena.height_map().heights
    edges = ndimage.maximum_filter(heights, 3) - ndimage.minimum_filter(heights, 3) > _DRIVABLE
    room = lattice.metres(ndimage.distance_transform_edt(~edges))
    free = (room >= clearance) & (heights <= _DRIVABLE)
    n = len(free) // _COARSE
    return free[: n * _COARSE, : n * _COARSE].reshape(n, _COARSE, n, _COARSE).all(axis=(1, 3))


def _graph(free: np.ndarray) -> tuple[csr_array, np.ndarray]:
    """Steps between neighbouring free cells, with lengths in cells; and each free cell's number, -1 elsewhere."""
    number = np.full(free.shape, -1)
    number[free] = np.arange(free.sum())
    ends, lengths = [], []
    for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1)):
        here = number[: len(free) - dx, max(-dy, 0) : free.shape[1] - max(dy, 0)]
        there = number[dx:, max(dy, 0) : free.shape[1] + min(dy, 0)]
        both = (here >= 0) & (there >= 0)
        ends.append(np.stack([here[both], there[both]]))
        lengths.append(np.full(both.sum(), np.hypot(dx, dy)))
    pairs, length = np.concatenate(ends, axis=1), np.concatenate(lengths)
    n = int(free.sum())
    one_way = csr_array((length, (pairs[0], pairs[1])), shape=(n, n))
    return one_way + one_way.T, number
