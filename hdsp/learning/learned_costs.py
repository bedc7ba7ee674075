"""Abstract costs of a whole map from a trained network."""

import hashlib
from collections.abc import Callable, Iterator
from typing import Literal

import numpy as np

from hdsp.abstract.abstract_costs import Region, checked_mask, checked_region, close_exits
from hdsp.base.errors import InputError
from hdsp.learning.abstraction import LearnedAbstraction
from hdsp.learning.rotated_maps import TurnedMap
from hdsp.robot import lattice
from hdsp.terrain.height_map import HeightMap, crop_patches

#: Patches cropped at once, 85 MB.
CHUNK = 4096
#: Side in cells of the tiles of dense evaluation. Larger ones share more between patches; smaller ones let a change of
#: the map touch less. A tile takes some tens of megabytes, whatever the size of the map.
TILE = 96


class LearnedCosts:
    """``AbstractCosts``, ``LocalCosts`` and ``TaskPredictor`` of a learned abstraction.

    There are two ways to the costs of a map. *Patches*: every abstract state's patch goes through the trunk once for
    its 22 actions, and equal patches (flat ground) once for all their states. *Dense*: the trunk is evaluated once for
    each cell of 16 turned maps, in tiles. A tile holds the same cells and the same states whatever is asked for, so
    that a region of a map gets to the last bit the costs it has in the whole.

    Convention: the patches of a network that declares itself dense are windows of the turned map (``hdsp.learning
    .turned``), in both ways. Those of all others are cut at the anchor of their state.

    Args:
        abstraction: the trained network.
        batch: patches evaluated at once.
        method: ``auto``: dense where the network declares itself so. ``patches``, ``dense``: that way; dense evaluation
            of a network with zero padding is an approximation, which sees the map where the patch saw zeros.
        quantile: level of the costs, see ``LearnedAbstraction.at_quantile``: a low one makes the heuristic overestimate
            seldom, so that plans are better and searches longer. None = costs as the network says.

    Raises:
        InputError: if the method is dense and the network cannot be evaluated so, or if the abstraction was not
            calibrated for the quantile.
    """

    def __init__(
        self,
        abstraction: LearnedAbstraction,
        batch: int = 128,
        method: Literal["auto", "patches", "dense"] = "auto",
        quantile: float | None = None,
    ):
        self.abstraction = abstraction if quantile is None else abstraction.at_quantile(quantile)
        self.batch = batch
        network = abstraction.network
        self._on_turned_map = network.is_dense()
        self._trunk = network.dense_trunk() if method == "dense" or (method == "auto" and network.is_dense()) else None
        if method == "dense" and (self._trunk is None or not (network.is_dense() or network.encoding.is_local())):
            raise InputError(
                f"method dense: {abstraction.model.architecture} needs a trunk of convolutions without stride, and "
                "heights as they are (encoding.reference none, encoding.channels [height])"
            )
        if method not in ("auto", "patches", "dense"):
            raise InputError(f"method {method!r}: allowed are auto, patches, dense")

    def predict(self, patches: np.ndarray, goals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See ``TaskPredictor.predict``."""
        return self.abstraction.predict(patches, goals, self.batch)

    def edges(
        self,
        height_map: HeightMap,
        region: Region | None = None,
        mask: np.ndarray | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> np.ndarray:
        """See ``AbstractCosts.edges``; here also:

        Args:
            height_map: the terrain.
            region: as there.
            mask: bool, shape of the result without actions: states worth evaluating, for instance those whose feet find
                ground. All others become infeasible.
            progress: called with (states done, states in all) after every few thousand states.

        Raises:
            InputError: also if the mask does not have the shape of the result.

        Convention: each patch is turned to the heading of its state, and the actions, which are in the frame of the
        map, are turned into the frame of the robot.
        """
        first_x, first_y, end_x, end_y = checked_region(height_map, region)
        shape = (lattice.ABSTRACT_HEADINGS, end_x - first_x, end_y - first_y)
        wanted = np.ones(shape, bool) if mask is None else checked_mask(mask, shape)
        edges = np.full((*shape, lattice.N_ABSTRACT_ACTIONS), np.inf, np.float32)
        done, total = 0, int(wanted.sum())
        evaluate = self._by_patches if self._trunk is None else self._by_tiles
        for heading in range(lattice.ABSTRACT_HEADINGS):
            if not wanted[heading].any():
                continue
            for states, costs in evaluate(height_map, heading, wanted[heading], (first_x, first_y)):
                edges[heading, states[:, 0], states[:, 1]] = costs
                done += len(states)
                if progress is not None:
                    progress(done, total)
        close_exits(edges, height_map, region)
        return edges

    def affected(self, changed: np.ndarray) -> np.ndarray:
        """See ``LocalCosts.affected``."""
        nx, ny = lattice.abstract_shape(changed.shape)
        result = np.zeros((lattice.ABSTRACT_HEADINGS, nx, ny), bool)
        cells = np.argwhere(changed)
        if len(cells) == 0:
            return result
        margin = 0 if self._trunk is None else self._trunk.margin
        # No cell of a patch is further than this from its base, along x or along y.
        reach = int(np.ceil((lattice.PATCH_CENTER + margin) * np.sqrt(2))) + 2
        bases = _anchors(np.argwhere(np.ones((nx, ny), bool)), 0)
        near = bases[((bases >= cells.min(axis=0) - reach) & (bases <= cells.max(axis=0) + reach)).all(axis=1)]
        size = lattice.CELLS_PER_ABSTRACT
        marks = changed.astype(np.float32)
        for heading in range(lattice.ABSTRACT_HEADINGS):
            if self._trunk is None and not self._on_turned_map:
                seen = crop_patches(marks, near, heading * lattice.HEADINGS_PER_ABSTRACT)
                touched = (seen > 0).any(axis=(1, 2))
            else:
                touched = _touched(TurnedMap(marks, heading), near, margin)
            result[heading, near[touched, 0] // size, near[touched, 1] // size] = True
        return result

    def _by_patches(
        self, height_map: HeightMap, heading: int, wanted: np.ndarray, first: tuple[int, int]
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """States [n, 2] of a region and their costs [n, 22], some at a time."""
        goals = lattice.robot_frame_goals(heading)
        turned = TurnedMap(height_map.heights, heading) if self._on_turned_map else None
        states = np.argwhere(wanted)
        for part in np.array_split(states, range(CHUNK, len(states), CHUNK)):
            bases = _anchors(part + first, heading)
            if turned is None:
                detailed = heading * lattice.HEADINGS_PER_ABSTRACT
                patches = crop_patches(height_map.heights, bases, detailed)
            else:
                patches = turned.patches(bases)
            yield part, self._costs(patches, goals)

    def _by_tiles(
        self, height_map: HeightMap, heading: int, wanted: np.ndarray, first: tuple[int, int]
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """As ``_by_patches``."""
        goals = lattice.robot_frame_goals(heading)
        turned = TurnedMap(height_map.heights, heading)
        whole = np.zeros(lattice.abstract_shape(height_map.shape), bool)
        whole[first[0] : first[0] + wanted.shape[0], first[1] : first[1] + wanted.shape[1]] = wanted
        states = np.argwhere(np.ones_like(whole))
        cells = turned.cells(_anchors(states, heading))
        margin = self._trunk.margin
        side = TILE - 1 + lattice.PATCH_CELLS + 2 * margin
        for tile, members in _grouped(cells // TILE):
            asked = whole[states[members, 0], states[members, 1]]
            if not asked.any():
                continue
            window = turned.window(tile * TILE - lattice.PATCH_CENTER - margin, (side, side))
            corners = cells[members] - tile * TILE
            feasible, cost = self.abstraction.predict_windows(self._trunk, window, corners, asked, goals)
            costs = np.where(feasible, cost, np.float32(np.inf))
            yield states[members[asked]] - first, costs[asked]

    def _costs(self, patches: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """Costs [n, 22] of patches [n, 72, 72], inf = infeasible."""
        first, which = distinct_patches(patches)
        feasible, cost = self.abstraction.predict(patches[first], goals, self.batch)
        return np.where(feasible, cost, np.float32(np.inf))[which]


def _anchors(states: np.ndarray, heading: int) -> np.ndarray:
    """Detailed cells, int64 [n, 2], of the bases of abstract cells [n, 2]."""
    return lattice.abstract_anchor(np.column_stack([states, np.full(len(states), heading)]))[:, :2]


def _grouped(keys: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Each distinct row of keys [n, 2] with the numbers of the rows that equal it."""
    low = keys.min(axis=0)
    single = (keys[:, 0] - low[0]) * (keys[:, 1].max() - low[1] + 1) + keys[:, 1] - low[1]
    order = np.argsort(single, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(single[order])) + 1):
        yield keys[members[0]], members


def _touched(marks: TurnedMap, bases: np.ndarray, margin: int) -> np.ndarray:
    """Whether a cell marked above zero lies in each base's patch, or within a margin around it; bool [n]."""
    sums = np.zeros(np.add(marks.heights.shape, 1), np.int64)
    sums[1:, 1:] = (marks.heights > 0).cumsum(axis=0).cumsum(axis=1)
    first = marks.cells(bases) - lattice.PATCH_CENTER - margin - marks.first
    x, y = np.clip(first, 0, marks.heights.shape).T
    end_x, end_y = np.clip(first + lattice.PATCH_CELLS + 2 * margin, 0, marks.heights.shape).T
    return sums[end_x, end_y] - sums[x, end_y] - sums[end_x, y] + sums[x, y] > 0


def distinct_patches(patches: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices, int64, of the first patch of each kind, and for each patch the number of its kind, so that
    ``patches[first][which]`` equals ``patches`` to the byte."""
    kinds: dict[bytes, int] = {}
    first: list[int] = []
    which = np.empty(len(patches), np.int64)
    for index, patch in enumerate(np.ascontiguousarray(patches)):
        # A digest and not the bytes: twenty kilobytes for each state of a map would be kept alive.
        kind = kinds.setdefault(hashlib.blake2b(patch, digest_size=16).digest(), len(first))
        if kind == len(first):
            first.append(index)
        which[index] = kind
    return np.array(first, np.int64), which
