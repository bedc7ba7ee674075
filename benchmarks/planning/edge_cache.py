"""Abstract edges of whole maps on disk: learned edges take a minute for 10 x 10 m.

The folder is ``hdsp/benchmarks/edges`` in the user's cache. A file belongs to one map and one abstraction, as it is
coded and trained: the same commit or another one may read it.
"""

from __future__ import annotations

import hashlib
import inspect
from copy import copy
from dataclasses import asdict, is_dataclass
from pathlib import Path

import numpy as np
import pooch

from hdsp.abstract.abstract_costs import AbstractCosts, Region, close_exits
from hdsp.base.files import replacing
from hdsp.base.provenance import code_fingerprint
from hdsp.planning.heuristics import AbstractHeuristic
from hdsp.planning.planner import Planner
from hdsp.terrain.height_map import HeightMap

#: Costs that are computed faster than a file is read.
_FAST = "ManualCosts", "FlatCosts"


def cache_folder() -> Path:
    """Folder for results that benchmarks may keep, in the user's cache."""
    return Path(pooch.os_cache("hdsp")) / "benchmarks"


def keep_edges(planner: Planner) -> Planner:
    """Lets a planner take the edges of its abstraction from disk, where they are slow to compute; returns it."""
    heuristic = planner.heuristic
    if isinstance(heuristic, AbstractHeuristic) and type(heuristic.costs).__name__ not in _FAST:
        costs = heuristic.costs
        factors = getattr(costs, "factors", None)
        if factors is not None:  # the network's own costs serve all commits, with factors and before them
            costs = copy(costs)
            costs.factors = None
        heuristic.costs = KeptCosts(costs, cache_folder() / "edges", factors)
    return planner


class KeptCosts:
    """``AbstractCosts`` whose edges of whole maps are kept in a folder.

    States outside an earlier mask are computed when a later mask asks for them. ``factors``, float32 [16, 22] by
    heading and action, multiply the kept costs.
    """

    def __init__(self, costs: AbstractCosts, folder: Path, factors: np.ndarray | None = None):
        self.costs, self.folder, self.factors = costs, folder, factors
        self.key = costs_key(costs)

    @property
    def least(self) -> np.ndarray | None:
        """See ``BoundedCosts``."""
        return getattr(self.costs, "least", None)

    def edges(self, height_map: HeightMap, region: Region | None = None, mask: np.ndarray | None = None) -> np.ndarray:
        """See ``AbstractCosts.edges``."""
        if region is not None or mask is None:
            return self._multiplied(self.costs.edges(height_map, region, mask))
        heights = np.ascontiguousarray(height_map.heights, np.float32)
        name = hashlib.sha256(f"{self.key} {heights.shape}".encode() + heights.tobytes()).hexdigest()[:32]
        path = self.folder / f"{name}.npz"
        known, costs = np.zeros_like(mask), np.empty((0, 22), np.float32)
        if path.is_file():
            with np.load(path, allow_pickle=False) as file:
                known, costs = file["known"], file["costs"]
        edges = np.full((*mask.shape, costs.shape[-1]), np.inf, np.float32)
        edges[known] = costs
        missing = mask & ~known
        if missing.any():
            edges[missing] = self.costs.edges(height_map, mask=missing)[missing]
            known = known | missing
            with replacing(path) as temporary:
                np.savez_compressed(temporary, known=known, costs=edges[known])
        edges[~mask] = np.inf
        close_exits(edges, height_map)
        return self._multiplied(edges)

    def _multiplied(self, edges: np.ndarray) -> np.ndarray:
        return edges if self.factors is None else edges * self.factors[:, None, None]


def costs_key(costs: AbstractCosts) -> str:
    """Hash of the code and of all settings and weights of an abstraction."""
    digest = hashlib.sha256(_code(costs).encode())
    for name, value in sorted(vars(costs).items()):
        if name in ("factors", "least"):  # neither changes a cost of the network
            continue
        digest.update(name.encode())
        digest.update(_content(value))
    return digest.hexdigest()


def _code(costs: AbstractCosts) -> str:
    """Hash of the code that computes edges."""
    cls = type(costs)
    if cls.__name__ != "LearnedCosts":
        return code_fingerprint(cls.__module__)
    # Not the whole class: factors, kinds of costs and progress change no cost of the network. An earlier commit may be
    # without a method.
    parts = (getattr(cls, name, None) for name in ("_by_windows", "_by_tiles", "_by_patches", "_costs"))
    own = (inspect.getsource(part) for part in parts if part is not None)
    return "".join(own) + code_fingerprint("hdsp.learning.abstraction", "hdsp.learning.rotated_maps")


def _content(value) -> bytes:
    if hasattr(value, "calibration"):  # a learned abstraction
        network = value.network
        weights = b"".join(tensor.cpu().numpy().tobytes() for tensor in network.state_dict().values())
        settings = f"{value.model} {value.calibration} {value.quantile} {code_fingerprint(type(network).__module__)}"
        settings += f" {value.threshold}" if hasattr(value, "threshold") else ""
        return hashlib.sha256(settings.encode() + weights).digest()
    if hasattr(value, "edges"):  # an abstraction around another one
        return costs_key(value).encode()
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if is_dataclass(value) and not isinstance(value, type):
        return str(asdict(value)).encode()
    return str(value).encode() if isinstance(value, int | float | str | tuple | None) else b""
