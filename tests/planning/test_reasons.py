"""Reasons for staircases that the robot cannot climb are named and true: without the named limit, they are gone."""

import math
import re
import time
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.stairs import Task
from hdsp import HeightMap, Planner
from hdsp.detailed.causes import Kind
from hdsp.detailed.relaxed.proofs import is_foot_stopped
from hdsp.detailed.search.outcome import Status
from hdsp.planning.answers.findings import Findings
from hdsp.planning.ends.location import locate
from hdsp.planning.heuristics import AbstractHeuristic
from hdsp.robot.robot import Robot

MOMARO = Robot.load("momaro")


def stairs(rise, tread, steps=3, up=True, yaw=0.0):
    return Task(steps, rise, tread, up, yaw, start_turn=0.0, goal_turn=0.0, aside=0.0, phase=0.01)


def planned(task, robot=MOMARO, **options):
    return Planner(task.terrain(), robot, heuristic="manual").plan(*task.poses(), weight=2, **options)


def with_step(robot, **values):
    return replace(robot, step=replace(robot.step, **values))


#: The phrase for each limit, and a robot without it. A foot without any clearance could turn over an edge; the code of
#: an action holds steps up to 0.375 m.
WITHOUT = {
    r"the treads are ([\d.]+)": lambda robot: replace(robot, feet=replace(robot.feet, clearance=0.03)),
    r"a step there rises or falls by ([\d.]+)": lambda robot: with_step(robot, max_height=2.0),
    r"a foot would swing ([\d.]+)": lambda robot: with_step(robot, max_clearance=2.0),
    r"a step there is ([\d.]+) m long": lambda robot: with_step(robot, max_length=0.375),
}


def no_foot_passes(task, robot):
    """Whether the steps of single feet prove that there is no way."""
    planner = Planner(task.terrain(), robot)
    start, goal = (locate(planner.world, planner.grid, robot, pose, "pose")[0] for pose in task.poses())
    return is_foot_stopped(planner.world, start, goal)


@pytest.mark.parametrize("name", ["momaro", "anymal_wheels"])
def test_limits_named_for_random_staircases_are_the_cause(name):
    robot, rng = Robot.load(name), np.random.default_rng(5)
    named = set()
    for _ in range(4):
        task = stairs(
            rise=rng.uniform(0.15, 0.4), tread=rng.uniform(0.17, 0.3), steps=int(rng.integers(1, 4)),
            up=rng.random() < 0.5, yaw=rng.uniform(-0.26, 0.26),
        )  # fmt: skip
        if not no_foot_passes(task, robot):
            continue
        words = planned(task, robot, expansions=1000).explain()
        assert words.startswith("there is no way: the "), words
        found = [phrase for phrase in WITHOUT if re.search(phrase, words)]
        assert found, words
        better = robot
        for phrase in found:
            better = WITHOUT[phrase](better)
        assert not no_foot_passes(task, better), words
        for phrase in found:  # each of them alone still stops the foot
            others = [other for other in found if other != phrase]
            partly = robot
            for other in others:
                partly = WITHOUT[other](partly)
            assert no_foot_passes(task, partly), (phrase, words)
        named.update(found)
    assert len(named) >= 2


def test_the_words_give_the_measures_of_the_staircase():
    short = planned(stairs(rise=0.15, tread=0.2)).explain()
    assert "the treads are 0.20 m deep; a foot that keeps 0.11 m from edges needs 0.275 m" in short
    high = planned(stairs(rise=0.31, tread=0.35)).explain()
    assert "a step there rises or falls by 0.310 m; the robot steps up to 0.3 m" in high
    assert "treads" not in high
    legs = with_step(MOMARO, max_length=0.2)
    assert "a step there is 0.275 m long; the robot steps up to 0.2 m" in planned(stairs(0.15, 0.3), legs).explain()


def test_no_limit_is_blamed_beside_unknown_ground():
    heights = np.zeros((120, 50), np.float32)
    heights[55:70] = np.nan
    plan = Planner(HeightMap(heights)).plan((0.6, 0.6, 0.0), (2.4, 0.6, 0.0))
    assert plan.status == Status.INFEASIBLE and plan.limits is None
    assert {cause.kind for cause in plan.causes} == {Kind.UNKNOWN} and "edge" not in plan.explain()


def narrow(task):
    """The staircase in a corridor that leaves room for one heading: small enough to search all of it."""
    terrain = task.terrain()
    middle = terrain.shape[1] // 2
    heights = terrain.heights.copy()
    heights[:, : middle - 17], heights[:, middle + 17 :] = np.nan, np.nan
    return HeightMap(heights, origin=terrain.origin)


@pytest.mark.parametrize(
    ("robot", "words", "better"),
    [
        (
            replace(MOMARO, feet=replace(MOMARO.feet, offset_min=-0.125, offset_max=0.125)),
            "the feet reach -0.125 to 0.125 m from neutral",
            MOMARO,
        ),
        (with_step(MOMARO, support_margin=0.2), "the base stays 0.2 m inside the triangle of three feet", MOMARO),
    ],
)  # fmt: skip
def test_a_search_through_everything_names_the_decisive_limit(robot, words, better):
    task = stairs(rise=0.17, tread=0.28, steps=2)
    terrain = narrow(task)

    def plan_of(robot):
        return Planner(terrain, robot, heuristic="manual").plan(*task.poses(), weight=3, expansions=3_000_000)

    plan = plan_of(robot)
    assert plan.status == Status.INFEASIBLE and not plan.problems
    assert plan.limits == f"{words}; without this limit there is a way"
    assert plan.limits in plan.explain() and plan.causes and plan.nearest is not None
    assert plan_of(better).solved and math.isinf(plan.cost)


def test_reasons_take_no_longer_than_the_time_limit(monkeypatch):
    task = stairs(rise=0.17, tread=0.28, steps=2)
    robot = with_step(MOMARO, support_margin=0.2)
    plan = Planner(narrow(task), robot, heuristic="geometric").plan(*task.poses(), weight=3, time=50.0)
    assert plan.status == Status.INFEASIBLE and plan.inquiry.seconds == 50.0

    steps = []

    def slow(self, goals, groups=None):
        while len(steps) < 1000:
            steps.append(time.sleep(0.01))
            yield

    monkeypatch.setattr(AbstractHeuristic, "steps_to", slow)
    assert replace(plan.inquiry, seconds=0.5).limits(Findings()) is None and len(steps) <= 50
    late = replace(plan, inquiry=replace(plan.inquiry, seconds=0.0))
    assert late.explain().endswith("; the reasons take longer than the time limit")
    assert late.causes == () and late.limits is None
