"""Map, lattice, robot and heuristic, shared by all queries to a planner until its next update."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hdsp.abstract.abstract_costs import AbstractCosts, Region
from hdsp.detailed.causes import Cause
from hdsp.detailed.world.world import World, build_world
from hdsp.detailed.world.world_update import updated_world
from hdsp.planning.arguments import lattice_state, pose_values
from hdsp.planning.ends.arrival import with_heading
from hdsp.planning.ends.location import locate
from hdsp.planning.ends.nearby import can_leave, nearest_to_leave
from hdsp.planning.heuristics import Heuristic
from hdsp.planning.heuristics.heuristic_choice import heuristic_of
from hdsp.planning.map_changes import changed_cells
from hdsp.planning.margin import with_margin
from hdsp.planning.measured_map import MeasuredMap
from hdsp.robot.lattice import Grid
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.map_filters import ConditioningSettings


@dataclass(frozen=True, eq=False)
class SharedGround:
    """Everything that follows from a planner's map, in one object.

    A change of the map makes another object, and this one stays as it is. A thread that takes the object once has
    parts that fit together, also while another thread updates the planner.

    Attributes:
        map: the measured map and its conditioned form.
        world: terrain and robot, with the planner's margin.
        grid: the terrain's lattice.
        robot, wider: the robot without and with the margin.
        heuristic: the planner's heuristic.
    """

    map: MeasuredMap
    world: World
    grid: Grid
    robot: Robot
    wider: Robot
    heuristic: Heuristic

    @classmethod
    def made(
        cls,
        terrain: HeightMap,
        robot: Robot,
        heuristic: str | AbstractCosts | Heuristic,
        margin: float,
        conditioning: ConditioningSettings | bool | None,
    ) -> SharedGround:
        """Makes the ground of a new planner; arguments and errors as for ``Planner``."""
        wider = with_margin(robot, margin)
        measured = MeasuredMap(terrain, conditioning)
        world = build_world(measured.terrain, wider)
        chosen = heuristic_of(heuristic, world, measured.terrain, robot, terrain)
        return cls(measured, world, _grid(measured.terrain), robot, wider, chosen)

    @property
    def terrain(self) -> HeightMap:
        """The map for planning."""
        return self.map.terrain

    @property
    def exact(self) -> bool:
        """Whether the terrain is taken as given, without conditioning."""
        return self.map.exact

    def updated(self, terrain: HeightMap, region: Region | None = None) -> SharedGround:
        """Returns the ground after a change of the map; arguments and errors as for ``Planner.update``."""
        measured, region = self.map.updated(terrain, region)
        terrain = measured.terrain
        changed = changed_cells(self.terrain, terrain, region)
        if changed is None:
            grid, world = _grid(terrain), build_world(terrain, self.wider)
        else:
            grid, world = self.grid, updated_world(self.world, terrain, self.wider, changed)
        heuristic = self.heuristic.updated(world, terrain, region)
        return replace(self, map=measured, world=world, grid=grid, heuristic=heuristic)

    def located(self, pose) -> tuple[np.ndarray, list[Cause]]:
        """Returns the detailed state at a pose and the causes for which it is invalid; see ``locate``."""
        return locate(self.world, self.grid, self.wider, pose, "pose")

    def can_leave(self, pose) -> bool:
        """Whether the robot can stand at a pose and get away; see ``Planner.can_leave``."""
        state, faults = self.located(pose)
        return not faults and can_leave(self.world, self.wider, state)

    def nearest(self, pose, radius: float, per_radian: float) -> np.ndarray | None:
        """Returns the nearest state that the robot can leave; see ``Planner.nearest``."""
        posed, heading_free = with_heading(pose)
        values = pose_values(posed, "pose", self.wider)
        lattice_state(self.grid, values, "pose")
        found = nearest_to_leave(self.world, self.grid, self.wider, values[:3], heading_free, radius, per_radian)
        return None if found is None else self.grid.to_world(found[0])


def _grid(terrain: HeightMap) -> Grid:
    return Grid(terrain.origin, terrain.shape)
