"""Abstract costs of a whole map from a trained network."""

import hashlib
from collections.abc import Callable

import numpy as np

from hdsp import lattice
from hdsp.abstract.costs import Region, checked_region, close_exits
from hdsp.errors import InputError
from hdsp.heightmap import HeightMap, crop_patches
from hdsp.learning.pretrained import LearnedAbstraction

#: Patches cropped at once, 85 MB.
CHUNK = 4096


class LearnedCosts:
    """``AbstractCosts`` and ``TaskPredictor`` of a learned abstraction.

    Every abstract state's patch goes through the trunk once for its 22 actions, and equal patches (flat ground) once
    for all their states.

    Args:
        abstraction: the trained network.
        batch: patches evaluated at once.
    """

    def __init__(self, abstraction: LearnedAbstraction, batch: int = 128):
        self.abstraction, self.batch = abstraction, batch

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

        Convention: each patch is cut at the anchor of its state and turned to its heading, and the actions, which are
        in the frame of the map, are turned into the frame of the robot.
        """
        first_x, first_y, end_x, end_y = checked_region(height_map, region)
        shape = (lattice.ABSTRACT_HEADINGS, end_x - first_x, end_y - first_y)
        wanted = np.ones(shape, bool) if mask is None else np.asarray(mask, bool)
        if wanted.shape != shape:
            raise InputError(f"mask: shape {wanted.shape} is not that of the abstract states, {shape}")
        edges = np.full((*shape, lattice.N_ABSTRACT_ACTIONS), np.inf, np.float32)
        done, total = 0, int(wanted.sum())
        for heading in range(lattice.ABSTRACT_HEADINGS):
            goals = lattice.robot_frame_goals(heading)
            states = np.argwhere(wanted[heading])
            for part in np.array_split(states, range(CHUNK, len(states), CHUNK)):
                if len(part) == 0:
                    continue
                in_map = np.column_stack([part + (first_x, first_y), np.full(len(part), heading)])
                anchors = lattice.abstract_anchor(in_map)
                patches = crop_patches(height_map.heights, anchors[:, :2], anchors[:, 2])
                edges[heading, part[:, 0], part[:, 1]] = self._costs(patches, goals)
                done += len(part)
                if progress is not None:
                    progress(done, total)
        close_exits(edges, height_map, region)
        return edges

    def _costs(self, patches: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """Costs [n, 22] of patches [n, 72, 72], inf = infeasible."""
        first, which = distinct_patches(patches)
        feasible, cost = self.abstraction.predict(patches[first], goals, self.batch)
        return np.where(feasible, cost, np.float32(np.inf))[which]


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
