"""F6: a planner in a robot's loop: threads share it, and queries are cancelled."""

import threading
import time

import numpy as np
import pytest

from hdsp import HeightMap, Planner
from hdsp.base.gradual import Cancelled, Gradual, cancelled_by
from hdsp.detailed.search.outcome import Status

START, GOAL = (0.9, 1.5, 0.0), (3.0, 1.5, 0.0)


def walls() -> list[HeightMap]:
    """Maps of one size: free ground, and a wall with a gap on one side or on the other."""
    maps = []
    for gap in (slice(0, 0), slice(0, 60), slice(60, None)):
        heights = np.zeros((160, 120), np.float32)
        if gap.stop != 0:
            heights[74:80] = 1.0
            heights[74:80, gap] = 0.0
        maps.append(HeightMap(heights))
    return maps


def in_thread(function) -> tuple[threading.Thread, list]:
    found: list = []
    thread = threading.Thread(target=lambda: found.append(function()), daemon=True)
    thread.start()
    return thread, found


@pytest.fixture(scope="module")
def endless():
    """A query that takes minutes: a goal behind a wall with room for no robot, in a large map, without a proof."""
    heights = np.zeros((400, 400), np.float32)
    heights[::16, ::16] = 0.3
    planner = Planner(HeightMap(heights), conditioning=None)
    poses = [(x, y, 0.0) for x in np.arange(1.0, 3.0, 0.1) for y in np.arange(1.0, 3.0, 0.1)]
    start = next(pose for pose in poses if planner.can_leave(pose))
    return planner, start


@pytest.mark.parametrize("heuristic", ["geometric", "manual"])
def test_f6_plans_of_threads_equal_plans_of_new_planners_on_one_of_the_maps(heuristic):
    maps = walls()
    fresh = [Planner(each, heuristic=heuristic, conditioning=None).plan(START, GOAL, 1.5, polish=0) for each in maps]
    expected = {id(each): plan for each, plan in zip(maps, fresh, strict=True)}
    assert len({plan.cost for plan in fresh}) == len(maps)
    planner = Planner(maps[0], heuristic=heuristic, conditioning=None)
    plans, faults = [], []

    def ask():
        try:
            for _ in range(3):
                plans.append(planner.plan(START, GOAL, 1.5, polish=0, start_free=False))
        except Exception as fault:
            faults.append(fault)

    threads = [threading.Thread(target=ask) for _ in range(3)]
    for thread in threads:
        thread.start()
    for k in range(6):
        planner.update(maps[k % len(maps)])
        time.sleep(0.005)
    for thread in threads:
        thread.join()
    assert not faults and len(plans) == 9
    for plan in plans:
        other = expected[id(plan.terrain)]
        assert plan.cost == other.cost
        np.testing.assert_array_equal(plan.states, other.states)


def test_f6_another_thread_ends_a_query_and_later_ones_are_unharmed():
    planner = Planner(walls()[1], conditioning=None)
    before = planner.plan(START, GOAL, 1.5, polish=0)
    began = threading.Event()

    def slow(expansions: int, seconds: float) -> None:
        began.set()
        time.sleep(0.05)

    thread, found = in_thread(lambda: planner.plan(START, GOAL, 1.0, progress=slow, time=60.0))
    assert began.wait(10)
    planner.cancel()
    thread.join(10)
    assert found[0].status == Status.CANCELLED
    assert planner.plan(START, GOAL, 1.5, polish=0).cost == before.cost


def test_f6_a_cancelled_query_says_so():
    planner = Planner(walls()[1], conditioning=None)  # round a wall: many slices of a search

    def cancel(expansions: int, seconds: float) -> None:
        planner.cancel()

    plan = planner.plan(START, GOAL, progress=cancel)
    assert plan.status == Status.CANCELLED and not plan.solved and len(plan.states) == 0
    assert "cancelled after" in plan.explain()
    (last,) = planner.improve(START, GOAL, weights=(1.0,), progress=cancel)
    assert last.status == Status.CANCELLED
    planner.cancel()  # concerns earlier queries alone
    assert planner.plan(START, GOAL).solved


def test_f6_improvement_ends_after_its_last_plan():
    planner = Planner(walls()[1], conditioning=None)
    plans = planner.improve(START, GOAL, weights=(3.0, 1.0), polish=0)
    first = next(plans)
    planner.cancel()
    assert first.solved and first.stats.ended is None
    assert list(plans) == [] and first.stats.ended == "cancelled"


def test_f6_a_cancelled_computation_continues_later():
    def steps():
        total = 0
        for k in range(4):
            total += k
            yield
        return total

    gradual, event = Gradual(steps()), threading.Event()
    gradual.step()
    event.set()
    with cancelled_by(event), pytest.raises(Cancelled):
        gradual.run(np.inf)
    assert not gradual.failed and gradual.run(np.inf) and gradual.result == 6


def test_f6_other_threads_go_on_during_a_search(endless):
    planner, start = endless
    thread, _ = in_thread(lambda: planner.plan(start, (9.0, 9.0, 0.0), time=3.0, expansions=2_000_000))
    gaps, before = [], time.perf_counter()
    while thread.is_alive():
        time.sleep(0.005)
        gaps.append(time.perf_counter() - before)
        before = time.perf_counter()
        if len(gaps) == 100:
            planner.cancel()
    # Without the release, each gap is as long as a slice. The machine's other work delays single wakes.
    assert len(gaps) >= 20 and np.median(gaps) < 0.02
