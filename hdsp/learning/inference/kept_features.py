"""Features of the cells of a map, kept from one evaluation to the next.

An evaluation asks for states near those of an earlier one, and a change of the map leaves most features around it as
they are. Features depend on the ground around their cell alone, so kept ones are those of a new computation, to the
last bit.
"""

from __future__ import annotations

import threading
from typing import NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.learning.rotated_maps import rotated_cells
from hdsp.robot.lattice import ABSTRACT_HEADINGS

#: Bytes of features, unless a query has less; beyond, all are dropped.
MOST_BYTES = 256 << 20
#: Kinds of features.
LOCAL, ALONG, POSE = range(3)
_FIRST_ROWS = 1 << 12


class KeptFeatures:
    """Features of the cells of a map, for all headings.

    Several threads may read and write.

    Args:
        shape: cells of the map.
        reaches: int64 [kinds, 2], distances in cells, along x and y, within which features of each kind depend on the
            ground.

    Attributes:
        most: bytes of features; an array counts together with the larger copy that replaces it.
    """

    def __init__(self, shape: tuple[int, int], reaches: np.ndarray):
        self._shape, self._reaches, self._lock, self.most = shape, reaches, threading.Lock(), MOST_BYTES
        corners = np.array([(x, y) for x in (0, shape[0] - 1) for y in (0, shape[1] - 1)])
        turned = [rotated_cells(corners, heading) for heading in range(ABSTRACT_HEADINGS)]
        # Bases lie on the map, and need features at no more than the farthest reach beyond.
        rim = 2 * int(reaches.max())
        self._first = [cells.min(axis=0) - rim for cells in turned]
        self._sizes = [cells.max(axis=0) + rim + 1 - first for cells, first in zip(turned, self._first, strict=True)]
        self._forget()

    def _forget(self) -> None:
        self._rows: list[np.ndarray | None] = [None] * len(self._reaches)
        self._used = [0] * len(self._reaches)
        self._numbers: dict[tuple[int, int], np.ndarray] = {}

    def load(
        self, kind: int, heading: int, low: np.ndarray, across: int, cells: np.ndarray, to: np.ndarray
    ) -> np.ndarray:
        """Copies kept features of cells in a window; returns the other cells, int64 [n].

        Args:
            kind: kind of features.
            heading: abstract heading of the rotated map.
            low: first cell of the window in this map.
            across: cells along y in the window.
            cells: int64 [m], in the window.
            to: features [cells of the window, channels], result.
        """
        with self._lock:
            rows = self._rows[kind]
            if rows is None or (kind, heading) not in self._numbers:
                return cells
            missing = np.empty(len(cells), np.int64)
            first = np.asarray(low) - self._first[heading]
            count = _load(self._numbers[kind, heading], first[0], first[1], across, cells, rows, to, missing)
            return missing[:count]

    def keep(
        self, kind: int, heading: int, low: np.ndarray, across: int, cells: np.ndarray, values: np.ndarray
    ) -> None:
        """Keeps features of cells in a window; arguments as for ``load``."""
        if len(cells) == 0:
            return
        with self._lock:
            room = self._room(kind, len(cells))
            if self.nbytes() + room * values.itemsize * values.shape[1] > min(self.most, MOST_BYTES):
                self._forget()
                room = self._room(kind, len(cells))
                if room * values.itemsize * values.shape[1] > self.most:
                    return
            rows, used = self._rows[kind], self._used[kind]
            if room > 0:
                grown = np.empty((room, values.shape[1]), values.dtype)
                if rows is not None:
                    grown[:used] = rows[:used]
                self._rows[kind] = rows = grown
            if (kind, heading) not in self._numbers:
                # Zeros from the operating system take memory only where they are written.
                self._numbers[kind, heading] = np.zeros(self._sizes[heading], np.int32)
            first = np.asarray(low) - self._first[heading]
            _keep(self._numbers[kind, heading], first[0], first[1], across, cells, rows, used, values)
            self._used[kind] = used + len(cells)

    def _room(self, kind: int, more: int) -> int:
        """Rows of the array with room for more features; 0 if the present one suffices."""
        rows, used = self._rows[kind], self._used[kind]
        return 0 if rows is not None and used + more <= len(rows) else max(_FIRST_ROWS, 2 * used, used + more)

    def nbytes(self) -> int:
        """Bytes of all features and of their numbers by cell."""
        rows = sum(each.nbytes for each in self._rows if each is not None)
        return rows + sum(numbers.nbytes for numbers in self._numbers.values())

    def after(self, changed: np.ndarray) -> KeptFeatures:
        """Moves the features that a change leaves as they are to a new object; none stay here.

        Args:
            changed: bool [nx, ny], cells of the map with other heights.
        """
        result = KeptFeatures(self._shape, self._reaches)
        result.most = self.most
        with self._lock:
            result._rows, result._used, result._numbers = self._rows, self._used, self._numbers
            self._forget()
        cells = np.argwhere(changed)
        if len(cells) == 0:
            return result
        (low_x, low_y), (high_x, high_y) = cells.min(axis=0).tolist(), cells.max(axis=0).tolist()
        corners = np.array([(x, y) for x in (low_x, high_x) for y in (low_y, high_y)])
        for (kind, heading), numbers in result._numbers.items():
            turned = rotated_cells(corners, heading) - self._first[heading]
            # Two cells for rounding.
            low = np.maximum(turned.min(axis=0) - self._reaches[kind] - 2, 0)
            high = turned.max(axis=0) + self._reaches[kind] + 3
            numbers[low[0] : high[0], low[1] : high[1]] = 0
        return result


class KeptPlace(NamedTuple):
    """Place of a window in a rotated map.

    Attributes:
        memory: features of the map.
        heading: abstract heading.
        low: int64 [2], first cell of the window in the rotated map.
    """

    memory: KeptFeatures
    heading: int
    low: np.ndarray

    def keep(self, across: int, cells: tuple[np.ndarray, ...], known: WindowFeatures) -> None:
        """Keeps new features, by kind."""
        for kind, (at, values) in enumerate(zip(cells, known, strict=True)):
            self.memory.keep(kind, self.heading, self.low, across, at, values)


def not_kept(marks: np.ndarray, kind: int, values: np.ndarray, across: int, place: KeptPlace | None) -> np.ndarray:
    """Loads kept features at marked cells into ``values``, and takes their marks away; returns the other cells."""
    cells = np.flatnonzero(marks)
    if place is None:
        return cells
    missing = place.memory.load(kind, place.heading, place.low, across, cells, values)
    marks[cells] = False
    marks[missing] = True
    return missing


class WindowFeatures(NamedTuple):
    """Features of a window: local features, or their codes; line features; poses; [cells, channels] each."""

    local: np.ndarray
    line: np.ndarray
    poses: np.ndarray


@njit(allocates=False, nogil=True)
def _load(numbers, first_x, first_y, across, cells, rows, to, missing):
    count = 0
    for cell in cells:
        number = numbers[first_x + cell // across, first_y + cell % across]
        if number == 0:
            missing[count] = cell
            count += 1
            continue
        source, target = rows[number - 1], to[cell]
        for c in range(len(source)):
            target[c] = source[c]
    return count


@njit(allocates=False, nogil=True)
def _keep(numbers, first_x, first_y, across, cells, rows, used, values):
    for n in range(len(cells)):
        source, target = values[cells[n]], rows[used + n]
        for c in range(len(source)):
            target[c] = source[c]
        numbers[first_x + cells[n] // across, first_y + cells[n] % across] = used + n + 1
