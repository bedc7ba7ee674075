"""Help for a start or goal in which the robot cannot stand: the nearest pose that it can leave."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hdsp.detailed.search.reached import METRES_PER_RADIAN
from hdsp.detailed.world.world import World
from hdsp.planning.answers.findings import Findings
from hdsp.planning.ends.nearby import nearest_to_leave
from hdsp.robot.lattice import Grid, heading_angle
from hdsp.robot.robot import Robot

#: Largest distance of a pose that is worth a word, m.
RADIUS = 1.0


@dataclass(frozen=True, eq=False)
class InvalidEnd:
    """A start or goal in which the robot cannot stand.

    Attributes:
        world: terrain and robot, compiled.
        grid: place of the terrain in the world.
        robot: the robot with its margin.
        pose: float64 [3], world pose.
        heading_free: whether the heading does not matter.
    """

    world: World
    grid: Grid
    robot: Robot
    pose: np.ndarray
    heading_free: bool

    def __call__(self) -> Findings:
        """Finds the nearest pose."""
        found = nearest_to_leave(
            self.world, self.grid, self.robot, self.pose, self.heading_free, RADIUS, METRES_PER_RADIAN
        )
        if found is None:
            return Findings(advice=(f"no pose within {RADIUS:g} m works either",))
        state, _ = found
        x, y = self.grid.center(state[:2])
        away = float(np.hypot(x - self.pose[0], y - self.pose[1]))
        degrees = float(np.degrees(heading_angle(state[2])))
        where = f"({x:.2f}, {y:.2f}) m, heading {degrees:.0f} degrees, {away:.2f} m away"
        feet = ", on displaced feet" if state[3:].any() else ""
        return Findings(advice=(f"the nearest pose that works is {where}{feet}",))

    def limits(self, findings: Findings) -> None:
        """Limits of the robot; here none, because the causes name them."""
