"""A planner in a robot's loop: plans again five times a second while the map changes and the robot moves along.

    python -m examples.planning_loop

A door in a wall closes while the robot drives to it, and the robot takes the other door. The last line is JSON.
"""

import json
import threading
import time
from collections.abc import Callable

import numpy as np

from hdsp import HeightMap, Plan, Planner

PERIOD = 0.2  # s between two plans
AHEAD = 0.3  # s; a new plan begins where the robot will be after this time
GAIN = 0.1  # share of the rest of a plan by which another way must be cheaper
SPEED = 0.5  # m/s, of the robot in this example


class PlanningLoop:
    """Keeps a plan to a goal up to date.

    The robot changes its way only for a reason: the plan became impossible in the new map, or another one costs at
    least ``GAIN`` less than its rest. Equal ways on two sides of an obstacle would otherwise take turns.

    Args:
        planner: the planner; the loop alone updates it.
        goal: as for ``Planner.plan``.
        pose: returns the robot's pose, or its state with 7 values, now.
        options: further options of ``Planner.plan``.

    Attributes:
        current: the plan to follow; None before the first one, and while there is no way.
        changes: number of plans followed so far.
    """

    def __init__(self, planner: Planner, goal, pose: Callable[[], np.ndarray], **options):
        self.current: Plan | None = None
        self.changes = 0
        self._planner, self._goal, self._pose, self._options = planner, goal, pose, options
        self._map: HeightMap | None = None
        self._lock = threading.Lock()

    def new_map(self, terrain: HeightMap) -> None:
        """Takes a new map, from any thread; the next turn plans on it, and a plan in progress ends early."""
        with self._lock:
            self._map = terrain
        self._planner.cancel()

    def turn(self) -> Plan | None:
        """Plans once; returns the plan to follow."""
        with self._lock:
            terrain, self._map = self._map, None
        if terrain is not None:
            self._planner.update(terrain)
        kept = self._rest()
        start = self._pose() if kept is None else kept[1]
        found = self._planner.plan(start, self._goal, **self._options)
        if found.status.name == "CANCELLED":  # a newer map is there
            return self.current
        if kept is None or found.cost < (1 - GAIN) * kept[0]:
            self.current = found if found.solved else None
            self.changes += found.solved
        return self.current

    def run(self, ends: threading.Event) -> None:
        """Takes turns every ``PERIOD`` until an event is set."""
        while not ends.is_set():
            began = time.perf_counter()
            self.turn()
            ends.wait(max(0.0, PERIOD - (time.perf_counter() - began)))

    def _rest(self) -> tuple[float, np.ndarray] | None:
        """Cost of the rest of the plan, and the state at which it begins; None if it is impossible in the map."""
        plan = self.current
        if plan is None:
            return None
        at = np.hypot(*(plan.states[:, :2] - np.asarray(self._pose())[:2]).T)
        way = np.append(0.0, np.cumsum(np.hypot(*np.diff(plan.states[:, :2], axis=0).T)))
        first = int(np.searchsorted(way, way[int(np.argmin(at))] + AHEAD * SPEED))
        rest = plan.states[min(first, len(plan.states) - 1) :]
        if not all(self._planner.valid(state) for state in rest):
            return None
        return float(plan.action_costs[min(first, len(plan.action_costs)) :].sum()), rest[0]


def room(open_doors: tuple[bool, bool]) -> HeightMap:
    """A room with a wall across, and two doors in it."""
    heights = np.zeros((200, 200), np.float32)
    heights[96:104] = 1.0
    for is_open, door in zip(open_doors, (slice(20, 70), slice(130, 180)), strict=True):
        if is_open:
            heights[96:104, door] = 0.0
    return HeightMap(heights)


def main() -> dict:
    planner = Planner(room((True, True)), heuristic="manual", conditioning=None)
    pose = np.array([1.0, 2.4, 0.0])
    loop = PlanningLoop(planner, (4.0, 2.4, 0.0), lambda: pose, weight=1.25, time=1.0)
    began, turns, doors = time.perf_counter(), 0, []
    while np.hypot(*(pose[:2] - (4.0, 2.4))) > 0.1 and turns < 100:
        if turns == 4:
            loop.new_map(room((doors[0] == 1, doors[0] == 0)))
        plan = loop.turn()
        assert plan is not None
        doors.append(int(plan.states[np.argmin(abs(plan.states[:, 0] - 2.5)), 1] > 2.5))
        pose = _moved(plan, pose, SPEED * PERIOD)
        turns += 1
    seconds = time.perf_counter() - began
    result = {"turns": turns, "changes": loop.changes, "doors": doors, "hz": round(turns / seconds, 1)}
    print(json.dumps(result))
    return result


def _moved(plan: Plan, pose: np.ndarray, distance: float) -> np.ndarray:
    """The pose after a distance along a plan."""
    near = int(np.argmin(np.hypot(*(plan.states[:, :2] - pose[:2]).T)))
    way = np.append(0.0, np.cumsum(np.hypot(*np.diff(plan.states[near:, :2], axis=0).T)))
    return plan.states[near + min(int(np.searchsorted(way, distance)), len(way) - 1), :3]


if __name__ == "__main__":
    main()
