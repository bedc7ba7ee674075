"""The way out of the clearance of obstacles, for a robot that stands nearer to them than it would go by itself.

The robot is examined with smaller and smaller distances, by one cell at a time: the clearance of its feet, and the
margin of its body. The least reduction that makes a state valid is its *lack*. The way out is a straight drive on
neutral feet along which the lack never grows, to the first state without lack that the robot can leave. Each of its
actions is legal for the robot with the distances of the start, and costs as much as for this robot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hdsp.detailed.actions.action import DRIVES
from hdsp.detailed.actions.state_costs import state_costs
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.search.life_cycle import edge_costs
from hdsp.detailed.states import pack_states
from hdsp.detailed.world.world import World, build_world
from hdsp.detailed.world.world_update import influence
from hdsp.planning.ends.nearby import can_leave
from hdsp.planning.margin import with_margin
from hdsp.robot.lattice import cells, metres
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap

#: Largest length of a way out, m.
LONGEST = 0.5


@dataclass(frozen=True, eq=False)
class WayOut:
    """First actions of a plan.

    Attributes:
        states: int64 [n + 1, 7], from the start to a valid state, lattice units.
        actions: uint8 [n], action codes.
        costs: float64 [n].
        words: the way in words.
    """

    states: np.ndarray
    actions: np.ndarray
    costs: np.ndarray
    words: str


def find_way_out(terrain: HeightMap, world: World, robot: Robot, wider: Robot, start: np.ndarray) -> WayOut | None:
    """Returns the cheapest way out of the clearance of obstacles.

    Args:
        terrain: the map.
        world: terrain and ``wider``, compiled.
        robot: the robot.
        wider: the robot with its margin.
        start: int64 [7], lattice units, on neutral feet, not valid.

    Returns:
        The way; None if the robot cannot stand there even without clearance and margin, or no straight way leads out.
    """
    if start[3:].any():
        return None
    near = _Near(terrain, robot, wider, start)
    lack = near.lack(start[None])[0]
    if not 0 < lack < len(near.worlds):
        return None
    found = [way for action in range(DRIVES) if (way := near.straight(start, action, int(lack))) is not None]
    for states, action, costs in sorted(found, key=lambda way: float(way[2].sum())):
        if can_leave(world, wider, states[-1]):
            words = (
                f"the robot starts up to {metres(float(lack)):g} m nearer to obstacles than it goes by itself; the "
                f"first {len(costs)} actions lead out, {metres(float(np.hypot(*(states[-1] - start)[:2]))):.2f} m"
            )
            return WayOut(states, np.full(len(costs), action, dtype=np.uint8), costs, words)
    return None


class _Near:
    """The ground near the start, compiled for the robot with less and less clearance and margin.

    Attributes:
        worlds: worlds by lack, in cells.
    """

    def __init__(self, terrain: HeightMap, robot: Robot, wider: Robot, start: np.ndarray):
        pairs = zip(wider.body.boxes, robot.body.boxes, strict=True)
        margin = max((wide.half_width - own.half_width for wide, own in pairs), default=0.0)
        reach = math.ceil(cells(LONGEST)) + 2 * influence(wider)
        low = np.maximum(start[:2] - reach, 0)
        high = np.minimum(start[:2] + reach + 1, terrain.shape)
        heights = terrain.heights[low[0] : high[0], low[1] : high[1]]
        part = HeightMap(heights, resolution=terrain.resolution)
        self._low = np.array([*low, 0, 0, 0, 0, 0])
        self.worlds = []
        for lack in range(math.ceil(cells(max(wider.feet.clearance, margin)) - 1e-9) + 1):
            less = with_margin(robot, max(margin - metres(float(lack)), 0.0))
            clearance = max(wider.feet.clearance - metres(float(lack)), 0.0)
            self.worlds.append(build_world(part, replace(less, feet=replace(less.feet, clearance=clearance))))

    def lack(self, states: np.ndarray) -> np.ndarray:
        """Lack of states [n, 7], int64 [n], cells; the number of worlds for states without any."""
        keys = pack_states(states - self._low, self.worlds[0].tables.lowest)
        valid = np.array([np.isfinite(state_costs(world, keys)) for world in self.worlds])
        return np.where(valid.any(axis=0), valid.argmax(axis=0), len(self.worlds))

    def straight(self, start: np.ndarray, action: int, lack: int) -> tuple[np.ndarray, int, np.ndarray] | None:
        """The straight drive by one action from the start to the first state without lack; None if there is none."""
        world = self.worlds[lack]
        move = np.array([world.tables.move_dx[action], world.tables.move_dy[action], 0, 0, 0, 0, 0])
        n = int(cells(LONGEST) / np.hypot(*move[:2]))
        states = start + move * np.arange(n + 1)[:, None]
        inside = ((states[:, :2] >= 0) & ((states - self._low)[:, :2] < (world.nx, world.ny))).all(axis=1)
        states = states[: len(inside) if inside.all() else int(inside.argmin())]
        lacks = self.lack(states)
        free = np.flatnonzero(lacks == 0)
        if len(free) == 0 or (np.diff(lacks[: free[0] + 1]) > 0).any():
            return None
        states = states[: free[0] + 1]
        keys = pack_states(states - self._low, world.tables.lowest)
        costs = edge_costs(world, Rules(), keys, np.full(len(keys) - 1, action, np.uint8))
        return (states, action, costs) if np.isfinite(costs).all() else None
