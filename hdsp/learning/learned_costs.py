"""Abstract costs for whole maps from a trained network."""

import hashlib
from collections.abc import Callable, Iterator
from functools import partial
from typing import Literal

import numpy as np

from hdsp.abstract.abstract_costs import Region, checked_mask, checked_region, close_exits
from hdsp.abstract.flat_table import flat_table, planning_factors
from hdsp.abstract.oracle import CostKind, checked_kind
from hdsp.base.errors import InputError
from hdsp.base.gradual import Steps, finished
from hdsp.learning.abstraction import LearnedAbstraction
from hdsp.learning.inference.footprint_engine import MARGIN, KeptPlace
from hdsp.learning.inference.kept_features import KeptFeatures
from hdsp.learning.rotated_maps import RotatedMap, rotated_cells, rotated_window
from hdsp.learning.saved_abstraction import Provenance
from hdsp.robot import lattice
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.patches import crop_patches

#: Least cost of an edge, relative to flat ground. 0.1 % of the edges on the paper's arena are below 0.993.
LEAST = 0.99
#: Patches cropped at once; 10 MB, evaluated in less than a second.
CHUNK = 512
#: Bytes of the networks' work on one window.
_WORKING = 160 << 20
#: Side in cells of the squares whose states the engine evaluates together. Larger ones share more features.
WINDOW = 192
#: Side in cells of a tile in dense evaluation. Larger tiles share more between patches; a map change affects less with
#: smaller ones. A tile takes some tens of megabytes, independent of the map size.
TILE = 96


class LearnedCosts:
    """``BoundedCosts``, ``LocalCosts`` and ``TaskPredictor`` from a learned abstraction.

    Two methods compute a map's costs. *Patches*: each abstract state's patch passes the trunk once for its 22 actions,
    and equal patches (flat ground) once for all their states. *Dense*: the trunk runs once for each cell in 16 rotated
    maps. With torch, it runs tile by tile, and a tile always holds the same cells and states; without
    (``hdsp.learning.inference``), it runs at the cells alone that some wanted state needs. A region's costs equal the
    whole map's costs to the last bit in both cases.

    Convention: with both methods, patches for a network that declares itself dense are windows into the rotated map
    (``hdsp.learning.rotated_maps``). Patches for all other networks are cut at their state's anchor.

    Args:
        abstraction: trained network.
        batch: patches evaluated at once.
        method: ``auto``: dense if the network declares itself dense, otherwise patches. ``patches``, ``dense``: always
            this method. For a network with zero padding, dense evaluation is an approximation: it sees the map where a
            patch has zeros.
        robot: robot of the network, for ``kind`` planning; None = the preset for which it was trained, if it still has
            the same parameters. Without a robot, edges keep label costs.
        kind: kind of costs of the edges. For planning, a network that predicts costs for planning gives them; the label
            costs of any other network are multiplied by the ratio of both costs on flat ground
            (``hdsp.abstract.flat_table.planning_factors``). Predictions of single tasks are label costs in any case.
        threshold: probability from which edges count an action as feasible; None = the abstraction's
            ``edges_threshold``. Predictions of single tasks keep its ``threshold``.
        quantile: cost level, see ``LearnedAbstraction.at_quantile``. A low level makes overestimates rare, for better
            plans and longer searches. None = predicted costs.

    Raises:
        InputError: the method or kind is unknown, the network does not allow dense evaluation, the abstraction was not
            calibrated for the quantile, or the threshold is not between 0 and 1.
    """

    def __init__(
        self,
        abstraction: LearnedAbstraction,
        batch: int = 128,
        method: Literal["auto", "patches", "dense"] = "auto",
        quantile: float | None = None,
        robot: Robot | str | None = None,
        kind: CostKind | str = CostKind.PLANNING,
        threshold: float | None = None,
    ):
        self.abstraction = abstraction if quantile is None else abstraction.at_quantile(quantile)
        self._of_edges = self.abstraction.at_threshold(abstraction.edges_threshold if threshold is None else threshold)
        self.batch = batch
        #: Float32 [16, 22], factors on predicted costs by heading and action; None = costs as predicted.
        self.factors = None
        kind, known = checked_kind(kind), _trained_for(abstraction.provenance) if robot is None else Robot.load(robot)
        if kind == CostKind.PLANNING and abstraction.predicts_planning_cost:
            self._of_edges = self._of_edges.for_planning()
        elif kind == CostKind.PLANNING:
            self.factors = None if known is None else planning_factors(known)
        #: See ``BoundedCosts``.
        self.least = None if known is None else np.float32(LEAST) * flat_table(known, None, kind)
        self._on_rotated_map = abstraction.is_dense()
        dense = method == "dense" or (method == "auto" and self._on_rotated_map)
        self._by_engine = dense and abstraction.engine is not None
        self._trunk = abstraction.network.dense_trunk() if dense and not self._by_engine else None
        exact = self._on_rotated_map or abstraction.model.encoding.is_local()
        if method == "dense" and not self._by_engine and (self._trunk is None or not exact):
            raise InputError(
                f"method dense: {abstraction.model.architecture} needs a trunk of convolutions without stride, and "
                "heights as they are (encoding.reference none, encoding.channels [height])"
            )
        if method not in ("auto", "patches", "dense"):
            raise InputError(f"method {method!r}: allowed are auto, patches, dense")

    def __repr__(self) -> str:
        return f"LearnedCosts({self.abstraction!r})"

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
            height_map: terrain.
            region: as in ``AbstractCosts.edges``.
            mask: bool, result shape without actions: states to evaluate, for instance states with ground under all
                feet. All other states become infeasible.
            progress: called with (states done, all states) every few dozen to few hundred states.

        Raises:
            InputError: also if the mask has another shape than the result.

        Convention: each patch is rotated to its state's heading; actions are rotated from the map frame into the robot
        frame.
        """
        return finished(self.edge_steps(height_map, region, mask, progress))

    def edge_steps(
        self,
        height_map: HeightMap,
        region: Region | None = None,
        mask: np.ndarray | None = None,
        progress: Callable[[int, int], None] | None = None,
        memory: KeptFeatures | None = None,
    ) -> Steps[np.ndarray]:
        """See ``GradualCosts.edge_steps`` and ``RememberingCosts``.

        A step evaluates the trunk on one tile, or some patches.
        """
        first_x, first_y, end_x, end_y = checked_region(height_map, region)
        shape = (lattice.ABSTRACT_HEADINGS, end_x - first_x, end_y - first_y)
        wanted = np.ones(shape, bool) if mask is None else checked_mask(mask, shape)
        edges = np.full((*shape, lattice.N_ABSTRACT_ACTIONS), np.inf, np.float32)
        done, total = 0, int(wanted.sum())
        evaluate = self._by_patches if self._trunk is None else self._by_tiles
        if self._by_engine:
            evaluate = partial(self._by_windows, memory=memory)
        for heading in range(lattice.ABSTRACT_HEADINGS):
            if not wanted[heading].any():
                continue
            for evaluated in evaluate(height_map, heading, wanted[heading], (first_x, first_y)):
                if evaluated is not None:
                    states, costs = evaluated
                    if self.factors is not None:
                        costs = costs * self.factors[heading]
                    edges[heading, states[:, 0], states[:, 1]] = costs
                    done += len(states)
                    if progress is not None:
                        progress(done, total)
                yield
        close_exits(edges, height_map, region)
        return edges

    @property
    def working_memory(self) -> int:
        """Bytes for the evaluation of a window or of some patches, at most."""
        return _WORKING

    def new_memory(self, height_map: HeightMap) -> KeptFeatures | None:
        """See ``RememberingCosts.new_memory``."""
        engine = self._of_edges.engine
        return engine.new_memory(height_map.shape) if self._by_engine and engine is not None else None

    def affected(self, changed: np.ndarray) -> np.ndarray:
        """See ``LocalCosts.affected``."""
        nx, ny = lattice.abstract_shape(changed.shape)
        result = np.zeros((lattice.ABSTRACT_HEADINGS, nx, ny), bool)
        cells = np.argwhere(changed)
        if len(cells) == 0:
            return result
        behind, ahead = self._reach()
        # Largest distance between a cell that is read and the base, along x or along y.
        reach = int(np.ceil(np.hypot(*np.maximum(behind, ahead)))) + 2
        bases = _anchors(np.argwhere(np.ones((nx, ny), bool)), 0)
        near = bases[((bases >= cells.min(axis=0) - reach) & (bases <= cells.max(axis=0) + reach)).all(axis=1)]
        size = lattice.CELLS_PER_ABSTRACT
        marks = changed.astype(np.float32)
        for heading in range(lattice.ABSTRACT_HEADINGS):
            if self._trunk is None and not self._on_rotated_map:
                seen = crop_patches(marks, near, heading * lattice.HEADINGS_PER_ABSTRACT)
                touched = (seen > 0).any(axis=(1, 2))
            else:
                touched = _touched(marks, cells, heading, near, behind, ahead)
            result[heading, near[touched, 0] // size, near[touched, 1] // size] = True
        return result

    def _reach(self) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of cells behind a base and ahead of it on which its costs depend, int64 [2] along x and y.

        Cells are those of the rotated map.
        """
        if self._by_engine and self._of_edges.engine is not None:
            return self._of_edges.engine.reach, self._of_edges.engine.reach
        margin = 0 if self._trunk is None else self._trunk.margin
        behind = np.full(2, lattice.PATCH_CENTER + margin)
        return behind, lattice.PATCH_CELLS - 1 + 2 * margin - behind

    def _by_patches(
        self, height_map: HeightMap, heading: int, wanted: np.ndarray, first: tuple[int, int]
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yields states [n, 2] in a region and their costs [n, 22], some at a time."""
        goals = lattice.robot_frame_goals(heading)
        rotated = RotatedMap(height_map.heights, heading) if self._on_rotated_map else None
        states = np.argwhere(wanted)
        for part in np.array_split(states, range(CHUNK, len(states), CHUNK)):
            bases = _anchors(part + first, heading)
            if rotated is None:
                detailed = heading * lattice.HEADINGS_PER_ABSTRACT
                patches = crop_patches(height_map.heights, bases, detailed)
            else:
                patches = rotated.patches(bases)
            yield part, self._costs(patches, goals)

    def _by_windows(
        self,
        height_map: HeightMap,
        heading: int,
        wanted: np.ndarray,
        first: tuple[int, int],
        memory: KeptFeatures | None,
    ) -> Iterator[tuple[np.ndarray, np.ndarray] | None]:
        """Like ``_by_patches``, with the engine in windows around the wanted states; None between its steps."""
        goals = lattice.robot_frame_goals(heading)
        heights = np.ascontiguousarray(height_map.heights, np.float32)
        states = np.argwhere(wanted)
        cells = rotated_cells(_anchors(states + first, heading), heading)
        # Counted from the first cell, so that states around a small change share one window.
        for _, members in _grouped((cells - cells.min(axis=0)) // WINDOW):
            low = cells[members].min(axis=0) - MARGIN
            end = cells[members].max(axis=0) + MARGIN + 1
            window = rotated_window(heights, heading, low, tuple(end - low))
            place = None if memory is None else KeptPlace(memory, heading, low)
            for group in self._of_edges.predict_bases(window, cells[members] - low, goals, place):
                if group is None:
                    yield None
                    continue
                part, feasible, cost = group
                yield states[members[part]], np.where(feasible, cost, np.float32(np.inf))

    def _by_tiles(
        self, height_map: HeightMap, heading: int, wanted: np.ndarray, first: tuple[int, int]
    ) -> Iterator[tuple[np.ndarray, np.ndarray] | None]:
        """Like ``_by_patches``, with dense evaluation; None between steps without costs."""
        goals = lattice.robot_frame_goals(heading)
        rotated = RotatedMap(height_map.heights, heading)
        whole = np.zeros(lattice.abstract_shape(height_map.shape), bool)
        whole[first[0] : first[0] + wanted.shape[0], first[1] : first[1] + wanted.shape[1]] = wanted
        states = np.argwhere(np.ones_like(whole))
        cells = rotated.cells(_anchors(states, heading))
        trunk = self._trunk
        assert trunk is not None
        margin = trunk.margin
        side = TILE - 1 + lattice.PATCH_CELLS + 2 * margin
        for tile, members in _grouped(cells // TILE):
            asked = whole[states[members, 0], states[members, 1]]
            if not asked.any():
                continue
            window = rotated.window(tile * TILE - lattice.PATCH_CENTER - margin, (side, side))
            corners = cells[members] - tile * TILE
            for group in self._of_edges.predict_windows(trunk, window, corners, asked, goals):
                if group is None:
                    yield None
                    continue
                part, feasible, cost = group
                costs = np.where(feasible, cost, np.float32(np.inf))
                yield states[members[part][asked[part]]] - first, costs[asked[part]]

    def _costs(self, patches: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """Costs [n, 22] for patches [n, 72, 72], inf = infeasible."""
        first, which = distinct_patches(patches)
        feasible, cost = self._of_edges.predict(patches[first], goals, self.batch)
        return np.where(feasible, cost, np.float32(np.inf))[which]


def _trained_for(provenance: Provenance) -> Robot | None:
    """The preset for which a network was trained, None if there is none with the same parameters."""
    try:
        robot = Robot.load(provenance.robot)
    except InputError:
        return None
    return robot if robot.hash() == provenance.robot_hash else None


def _anchors(states: np.ndarray, heading: int) -> np.ndarray:
    """Detailed base cells, int64 [n, 2], for abstract cells [n, 2]."""
    return lattice.abstract_anchor(np.column_stack([states, np.full(len(states), heading)]))[:, :2]


def _grouped(keys: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yields each distinct row in keys [n, 2], with the indices of all rows equal to it."""
    low = keys.min(axis=0)
    single = (keys[:, 0] - low[0]) * (keys[:, 1].max() - low[1] + 1) + keys[:, 1] - low[1]
    order = np.argsort(single, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(single[order])) + 1):
        yield keys[members[0]], members


def _touched(
    marks: np.ndarray, cells: np.ndarray, heading: int, bases: np.ndarray, behind: np.ndarray, ahead: np.ndarray
) -> np.ndarray:
    """Returns whether the rectangle around each base in the rotated map contains a marked cell, bool [n].

    Args:
        marks: float32 [nx, ny], cells above zero are marked.
        cells: int64 [m, 2], marked cells.
        heading: abstract heading of the rectangles.
        bases: int64 [n, 2], map cells.
        behind, ahead: int64 [2], cells of the rectangle on both sides of the base, along x and y.
    """
    (low_x, low_y), (high_x, high_y) = cells.min(axis=0).tolist(), cells.max(axis=0).tolist()
    corners = rotated_cells(np.array([(x, y) for x in (low_x, high_x) for y in (low_y, high_y)]), heading)
    low = corners.min(axis=0) - 1
    around = rotated_window(marks, heading, low, tuple(corners.max(axis=0) + 2 - low))
    sums = np.zeros(np.add(around.shape, 1), np.int64)
    sums[1:, 1:] = (around > 0).cumsum(axis=0).cumsum(axis=1)
    at = rotated_cells(bases, heading) - low
    x, y = np.clip(at - behind, 0, around.shape).T
    end_x, end_y = np.clip(at + ahead + 1, 0, around.shape).T
    return sums[end_x, end_y] - sums[x, end_y] - sums[end_x, y] + sums[x, y] > 0


def distinct_patches(patches: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Groups equal patches.

    Returns:
        first: int64 [kinds], index of each kind's first patch.
        which: int64 [n], each patch's kind; ``patches[first][which]`` equals ``patches`` to the byte.
    """
    kinds: dict[bytes, int] = {}
    first: list[int] = []
    which = np.empty(len(patches), np.int64)
    for index, patch in enumerate(np.ascontiguousarray(patches)):
        # Digests as keys, because the bytes would keep twenty kilobytes alive for each map state.
        kind = kinds.setdefault(hashlib.blake2b(patch, digest_size=16).digest(), len(first))
        if kind == len(first):
            first.append(index)
        which[index] = kind
    return np.array(first, np.int64), which
