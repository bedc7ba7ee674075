"""The detailed state at a pose, and its faults."""

from __future__ import annotations

import numpy as np

from hdsp.abstract.transform import feet_at
from hdsp.detailed.causes import Cause, faults_of
from hdsp.detailed.world.world import World
from hdsp.planning.arguments import lattice_state, pose_values
from hdsp.robot.lattice import Grid, heading_index
from hdsp.robot.robot import Robot


def locate(world: World, grid: Grid, robot: Robot, pose, name: str) -> tuple[np.ndarray, list[Cause]]:
    """Returns the detailed state at a world pose, int64 [7], and the causes for which it is invalid.

    Args:
        world: terrain and robot, compiled.
        grid: place of the terrain in the world.
        robot: its limits.
        pose: (x, y, theta) in m and rad, or 7 values with four foot offsets in m. Without feet, T_a->d chooses them.
        name: the pose in messages.

    Raises:
        InputError: the pose has other values, or lies off the map.
    """
    values = pose_values(pose, name, robot)
    state = lattice_state(grid, values, name)
    if len(values) == 3:
        chosen = feet_at(world, (int(state[0]), int(state[1]), int(heading_index(values[2]))))
        if chosen is not None:
            return chosen, []
    return state, list(faults_of(world, grid, robot, state))
