"""One planner, many threads: plans and updates are linearisable; models are shared; processes fork and spawn."""

import json
import os
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from hdsp import HeightMap, Planner
from hdsp.abstract.abstract_costs import AbstractCosts
from hdsp.planning import shared_ground
from tests import ROOT

START, GOAL = (0.9, 1.5, 0.0), (3.0, 1.5, 0.0)


def version(number: int) -> HeightMap:
    """A map of its own for each number: a block that lengthens the way, a little farther each time."""
    heights = np.zeros((160, 120), np.float32)
    heights[70:80, 40 + 2 * number : 80] = 1.0
    return HeightMap(heights)


def plan_on(planner: Planner):
    return planner.plan(START, GOAL, 1.5, polish=0.0, start_free=False)


def current_during(began: float, ended: float, updates: list[tuple[float, float]]) -> set[int]:
    """Versions of the map that some moment of a call may see; ``updates`` are intervals of the calls that set them."""
    found = set()
    for number, (set_from, _) in enumerate(updates):
        replaced_by = updates[number + 1][1] if number + 1 < len(updates) else np.inf
        if set_from <= ended and replaced_by >= began:
            found.add(number)
    return found


def test_each_plan_is_that_of_a_map_that_was_current_during_its_call():
    heuristic = "manual"
    maps = [version(number) for number in range(6)]
    planner = Planner(maps[0], heuristic=heuristic, conditioning=None)
    expected = [plan_on(Planner(each, heuristic=heuristic, conditioning=None)) for each in maps]
    numbers = {id(each): number for number, each in enumerate(maps)}
    updates, calls, faults = [(0.0, 0.0)], [], []

    def ask():
        try:
            for _ in range(4):
                began = time.perf_counter()
                plan = plan_on(planner)
                calls.append((began, time.perf_counter(), plan))
        except Exception as fault:
            faults.append(fault)

    def update():
        for each in maps[1:]:
            began = time.perf_counter()
            updates.append((began, np.inf))
            planner.update(each)
            updates[-1] = began, time.perf_counter()
            time.sleep(0.002)

    threads = [threading.Thread(target=each) for each in (ask, ask, ask, update)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not faults and len(calls) == 12 and len(updates) == len(maps)
    for began, ended, plan in calls:
        number = numbers[id(plan.terrain)]
        assert number in current_during(began, ended, updates)
        assert plan.cost == expected[number].cost
        np.testing.assert_array_equal(plan.states, expected[number].states)


def test_the_checker_knows_which_maps_were_current():
    updates = [(0.0, 0.0), (1.0, 2.0), (5.0, 6.0)]
    assert current_during(0.2, 0.8, updates) == {0}
    assert current_during(0.5, 1.5, updates) == {0, 1} == current_during(1.2, 1.3, updates)
    assert current_during(3.0, 4.0, updates) == {1} and current_during(7.0, 8.0, updates) == {2}


@pytest.mark.parametrize(
    ("question", "amid"),
    [("valid", "locate"), ("can_leave", "locate"), ("nearest", "pose_values"), ("nearest", "nearest_to_leave")],
)
def test_an_answer_about_a_pose_belongs_to_one_map_though_another_thread_updates_amid_it(question, amid, monkeypatch):
    pose, boxed = (1.51, 1.51, 0.0), np.zeros((120, 120), np.float32)
    boxed[38:82, 41:43] = boxed[38:82, 77:79] = boxed[38:40, 41:79] = boxed[80:82, 41:79] = 1.0
    planner = Planner(HeightMap.flat((120, 120)), conditioning=None)
    before, other = getattr(planner, question)(pose), HeightMap(boxed, (0.3, 0.0))
    step = getattr(shared_ground, amid)

    def interrupted(*arguments):
        thread = threading.Thread(target=planner.update, args=(other,))
        thread.start()
        thread.join()
        return step(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(shared_ground, amid, interrupted)
        answer = getattr(planner, question)(pose)
    assert planner.terrain is other
    np.testing.assert_array_equal(answer, before)
    assert not np.array_equal(getattr(planner, question)(pose), before)


def test_two_planners_share_one_learned_model_at_once():
    pytest.importorskip("onnxruntime")
    from hdsp.learning.learned_costs import LearnedCosts
    from hdsp.learning.loading import abstraction_of
    from hdsp.robot.robot import Robot

    robot = Robot.load("momaro")
    costs: AbstractCosts = LearnedCosts(abstraction_of(robot), robot=robot)
    maps = [version(2), version(6)]
    alone = [plan_on(Planner(each, heuristic=costs, conditioning=None)) for each in maps]
    planners, found = [Planner(each, heuristic=costs, conditioning=None) for each in maps], [None, None]

    def ask(k: int) -> None:
        found[k] = plan_on(planners[k])

    threads = [threading.Thread(target=ask, args=(k,)) for k in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for one, other in zip(found, alone, strict=True):
        assert one.cost == other.cost and one.solved
        np.testing.assert_array_equal(one.states, other.states)


#: Plans in this process, in a fork of it and in a spawned one, with torch and its threads loaded.
PROCESSES = """
import json, multiprocessing, sys
import torch
import numpy as np
from hdsp import HeightMap, Planner

def ask(planner, answers):
    answers.put(planner().plan((0.9, 1.5, 0.0), (3.0, 1.5, 0.0), 1.5, polish=0.0).cost)

def new():
    return Planner(HeightMap.flat((160, 120)), heuristic=sys.argv[1] if len(sys.argv) > 1 else "learned")

class Ready:
    def __call__(self):
        return PLANNER

if __name__ == "__main__":
    torch.ones(300, 300) @ torch.ones(300, 300)
    PLANNER = new()
    costs = [PLANNER.plan((0.9, 1.5, 0.0), (3.0, 1.5, 0.0), 1.5, polish=0.0).cost]
    for method, planner in (("fork", Ready()), ("spawn", new)):
        context = multiprocessing.get_context(method)
        answers = context.Queue()
        child = context.Process(target=ask, args=(planner, answers))
        child.start()
        costs.append(answers.get(timeout=120))
        child.join()
        assert child.exitcode == 0
    print(json.dumps(costs))
"""


def test_planners_work_after_fork_and_spawn_with_torch_loaded(tmp_path):
    pytest.importorskip("torch")
    (tmp_path / "processes.py").write_text(PROCESSES)
    command = [sys.executable, str(tmp_path / "processes.py"), "manual"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    costs = json.loads(done.stdout.splitlines()[-1])
    assert len(costs) == 3 and len(set(costs)) == 1 and np.isfinite(costs[0])
