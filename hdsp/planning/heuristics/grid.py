"""The grid heuristic: geometric, and aware of walls."""

import numpy as np

from hdsp.abstract.abstract_costs import Region
from hdsp.base.gradual import Steps, finished
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.relaxed.foothold_regions import FootholdRegions, efforts_to, foothold_region_steps, regions_memory
from hdsp.detailed.search.estimate import Estimate, grid_estimate, least_foot_cost, with_step_efforts
from hdsp.detailed.world.world import World
from hdsp.planning.heuristics.heuristic import Heuristic
from hdsp.terrain.height_map import HeightMap

#: Budget of a backward search, bytes.
MEMORY = 1 << 30


class GridHeuristic(Heuristic):
    """Lower bound on the way of the base over the map in (x, y, heading), on the feet, and on their steps.

    The base's part is a relaxed problem (``hdsp.detailed.search.backward``), in which neutral feet drive and turn
    exactly as in the detailed search. A backward search from the goals settles its poses when the forward search asks
    for them, and needs no preparation of the map. Each foot adds the least effort of its steps between foothold
    regions. The geometric heuristic counts where it is larger, and beyond the budget of memory.

    Args:
        world: terrain and robot, compiled.
        memory: budget of the backward search, bytes.
    """

    name = "grid"
    admissible = True
    consistent = True

    def __init__(self, world: World, memory: int = MEMORY):
        super().__init__(world)
        self.memory = memory
        self._regions: FootholdRegions | None = None

    def needed_memory(self) -> int:
        return regions_memory(self.world, self._regions)

    def prepare(self) -> None:
        finished(self._prepared())

    def _prepared(self) -> Steps[FootholdRegions]:
        if self._regions is None:
            self._regions = yield from foothold_region_steps(self.world, Rules(), least_foot_cost(self.world))
        return self._regions

    def steps_to(self, goals: np.ndarray, groups: np.ndarray | None = None) -> Steps[Estimate]:
        yield from self._prepared()
        return (yield from super().steps_to(goals, groups))

    def estimate_for(self, goal: np.ndarray) -> Estimate:
        return self.estimate_for_nearest(goal[None], np.zeros(1, dtype=np.int64))

    def estimate_for_nearest(self, goals: np.ndarray, groups: np.ndarray) -> Estimate:
        regions = finished(self._prepared())
        estimate = grid_estimate(self.world, goals, groups, self.memory)
        return with_step_efforts(estimate, regions.region, efforts_to(regions, self.world, goals))

    def update(self, world: World, terrain: HeightMap, region: Region | None = None) -> None:
        super().update(world, terrain, region)
        self._regions = None
