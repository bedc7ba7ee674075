"""Abstract edges of whole maps on disk: learned edges take a minute for 10 x 10 m.

The folder is ``hdsp/benchmarks/edges`` in the user's cache. A file belongs to one map and one abstraction, as it is
coded and trained: the same commit or another one may read it.
"""

from __future__ import annotations

import hashlib
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
        heuristic.costs = KeptCosts(heuristic.costs, cache_folder() / "edges")
    return planner


class KeptCosts:
    """``AbstractCosts`` whose edges of whole maps are kept in a folder.

    States outside an earlier mask are computed when a later mask asks for them.
    """

    def __init__(self, costs: AbstractCosts, folder: Path):
        self.costs, self.folder = costs, folder
        self.key = costs_key(costs)

    def edges(self, height_map: HeightMap, region: Region | None = None, mask: np.ndarray | None = None) -> np.ndarray:
        """See ``AbstractCosts.edges``."""
        if region is not None or mask is None:
            return self.costs.edges(height_map, region, mask)
        heights = np.ascontiguousarray(height_map.heights, np.float32)
        name = hashlib.sha256(f"{self.key} {heights.shape}".encode() + heights.tobytes()).hexdigest()[:32]
        path = self.folder / f"{name}.npz"
        known, costs = np.zeros_like(mask), np.empty((0, 22), np.float32)
        if path.is_file():
            with np.load(path) as file:
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
        return edges


def costs_key(costs: AbstractCosts) -> str:
    """Hash of the code and of all settings and weights of an abstraction."""
    digest = hashlib.sha256(code_fingerprint(type(costs).__module__).encode())
    for name, value in sorted(vars(costs).items()):
        digest.update(name.encode())
        digest.update(_content(value))
    return digest.hexdigest()


def _content(value) -> bytes:
    if hasattr(value, "calibration"):  # a learned abstraction
        network = value.network
        weights = b"".join(tensor.cpu().numpy().tobytes() for tensor in network.state_dict().values())
        settings = f"{value.model} {value.calibration} {value.quantile} {code_fingerprint(type(network).__module__)}"
        return hashlib.sha256(settings.encode() + weights).digest()
    if hasattr(value, "edges"):  # an abstraction around another one
        return costs_key(value).encode()
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if is_dataclass(value) and not isinstance(value, type):
        return str(asdict(value)).encode()
    return str(value).encode() if isinstance(value, int | float | str | tuple | None) else b""
