"""An abstraction with errors, ground for it, and what queries on it find."""

import functools

import numpy as np

from hdsp.abstract import FlatCosts, ManualCosts
from hdsp.abstract.abstract_costs import close_states
from hdsp.base.gradual import finished
from hdsp.robot.lattice import ABSTRACT_HEADINGS, N_ABSTRACT_ACTIONS, abstract_shape
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import random_map

MOMARO = Robot.load("momaro")
CELLS = 120


class Expensive(ManualCosts):
    """Manual costs with random factors and errors, which depend on the state alone; counts the evaluated states."""

    def __init__(self, seed=0, share=0.1):
        super().__init__(MOMARO)
        random, shape = np.random.default_rng(seed), (ABSTRACT_HEADINGS, CELLS // 4, CELLS // 4, N_ABSTRACT_ACTIONS)
        self._factor = random.uniform(0.8, 1.3, shape).astype(np.float32)
        self._factor[random.random(shape) < share] = np.inf
        self.least, self.asked = np.float32(0.9) * FlatCosts(MOMARO).edge_table, 0

    def edges(self, height_map, region=None, mask=None):
        first_x, first_y, end_x, end_y = region or (0, 0, *abstract_shape(height_map.shape))
        found = manual_edges(height_map)[:, first_x:end_x, first_y:end_y].copy()
        close_states(found, mask)
        self.asked += int(np.sum(mask))
        return found * self._factor[:, first_x:end_x, first_y:end_y]


@functools.cache
def manual_edges(height_map):
    """Manual costs of all edges."""
    return ManualCosts(MOMARO).edges(height_map)


def ground_with_a_step():
    """Random cuboids, and a step of 15 cm."""
    heights = random_map(1007, "cuboid_2", 5, cells=CELLS).heights.copy()
    heights[70:90, 20:60] += 0.15
    return HeightMap(heights)


def poses(planner, random, count):
    """World poses at which the robot can stand."""
    found = []
    while len(found) < count:
        pose = (*random.uniform(0.5, 2.5, 2), random.uniform(-3, 3))
        if planner.can_leave(pose):
            found.append(pose)
    return found


def table(planner, start, goal):
    """Costs-to-go for a query, [16, nx, ny]."""
    lattice = [np.array(planner.grid.to_lattice(pose)) for pose in (start, goal)]
    to_go = finished(planner.heuristic.steps_from(lattice[0], lattice[1][None])).to_go
    return to_go.values.reshape(ABSTRACT_HEADINGS, to_go.nx, to_go.ny)
