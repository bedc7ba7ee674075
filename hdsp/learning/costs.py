"""Abstract costs of a whole map from a trained network."""

import hashlib
from collections.abc import Callable, Iterator

import numpy as np

from hdsp import lattice
from hdsp.errors import InputError
from hdsp.heightmap import HeightMap, crop_patches
from hdsp.learning.pretrained import LearnedAbstraction

#: Patches cropped at once, 85 MB.
CHUNK = 4096


class LearnedCosts:
    """``AbstractCosts`` of a learned abstraction: every abstract state's patch through the trunk, once for its 22
    actions.

    Args:
        abstraction: the trained network.
        batch: patches evaluated at once.
    """

    def __init__(self, abstraction: LearnedAbstraction, batch: int = 128):
        self.abstraction, self.batch = abstraction, batch

    def edges(
        self,
        height_map: HeightMap,
        region: tuple[int, int, int, int] | None = None,
        mask: np.ndarray | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> np.ndarray:
        """Costs of all abstract actions.

        Args:
            height_map: the terrain.
            region: abstract cells [a0, a1) x [b0, b1) as (a0, a1, b0, b1) to which the evaluation is limited; all other
                states keep ``inf``.
            mask: bool [16, nx, ny]; states worth evaluating, for instance those whose feet find ground. The others get
                ``inf``.
            progress: called with (states done, states in all) after every chunk.

        Returns:
            float32 [16, nx, ny, 22] with nx, ny = map cells // 4: cost of action m from state (a, b, k) at
            [k, a, b, m]; ``inf`` where the network judges it infeasible or its goal lies outside the map.

        Raises:
            InputError: if region or mask do not fit the map.

        Convention: axis 0 is the abstract heading k, axes 1 and 2 are x and y; actions in the order of
        ``lattice.ABSTRACT_ACTIONS``, in the frame of the map. Each patch is cut at the anchor of its state, turned to
        its heading, and the actions are turned into the robot frame for the network.
        """
        nx, ny = lattice.abstract_shape(height_map.shape)
        wanted = _wanted_states((lattice.ABSTRACT_HEADINGS, nx, ny), region, mask)
        edges = np.full((*wanted.shape, lattice.N_ABSTRACT_ACTIONS), np.inf, np.float32)
        done, total = 0, int(wanted.sum())
        for heading in range(lattice.ABSTRACT_HEADINGS):
            goals = lattice.robot_frame_goals(heading)
            for cells in _chunks(np.argwhere(wanted[heading])):
                states = np.column_stack([cells, np.full(len(cells), heading)])
                anchors = lattice.abstract_anchor(states)
                patches = crop_patches(height_map.heights, anchors[:, :2], anchors[0, 2])
                edges[heading, cells[:, 0], cells[:, 1]] = self._costs(patches, goals)
                done += len(cells)
                if progress is not None:
                    progress(done, total)
        edges[:, ~_goal_inside((nx, ny))] = np.inf
        return edges

    def _costs(self, patches: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """Costs [n, 22] of patches [n, 72, 72], inf = infeasible; equal patches (flat ground) are evaluated once."""
        first, which = _distinct(patches)
        feasible, cost = self.abstraction.predict(patches[first], goals, self.batch)
        return np.where(feasible, cost, np.float32(np.inf))[which]


def _wanted_states(shape: tuple[int, int, int], region, mask) -> np.ndarray:
    wanted = np.ones(shape, bool)
    if mask is not None:
        wanted = np.array(mask, bool)
        if wanted.shape != shape:
            raise InputError(f"mask: shape {wanted.shape} is not that of the abstract states, {shape}")
    if region is not None:
        a0, a1, b0, b1 = region
        if not (0 <= a0 < a1 <= shape[1] and 0 <= b0 < b1 <= shape[2]):
            raise InputError(
                f"region: {tuple(region)} is not (a0, a1, b0, b1) within {shape[1]} x {shape[2]} abstract cells"
            )
        inside = np.zeros(shape, bool)
        inside[:, a0:a1, b0:b1] = True
        wanted &= inside
    return wanted


def _goal_inside(shape: tuple[int, int]) -> np.ndarray:
    """bool [nx, ny, 22]: whether the goal of each action lies inside the map."""
    cells = np.stack(np.indices(shape), axis=-1)[:, :, None, :] + lattice.ABSTRACT_ACTIONS[:, :2]
    return ((cells >= 0) & (cells < np.asarray(shape))).all(axis=-1)


def _distinct(patches: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the first of each kind of patch, and for each patch the number of its kind."""
    kinds: dict[bytes, int] = {}
    first: list[int] = []
    which = np.empty(len(patches), np.int64)
    for index, patch in enumerate(patches):
        digest = hashlib.blake2b(patch, digest_size=16).digest()
        kind = kinds.setdefault(digest, len(first))
        if kind == len(first):
            first.append(index)
        which[index] = kind
    return np.array(first, np.int64), which


def _chunks(cells: np.ndarray) -> Iterator[np.ndarray]:
    for start in range(0, len(cells), CHUNK):
        yield cells[start : start + CHUNK]
