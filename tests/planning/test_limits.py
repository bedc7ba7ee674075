"""Q4: one budget of time for preparation, search, proof and refinement, and nothing computed twice."""

import time
import tracemalloc
from itertools import product

import numpy as np
import pytest

from hdsp import HeightMap, InputError, Planner, Status
from hdsp.abstract import FlatCosts, prepared_graph
from hdsp.abstract.prepared_graph import PreparedGraph
from hdsp.base import gradual
from hdsp.base.gradual import Gradual
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.relaxed import foothold_regions, heading_masks
from hdsp.detailed.relaxed.foothold_regions import find_foothold_regions
from hdsp.detailed.relaxed.heading_masks import PoseFlood
from hdsp.detailed.search import anytime, life_cycle
from hdsp.detailed.search.estimate import geometric_estimate, least_foot_cost
from hdsp.detailed.search.life_cycle import FEW, PROOF_SHARE
from hdsp.detailed.search.multi_heuristic import solve_multi
from hdsp.detailed.search.outcome import Limits
from hdsp.detailed.search.store import EXPANDED
from hdsp.detailed.search.weighted_astar import solve
from hdsp.detailed.states import distinct_rows
from hdsp.learning.inference.kept_features import KeptFeatures
from hdsp.planning import query
from hdsp.planning.answers import plans
from hdsp.planning.compiled import compile_for
from hdsp.planning.heuristics import goal_sources, standing
from hdsp.planning.heuristics.standing import standing_states
from hdsp.planning.memory import least_memory
from hdsp.terrain.random_arenas import random_arena

START, GOAL = (0.9, 0.9, 0.0), (1.6, 1.1, 0.3)
#: Time by which a step of the searches here may exceed a limit on a busy machine, s.
LATE = 0.25


@pytest.fixture(scope="module")
def flat():
    return Planner(HeightMap.flat((100, 100)))


@pytest.fixture(scope="module", autouse=True)
def kernels(flat):
    """All kernels, before a test puts endless steps in place of computations."""
    for improving, refinable in product((False, True), repeat=2):
        compile_for(flat.robot, flat.heuristic, anytime=improving, refinable=refinable)


@pytest.fixture(scope="module")
def long_task():
    """A planner and two states, with a search of more expansions than a proof waits for."""
    planner = Planner(random_arena(0, 5.0))
    return planner, np.array([30, 172, 28, 0, 0, 0, 0]), np.array([178, 39, 48, 0, 0, 0, 0])


def endless_steps(*_arguments):
    while True:
        time.sleep(0.002)
        yield


def test_q4_a_search_goes_on_after_a_failed_proof_as_if_it_had_not_paused(long_task):
    planner, start, goal = long_task
    world, view = planner.world, geometric_estimate(planner.world, goal)
    wrong = view._replace(distance=3 * view.distance)
    asked = []

    def no_proof(ends):
        asked.append(ends)
        return False

    limits, weights = Limits(expansions=150_000), (2.0, 1.5)
    for search in (
        lambda hopeless: solve(world, start, goal, view, weight=1.5, reopen=False, hopeless=hopeless),
        lambda hopeless: solve_multi(world, start, goal, view, [wrong], weight=1.1, limits=limits, hopeless=hopeless),
        lambda hopeless: (
            [*anytime.improve(world, start, goal, weights, view, limits=limits, hopeless=hopeless)][-1].result
        ),
    ):
        asked.clear()
        paused, at_once = search(no_proof), search(None)
        assert len(asked) == 1 and at_once.expansions > FEW
        assert (paused.expansions, paused.seen) == (at_once.expansions, at_once.seen)
        assert paused.status == at_once.status and paused.lower_bound == at_once.lower_bound
        np.testing.assert_array_equal(paused.cost, at_once.cost)
        for one, other in zip(paused.paths, at_once.paths, strict=True):
            assert (one is None) == (other is None)
            if one is not None:
                np.testing.assert_array_equal(one.states, other.states)
                np.testing.assert_array_equal(one.actions, other.actions)


class Clock:
    """A clock that only expansions and the steps of a proof move."""

    def __init__(self, monkeypatch):
        self.seconds = 0.0
        for module in (gradual, life_cycle, query):
            monkeypatch.setattr(module, "now", lambda: self.seconds)
        run = life_cycle.Search._run

        def timed(search, expansions):
            before = int(search.store.counts[EXPANDED])
            code = run(search, expansions)
            self.seconds += 1e-6 * (int(search.store.counts[EXPANDED]) - before)
            return code

        monkeypatch.setattr(life_cycle.Search, "_run", timed)

    def steps(self, seconds, ends, result):
        """Steps of a proof that take so long each, and end after so many seconds."""

        def taken(*_arguments):
            left = ends
            while left > 0:
                self.seconds += seconds
                left -= seconds
                yield
            return result

        return taken


@pytest.mark.parametrize("improving", [False, True])
@pytest.mark.parametrize("wrong", [False, True])
def test_q4_search_and_proof_take_turns_and_lose_no_time(long_task, monkeypatch, wrong, improving):
    planner, start, goal = long_task
    world, clock, alone = planner.world, Clock(monkeypatch), 1e-6 * FEW
    view = geometric_estimate(world, goal)
    answer = "a proof" if wrong else None
    for length in (0.03, 0.2, 1.0):
        turns, proof = [], Gradual(clock.steps(0.002, length, answer)())

        def until(ends, turns=turns, proof=proof):
            turns.append((clock.seconds, ends))
            return proof.result is not None if proof.run(ends) else None

        began, limits = clock.seconds, Limits(expansions=300_000)
        if improving:
            result = [*anytime.improve(world, start, goal, (1.0,), view, limits=limits, hopeless=until)][-1].result
        else:
            result = solve(world, start, goal, view, limits=limits, hopeless=until)
        spent = clock.seconds - began
        assert result.seconds == pytest.approx(1e-6 * result.expansions)
        assert spent == pytest.approx(result.seconds + proof.seconds)
        assert turns[0][0] - began == pytest.approx(alone) and proof.done
        # A proof that succeeds ends the query, at most 4/3 of its own time after the search began to share.
        if wrong:
            assert result.status == [Status.INFEASIBLE]
            assert spent <= max(alone + length, length / PROOF_SHARE) + 0.08
        else:
            assert result.status == [Status.EXPANSION_LIMIT] and result.expansions == limits.expansions
        # Between two turns, the proof has had about its share of the time.
        for k, (at, ends) in enumerate(turns[1:], 1):
            assert ends > at and at - turns[k - 1][1] <= 0.03


def test_q4_plans_are_the_same_however_long_a_proof_takes(long_task, monkeypatch):
    planner, start, goal = long_task
    ends, clock = (planner.grid.to_world(start), planner.grid.to_world(goal)), Clock(monkeypatch)
    found = []
    for seconds in (1e-4, 1e-2, 0.3):
        monkeypatch.setattr(query, "proof_steps", clock.steps(seconds, 10.0, None))
        found.append(planner.plan(*ends, 1.5))
    assert len({plan.stats.expansions for plan in found}) == 1 and found[0].stats.expansions > FEW
    for plan in found[1:]:
        np.testing.assert_array_equal(plan.states, found[0].states)
        assert plan.stats.proof_seconds > 0


def test_q4_no_expansion_is_made_twice_and_the_statistics_say_where_the_time_went(long_task, monkeypatch):
    planner, start, goal = long_task
    ends = planner.grid.to_world(start), planner.grid.to_world(goal)
    at_once = solve(planner.world, start, goal, geometric_estimate(planner.world, goal), reopen=False, weight=1.5)
    plan = planner.plan(*ends, 1.5)
    assert plan.solved and plan.stats.expansions == at_once.expansions > FEW
    assert plan.cost == at_once.cost[0]
    stats = plan.stats
    assert stats.proof_seconds > 0
    assert stats.heuristic_seconds + stats.proof_seconds + stats.search_seconds <= stats.seconds


def test_q4_a_search_and_a_proof_without_end_share_the_time(long_task, monkeypatch):
    planner, start, goal = long_task
    ends = planner.grid.to_world(start), planner.grid.to_world(goal)
    monkeypatch.setattr(query, "proof_steps", endless_steps)
    began = time.perf_counter()
    plan = planner.plan(*ends, 1.0, time=0.6, expansions=100_000_000)
    assert time.perf_counter() - began < 0.6 + LATE
    assert plan.status == Status.TIME_LIMIT and plan.stats.expansions > FEW
    assert 0.1 < plan.stats.proof_seconds < 0.8 * 0.6 < plan.stats.proof_seconds + plan.stats.search_seconds
    *_, last = planner.improve(*ends, (1.0,), time=0.6)
    assert last.stats.ended == "time_limit" and last.stats.proof_seconds < 0.8 * 0.6


def test_q4_without_time_the_proof_proves_nothing_and_with_time_it_does(monkeypatch):
    heights = np.zeros((160, 160), np.float32)
    heights[78:82] = 1.0
    planner = Planner(HeightMap(heights))
    ends = (1.0, 2.0, 0.0), (3.0, 2.0, 0.0)
    assert planner.plan(*ends).status == Status.INFEASIBLE
    for expansions in (FEW, FEW + 1000):
        assert planner.plan(*ends, expansions=expansions).status == Status.INFEASIBLE
    assert planner.plan(*ends, expansions=FEW - 1000).status == Status.EXPANSION_LIMIT
    monkeypatch.setattr(query, "proof_steps", Clock(monkeypatch).steps(0.002, np.inf, None))
    assert planner.plan(*ends, expansions=FEW + 1000, time=0.5).status == Status.EXPANSION_LIMIT


@pytest.mark.parametrize("name", ["regions", "flood", "standing", "dijkstra"])
def test_q4_short_steps_and_long_ones_give_the_same(long_task, monkeypatch, name):
    planner, start, _ = long_task
    world = planner.world
    module, constant, compute = {
        "regions": (
            foothold_regions, "_CELLS", lambda: find_foothold_regions(world, Rules(), least_foot_cost(world)).effort
        ),
        "flood": (heading_masks, "_VISITS", lambda: PoseFlood(world, Rules()).reached_from(start, False)),
        "standing": (standing, "_STATES", lambda: standing_states(world)),
        "dijkstra": (
            prepared_graph, "_ENTRIES",
            lambda: PreparedGraph.from_edges(FlatCosts("momaro").edges(planner.terrain)).distances((30, 30, 3)),
        ),
    }[name]  # fmt: skip
    monkeypatch.setattr(module, constant, 10**9)
    at_once = compute()
    monkeypatch.setattr(module, constant, 700)
    np.testing.assert_array_equal(compute(), at_once)


class Slow(FlatCosts):
    """Costs whose edges take 30 steps of 10 ms."""

    taken = 0

    def edge_steps(self, height_map, region=None, mask=None):
        for _ in range(30):
            time.sleep(0.01)
            self.taken += 1
            yield
        return super().edges(height_map, region, mask)


def test_q4_a_heuristic_that_takes_longer_than_the_limit_is_prepared_over_several_queries(flat):
    fresh = Planner(flat.terrain, heuristic=FlatCosts("momaro")).plan(START, GOAL, 1.5)
    costs = Slow("momaro")
    planner = Planner(flat.terrain, heuristic=costs)
    began = time.perf_counter()
    plan = planner.plan(START, GOAL, 1.5, time=0.15)
    assert time.perf_counter() - began < 0.15 + LATE
    assert plan.status == Status.TIME_LIMIT and plan.stats.expansions == 0
    assert plan.stats.heuristic_seconds > 0.05 and 0 < costs.taken < 20
    (undecided,) = planner.improve(START, GOAL, time=0.02)
    assert undecided.stats.ended == "time_limit"
    plan = planner.plan(START, GOAL, 1.5)
    assert plan.solved and costs.taken == 30
    np.testing.assert_array_equal(plan.states, fresh.states)


def test_q4_a_changed_map_is_prepared_from_the_start(flat):
    costs = Slow("momaro")
    planner = Planner(flat.terrain, heuristic=costs)
    planner.plan(START, GOAL, time=0.05)
    heights = np.zeros((100, 100), np.float32)
    heights[60:64, 10:60] = 0.02
    taken = costs.taken
    plan = planner.update(HeightMap(heights)).plan(START, GOAL, 1.5)
    fresh = Planner(HeightMap(heights), heuristic=FlatCosts("momaro")).plan(START, GOAL, 1.5)
    assert costs.taken == taken + 30
    np.testing.assert_array_equal(plan.states, fresh.states)


def test_q4_edges_of_a_subclass_count_before_the_steps_of_its_parent(flat):
    class Other(Slow):
        def edges(self, height_map, region=None, mask=None):
            return 2 * super().edges(height_map, region, mask)

    costs = Other("momaro")
    Planner(flat.terrain, heuristic=costs).prepare()
    assert costs.taken == 0


def test_q4_a_plan_that_could_not_be_refined_in_time_is_no_plan(flat, monkeypatch):
    monkeypatch.setattr(plans, "refine_steps", endless_steps)
    began = time.perf_counter()
    plan = flat.plan(START, GOAL, 1.5, time=0.3, refinable=True)
    assert time.perf_counter() - began < 0.3 + LATE
    assert plan.status == Status.TIME_LIMIT and len(plan.states) == 0 and np.isinf(plan.cost)
    assert "not decided" in plan.explain() and plan.stats.expansions > 0
    (undecided,) = flat.improve(START, GOAL, time=0.3, refinable=True)
    assert undecided.status == Status.TIME_LIMIT and undecided.stats.ended == "time_limit"


def test_q4_a_computation_that_failed_begins_again(flat):
    class Failing(Slow):
        def edge_steps(self, height_map, region=None, mask=None):
            self.taken += 1
            yield
            if self.taken == 1:
                raise InputError("no network")
            return self.edges(height_map, region, mask)

    costs = Failing("momaro")
    planner = Planner(flat.terrain, heuristic=costs)
    with pytest.raises(InputError, match="no network"):
        planner.plan(START, GOAL)
    assert planner.plan(START, GOAL).solved and costs.taken == 2
    broken = Gradual(endless_steps())
    with pytest.raises(RuntimeError, match="not finished"):
        _ = broken.result


def test_memory_below_an_empty_search_is_an_error_that_names_the_least(flat):
    for planner in (flat, Planner(flat.terrain, heuristic="manual"), Planner(flat.terrain, heuristic="grid")):
        with pytest.raises(InputError, match="memory is 1000; a query on this map needs") as caught:
            planner.plan(START, GOAL, memory=1000)
        least = int(str(caught.value).split("needs ")[1].split()[0])
        empty = planner.heuristic.needed_memory() + least_memory(planner.world)
        assert empty <= least < empty + 2**20 and least % 2**20 == 0
        with pytest.raises(InputError, match=f"needs {least} bytes at least"):
            planner.improve(START, GOAL, memory=empty - 1)
        plan = planner.plan(START, GOAL, 1.5, memory=least)
        planner.plan(START, GOAL, 1.5)
        planner.plan(START, GOAL, 1.5, memory=least)  # still enough after other queries
        assert plan.status in (Status.SOLVED, Status.MEMORY_LIMIT) and plan.stats.total_memory <= least


def test_memory_counts_the_heuristic_and_the_states_at_the_goals(flat):
    manual = Planner(flat.terrain, heuristic="manual")
    few, more = flat.plan(START, GOAL, 1.5), manual.plan(START, GOAL, 1.5)
    edges = 16 * 25 * 25 * 22 * 4
    assert more.stats.total_memory > few.stats.total_memory + edges
    around = manual.plan(START, GOAL, 1.5, tolerance=(0.2, 3.2))
    assert around.stats.total_memory > more.stats.total_memory + 7 * 8 * 1000
    with pytest.raises(InputError, match="states at the goal need"):
        flat.plan(START, GOAL, tolerance=(1.0, 3.2), memory=5_000_000)


def test_memory_for_no_proof_leaves_the_search_alone():
    heights = np.zeros((160, 160), np.float32)
    heights[80:84] = 1.0
    plan = Planner(HeightMap(heights)).plan((1.0, 2.0, 0.0), (3.0, 2.0, 0.0), memory=2_500_000)
    assert plan.status == Status.MEMORY_LIMIT and plan.stats.total_memory <= 2_500_000
    assert plan.stats.expansions > FEW and plan.stats.proof_seconds == 0


def test_arrays_of_a_query_stay_within_its_memory(flat):
    heights = np.zeros((160, 160), np.float32)
    heights[80:84] = 1.0
    planner, limit = Planner(HeightMap(heights)), 3_000_000
    planner.plan((1.0, 2.0, 0.0), (3.0, 2.0, 0.0), expansions=10)
    tracemalloc.start()
    try:
        plan = planner.plan((1.0, 2.0, 0.0), (3.0, 2.0, 0.0), memory=limit)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert plan.status == Status.MEMORY_LIMIT and 0.4 * limit < peak < limit


def test_kept_features_stay_within_their_memory():
    memory = KeptFeatures((40, 40), np.full((3, 2), 4))
    cells, values = np.arange(900), np.zeros((900, 32), np.float32)
    memory.most = 4 << 20
    for heading in range(16):
        memory.keep(0, heading, memory._first[heading], 30, cells, values)
        assert memory.nbytes() <= memory.most
    memory.most = 1000
    memory.keep(0, 0, memory._first[0], 30, cells, values)
    assert memory.nbytes() <= 1000


def test_many_goals_have_the_same_abstract_states_in_parts(long_task, monkeypatch):
    planner, _, goal = long_task
    goals = goal + np.array([[x, y, h, 0, 0, 0, 0] for x in range(-6, 6) for y in range(-6, 6) for h in range(-20, 16)])
    standing = standing_states(planner.world)
    at_once = goal_sources.goal_sources(planner.world, standing, goals)
    monkeypatch.setattr(goal_sources, "_AT_ONCE", 100)
    assert goal_sources.goal_sources(planner.world, standing, goals).equal(at_once)
    rows = goals[np.random.default_rng(0).integers(len(goals), size=2000)]
    np.testing.assert_array_equal(distinct_rows(rows), np.unique(rows, axis=0, return_index=True)[1])
    np.testing.assert_array_equal(distinct_rows(rows << 20), np.unique(rows << 20, axis=0, return_index=True)[1])


def test_statistics_of_an_improved_plan_cover_the_search_after_it(long_task):
    planner, start, goal = long_task
    ends = planner.grid.to_world(start), planner.grid.to_world(goal)
    began = time.perf_counter()
    *_, last = planner.improve(*ends, (3.0, 1.0), time=0.5, polish=0.0)
    spent = time.perf_counter() - began
    assert last.stats.ended == "time_limit" and 0.45 < last.stats.seconds <= spent < last.stats.seconds + LATE
