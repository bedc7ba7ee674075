"""The example of a robot's loop: it plans again when its way closes, and does not flip between equal ways."""

import threading

import numpy as np

from examples import planning_loop
from examples.planning_loop import PlanningLoop, room
from hdsp import Planner


def test_f6_the_robot_takes_the_other_door_once_its_own_closes():
    result = planning_loop.main()
    doors = result["doors"]
    assert result["turns"] < 100
    # One change of the door, and no other one: both ways cost the same at the beginning.
    assert int(np.abs(np.diff(doors)).sum()) == 1 and doors[0] == doors[4 - 1] != doors[4] == doors[-1]
    assert result["changes"] == 2


def test_f6_the_loop_runs_beside_other_threads_and_ends():
    planner = Planner(room((True, True)), heuristic="manual", conditioning=None)
    pose = np.array([1.0, 2.4, 0.0])
    loop, ends = PlanningLoop(planner, (4.0, 2.4, 0.0), lambda: pose, weight=1.25), threading.Event()
    thread = threading.Thread(target=loop.run, args=(ends,))
    thread.start()
    for closed in (True, False, True):
        loop.new_map(room((closed, True)))
    ends.set()
    thread.join(20)
    assert not thread.is_alive()
    assert loop.turn() is not None and loop.changes >= 1
