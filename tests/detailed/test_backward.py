"""The grid heuristic's backward search over base poses: admissible, consistent, the same in any order."""

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.relaxed.foothold_regions import efforts_to, find_foothold_regions
from hdsp.detailed.search.backward import FULL, USED
from hdsp.detailed.search.estimate import (
    final_estimates,
    grid_estimate,
    least_foot_cost,
    with_step_efforts,
)
from hdsp.detailed.search.weighted_astar import solve
from hdsp.detailed.states import pack_states
from hdsp.detailed.world.world import build_world
from hdsp.terrain.height_map import HeightMap
from tests.detailed.instances import (
    AHEAD_ONLY,
    FIXED_WHEELS,
    NIMBLE,
    SHORT_ARCS,
    WIDE_ARCS,
    blocky,
    successor_arrays,
    toy,
    valid_states,
)
from tests.naive import Naive, dijkstra

ROBOTS = NIMBLE, toy(base_shift={"backward": False}), FIXED_WHEELS, AHEAD_ONLY, WIDE_ARCS, SHORT_ARCS
MEMORY = 1 << 28
#: The detailed search adds costs in single precision, the textbook search does not.
NEARLY = 1 + 1e-9


def grid(world, goals, memory=MEMORY):
    goals = np.atleast_2d(goals)
    regions = find_foothold_regions(world, Rules(), least_foot_cost(world))
    e = grid_estimate(world, goals, np.arange(len(goals)), memory)
    return with_step_efforts(e, regions.region, efforts_to(regions, world, goals))


def asked(e, world, states):
    return final_estimates(world, e, pack_states(states, world.tables.lowest))


def scene(seed, cells=9):
    """A small world, its twin, and the graph of all states in reach of a random state."""
    rng = np.random.default_rng(seed)
    robot = ROBOTS[seed % len(ROBOTS)]
    heights = blocky(rng, cells)
    twin = Naive(heights, robot)
    states = valid_states(twin, rng, 12, neutral=False) + valid_states(twin, rng, 12)
    return build_world(HeightMap(heights), robot), twin, states, rng


@pytest.mark.parametrize("seed", range(15))
def test_grid_heuristic_never_exceeds_the_exact_cost(seed):
    world, twin, states, rng = scene(seed)
    asked_for = 0
    for start in states:
        gone = dijkstra(twin, start, most=300)
        reached = list(gone.cost)
        for goal in [reached[i] for i in rng.permutation(len(reached))[:40]]:
            e = grid(world, goal)
            assert asked(e, world, [start])[0] <= gone.cost[goal] * NEARLY
            assert asked(e, world, [goal])[0] == pytest.approx(0, abs=1e-6)
            asked_for += 1
        if asked_for >= 80:
            return
    raise AssertionError("few instances")


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(1000, 10_000), memory=st.sampled_from([MEMORY, 1]))
def test_grid_heuristic_is_consistent_along_every_action_within_any_memory(seed, memory):
    world, _, states, rng = scene(seed)
    assume(states)
    goals = np.array([states[i] for i in rng.permutation(len(states))[:3]])
    e = grid(world, goals, memory)
    for state in states:
        keys, prices, _ = successor_arrays(world, state)
        here = asked(e, world, [state])[0]
        there = final_estimates(world, e, keys)
        assert (here <= prices + there + 1e-5).all()
    assert e.back.counts[USED] <= len(e.back.where)
    assert memory > 1 or e.back.counts[FULL] or e.back.counts[USED] <= 2


@pytest.mark.parametrize("seed", range(6))
def test_final_estimates_do_not_depend_on_the_order_of_questions(seed):
    world, _, states, rng = scene(seed)
    one, other = grid(world, states[-1]), grid(world, states[-1])
    asked(one, world, states[:1]), asked(other, world, states[:1])  # the first state is the start of the search
    order = rng.permutation(len(states))
    assert np.array_equal(asked(one, world, states)[order], asked(other, world, np.array(states)[order]))


@pytest.mark.parametrize("seed", range(2))
def test_search_with_the_grid_heuristic_finds_the_optimum(seed):
    world, twin, states, rng = scene(seed)
    gone = dijkstra(twin, states[0], most=300)
    for goal in [list(gone.cost)[i] for i in rng.permutation(len(gone.cost))[:8]]:
        result = solve(world, np.array(states[0]), np.array([goal]), grid(world, goal))
        assert result.cost[0] == pytest.approx(gone.cost[goal], rel=1e-5, abs=1e-6)
