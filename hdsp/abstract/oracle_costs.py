"""Perfect abstraction: the detailed planner itself finds the costs of all abstract actions on a map.

The oracle shows how far a heuristic gets with exact edges. A state takes some ten milliseconds, a map of 5 x 5 m some
minutes, so it serves small maps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from hdsp.abstract.abstract_costs import Region, checked_mask, checked_region, close_exits
from hdsp.abstract.flat_table import base_reach, cost_limit
from hdsp.abstract.oracle import CostKind, LabelSettings, Shared, checked_kind, task_costs
from hdsp.abstract.transform import feet_at_all
from hdsp.base.gradual import Steps, finished
from hdsp.base.workers import ClusterSettings, connected
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.relaxed.foothold_regions import FootholdRegions, find_foothold_regions
from hdsp.detailed.relaxed.poses import new_poses
from hdsp.detailed.search.estimate import least_foot_cost
from hdsp.detailed.world.part import Part, part_of_map, part_of_world
from hdsp.detailed.world.world import World, build_world
from hdsp.detailed.world.world_update import influence
from hdsp.robot.lattice import (
    ABSTRACT_HEADINGS,
    CELLS_PER_ABSTRACT,
    HEADINGS,
    N_ABSTRACT_ACTIONS,
    abstract_anchor,
    abstract_shape,
    cells,
)
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap

#: Callback with (evaluated states, all states), called after each part of the map.
Progress = Callable[[int, int], object]

_TILE = 4  # abstract cells along each side of a part


class _Terrain(NamedTuple):
    """A map for all its states: the compiled world and its foothold regions under no rules."""

    world: World
    regions: FootholdRegions


class _Oracle(NamedTuple):
    """Settings of all searches; ``reach`` is the largest distance, in cells, between a start and the base."""

    robot: Robot
    kind: CostKind
    settings: LabelSettings
    cost_limit: float
    reach: int


class OracleCosts:
    """Costs of the detailed planner. Implements `LocalCosts` and `GradualCosts`."""

    def __init__(
        self,
        robot: Robot | str,
        kind: CostKind | str = CostKind.PLANNING,
        settings: LabelSettings | None = None,
        cluster: ClusterSettings | None = None,
        progress: Progress | None = None,
    ):
        """Sets up the oracle.

        Args:
            robot: a robot, or what `Robot.load` takes.
            kind: planning costs, or costs under the rules of labels. A label stands on a patch, which has a border; on
                a map the robot may leave the patch.
            settings: labelling rules.
            cluster: processes for the work; None = this process.
            progress: callback.

        Raises:
            InputError: the kind is unknown.
        """
        self.robot, self.kind = Robot.load(robot), checked_kind(kind)
        self.settings = settings or LabelSettings()
        self.cluster, self.progress = cluster or ClusterSettings(workers=1), progress
        #: Most expensive action that counts as feasible.
        self.cost_limit = cost_limit(self.robot, self.settings)
        self._base_reach = base_reach(self.robot, self.cost_limit)

    def __repr__(self) -> str:
        return f"OracleCosts({self.robot.name})"

    def edges(self, height_map: HeightMap, region: Region | None = None, mask: np.ndarray | None = None) -> np.ndarray:
        """See `AbstractCosts.edges`."""
        return finished(self.edge_steps(height_map, region, mask))

    def edge_steps(
        self, height_map: HeightMap, region: Region | None = None, mask: np.ndarray | None = None
    ) -> Steps[np.ndarray]:
        """See `GradualCosts.edge_steps`."""
        first_x, first_y, end_x, end_y = checked_region(height_map, region)
        shape = ABSTRACT_HEADINGS, end_x - first_x, end_y - first_y
        wanted = np.ones(shape, bool) if mask is None else checked_mask(mask, shape)
        edges = np.full((*shape, N_ABSTRACT_ACTIONS), np.inf, np.float32)
        world = build_world(height_map, self.robot)
        yield
        terrain = _Terrain(world, find_foothold_regions(world, Rules(), least_foot_cost(world)))
        yield
        states = np.argwhere(wanted) + (0, first_x, first_y)
        done = 0
        for tile, costs in self._evaluated(terrain, _tiles(states)):
            k, a, b = tile.T
            edges[k, a - first_x, b - first_y] = costs
            done += len(tile)
            if self.progress is not None:
                self.progress(done, len(states))
            yield
        close_exits(edges, height_map, region)
        return edges

    def affected(self, changed: np.ndarray) -> np.ndarray:
        """See `LocalCosts.affected`: a square around the changed cells, for all headings."""
        from scipy.ndimage import maximum_filter  # half a second to import

        # Heights have an influence on the cells that feet and body of a robot on its way can see.
        reach = self._base_reach + math.ceil(cells(self.robot.reach())) + influence(self.robot)
        near = maximum_filter(np.asarray(changed, bool), 2 * reach + 1, mode="constant", cval=False)
        nx, ny = abstract_shape(near.shape)
        a, b = np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij")
        anchors = abstract_anchor(np.stack([a, b, np.zeros_like(a)], axis=-1))
        return np.repeat(near[anchors[..., 0], anchors[..., 1]][None], ABSTRACT_HEADINGS, axis=0)

    def _evaluated(self, terrain: _Terrain, tiles: list[np.ndarray]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        oracle = _Oracle(self.robot, self.kind, self.settings, self.cost_limit, self._base_reach)
        alone = self.cluster.scheduler is None and self.cluster.processes(len(tiles)) == 1
        # This process evaluates the first tile, which fills the cache of compiled kernels before several read it.
        for tile in tiles if alone else tiles[:1]:
            yield tile, _tile_costs(oracle, terrain, tile)
        if alone or len(tiles) < 2:
            return
        from distributed import as_completed

        with connected(self.cluster, len(tiles) - 1) as client:
            there = client.scatter(terrain, broadcast=True)
            futures = {client.submit(_tile_costs, oracle, there, tile, pure=False): tile for tile in tiles[1:]}
            for future in as_completed(futures):
                yield futures[future], future.result()


def _tiles(states: np.ndarray) -> list[np.ndarray]:
    """States int64 [n, 3] (heading, ix, iy) by squares, at the same places for every region."""
    squares, which = np.unique(states[:, 1:] // _TILE, axis=0, return_inverse=True)
    return [states[which.ravel() == number] for number in range(len(squares))]


def _tile_costs(oracle: _Oracle, terrain: _Terrain, states: np.ndarray) -> np.ndarray:
    """Costs float64 [n, 22] from neighbouring states int64 [n, 3], (heading, ix, iy)."""
    whole = terrain.world
    anchors = abstract_anchor(states[:, [1, 2, 0]])
    # Parts have one shape, and with it one set of tables; at the map's border they are shifted inside.
    side = _TILE * CELLS_PER_ABSTRACT + 2 * oracle.reach
    shape = min(side, whole.nx), min(side, whole.ny)
    first = np.clip(anchors[:, :2].min(axis=0) - oracle.reach, 0, np.subtract((whole.nx, whole.ny), shape))
    part = Part((int(first[0]), int(first[1])), shape)
    world = part_of_world(whole, oracle.robot, part)
    regions = terrain.regions._replace(region=part_of_map(terrain.regions.region, whole, part))
    shared = Shared(new_poses(world, 0, HEADINGS), regions)
    starts, valid = feet_at_all(world, anchors - np.array([*part.first, 0]))
    costs = np.full((len(starts), N_ABSTRACT_ACTIONS), np.inf)
    for index in np.flatnonzero(valid):
        found = task_costs(world, starts[index], oracle.settings, oracle.cost_limit, kind=oracle.kind, shared=shared)
        costs[index] = found[1]
    return costs
