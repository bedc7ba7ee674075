"""Estimates in the search kernels against true costs."""

import heapq
import math

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.relaxed.foothold_regions import efforts_to, find_foothold_regions
from hdsp.detailed.relaxed.relaxed_costs import costs_to_go, explore, least_costs
from hdsp.detailed.search.estimate import (
    estimate,
    geometric_estimate,
    least_foot_cost,
    pose_estimate,
    with_step_efforts,
)
from hdsp.detailed.states import pack_states, unpack_states
from hdsp.detailed.world.world import build_world
from hdsp.robot.lattice import HEADINGS
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import CATEGORIES, random_map
from tests.detailed.instances import blocky, near_edges, successor_arrays, toy, valid_states
from tests.naive import Naive, dijkstra
from tests.naive_ground import turned
from tests.naive_relaxed import relaxed_edges

costs = st.floats(0.01, 3.0)
ways_to_turn = st.sampled_from([{}, {}, {"on_the_spot": False, "radius": 0.3}, {"on_the_spot": False, "radius": 0.8}])


@st.composite
def robots(draw):
    """Toy robots with random costs."""
    ahead = draw(st.floats(0.3, 2.0))
    factors = st.floats(0.3, 4.0) | st.sampled_from([25.0, math.inf])
    return toy(
        drive={
            "unevenness_cost": draw(st.floats(0.01, 1.0)),
            "deviation_cost": {
                "ahead": ahead, "side": draw(factors), "behind": draw(factors), "side_from": 0.785, "side_to": 2.356,
            },
            "sideways": draw(st.booleans()),
        },
        turn={"cost": draw(st.floats(0.001, 0.2)), **draw(ways_to_turn)},
        foot_move={"cost_per_metre": draw(costs)},
        base_shift={"cost_per_metre": draw(costs), "backward": draw(st.booleans())},
        step={
            "backward": draw(st.booleans()), "cost": draw(st.floats(0.0, 0.1)), "cost_per_metre": draw(costs),
            "cost_per_height": draw(costs),
        },
    )  # fmt: skip


def estimates(parameters, world, states):
    return np.array([estimate(world, parameters, key) for key in pack_states(states, world.tables.lowest)])


def scene(robot, seed):
    rng = np.random.default_rng(seed)
    heights = blocky(rng, cells=10)
    world, twin = build_world(HeightMap(heights), robot), Naive(heights, robot)
    states = valid_states(twin, rng, 30, neutral=bool(seed % 2))
    states = (near_edges(twin, states) + states)[:4]
    assume(len(states) >= 2)
    return world, twin, states


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(robot=robots(), seed=st.integers(0, 10_000))
def test_geometric_heuristic_never_exceeds_the_true_cost(robot, seed):
    world, twin, states = scene(robot, seed)
    true = dijkstra(twin, states[0], most=80).cost
    for goal, cost in true.items():
        parameters = geometric_estimate(world, np.array(goal))
        assert estimates(parameters, world, [states[0]])[0] <= cost * (1 + 1e-9) + 1e-12
        assert estimates(parameters, world, [states[0]])[0] == pytest.approx(twin.geometric(states[0], goal), abs=1e-9)


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(robot=robots(), seed=st.integers(0, 10_000))
def test_geometric_heuristic_is_consistent_along_every_edge(robot, seed):
    world, _, states = scene(robot, seed)
    parameters = geometric_estimate(world, np.array(states[-1]))
    assert estimates(parameters, world, [states[-1]])[0] == 0
    for state in states:
        keys, prices, _ = successor_arrays(world, state)
        here = estimates(parameters, world, [state])[0]
        there = estimates(parameters, world, unpack_states(keys, world.tables.lowest))
        assert (here <= prices + there + 1e-12).all()


@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
@given(robot=robots(), seed=st.integers(0, 10_000))
def test_geometric_heuristic_of_several_goals_is_consistent_and_zero_at_each(robot, seed):
    world, twin, states = scene(robot, seed)
    goals, groups = np.array(states[1:]), np.arange(len(states) - 1) // 2
    parameters = geometric_estimate(world, goals, groups)
    discs = [(*disc.tolist(), radius) for disc, radius in zip(parameters.discs, parameters.radius, strict=True)]
    for (x, y, heading, slack, radius), group in zip(discs, range(groups.max() + 1), strict=True):
        for goal in goals[groups == group].tolist():
            assert math.hypot(goal[0] - x, goal[1] - y) <= radius + 1e-9 and turned(goal[2], heading) <= slack
    assert (estimates(parameters, world, goals) == 0).all()
    for state in states:
        keys, prices, _ = successor_arrays(world, state)
        here = estimates(parameters, world, [state])[0]
        assert here == pytest.approx(twin.geometric_to_nearest(state, goals.tolist(), discs), abs=1e-9)
        there = estimates(parameters, world, unpack_states(keys, world.tables.lowest))
        assert (here <= prices + there + 1e-12).all()


@pytest.mark.parametrize("category", CATEGORIES[::2])
def test_geometric_heuristic_of_momaro_is_consistent(category):
    heights, rng = random_map(4, category, 1).heights, np.random.default_rng(0)
    robot = Robot.load("momaro")
    world, twin = build_world(HeightMap(heights), robot), Naive(heights, robot)
    states = valid_states(twin, rng, 6, neutral=False)
    parameters = geometric_estimate(world, np.array(states[0]))
    for state in states:
        keys, prices, _ = successor_arrays(world, state)
        there = estimates(parameters, world, unpack_states(keys, world.tables.lowest))
        assert (estimates(parameters, world, [state])[0] <= prices + there + 1e-12).all()


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(robot=robots(), seed=st.integers(0, 10_000), limit=st.sampled_from([0.3, 9.0]))
def test_relaxed_costs_feet_and_steps_never_exceed_the_true_cost(robot, seed, limit):
    world, twin, states = scene(robot, seed)
    rules, start = Rules(), np.array(states[0])
    regions, relaxed = find_foothold_regions(world, rules, least_foot_cost(world)), explore(world, rules, start, limit)
    true = {state: cost for state, cost in dijkstra(twin, states[0], most=80).cost.items() if cost <= limit}
    goals = np.array(list(true))
    least = least_costs(world, relaxed, start, goals)
    assert (least <= np.array(list(true.values())) * (1 + 1e-5) + 1e-6).all()
    for goal in goals[::13]:
        parameters = relaxed_estimate(world, rules, relaxed, start, goal[None], limit)
        parameters = with_step_efforts(parameters, regions.region, efforts_to(regions, world, goal[None]))
        assert estimates(parameters, world, [start])[0] <= true[tuple(goal.tolist())] * (1 + 1e-5) + 1e-6
        assert estimates(parameters, world, [goal])[0] == pytest.approx(0, abs=1e-6)


def relaxed_estimate(world, rules, relaxed, start, goals, limit):
    table, _ = costs_to_go(world, rules, relaxed, start, goals, np.zeros(len(goals)), limit)
    return pose_estimate(world, table, relaxed.follow, goals[:, 3:])


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(robot=robots(), seed=st.integers(0, 10_000))
def test_the_relaxed_heuristic_is_consistent_along_every_edge(robot, seed):
    world, twin, states = scene(robot, seed)
    rules, start = Rules(), np.array(states[0])
    relaxed = explore(world, rules, start, 20.0)
    regions = find_foothold_regions(world, rules, least_foot_cost(world))
    reached = list(dijkstra(twin, states[0], most=60).cost)
    goals = np.array(reached[-3:])
    parameters = relaxed_estimate(world, rules, relaxed, start, goals, 20.0)
    parameters = with_step_efforts(parameters, regions.region, efforts_to(regions, world, goals))
    for state in reached[::4]:
        keys, prices, _ = successor_arrays(world, state)
        here = estimates(parameters, world, [state])[0]
        there = estimates(parameters, world, unpack_states(keys, world.tables.lowest))
        assert (here <= prices + there + 1e-5).all()


@settings(max_examples=10, deadline=None, suppress_health_check=list(HealthCheck))
@given(robot=robots(), seed=st.integers(0, 10_000), factor=st.sampled_from([0.4, 1.0, 1.6]))
def test_relaxed_distances_equal_a_plain_dijkstra(robot, seed, factor):
    world, twin, states = scene(robot, seed)
    start = states[0]
    rules = Rules(heading_center=start[2], heading_window=1, turn_cost_factor=factor)
    twin = Naive(twin.heights, robot, start[2], 1, factor, drive_only=True)
    relaxed = explore(world, rules, np.array(start), 100.0)
    expected = plain_relaxed_distances(twin, start, relaxed.follow)
    assert not relaxed.cut
    assert np.isfinite(relaxed.distance).sum() == len(expected)
    for (layer, x, y, heading), cost in expected.items():
        pose = ((heading - relaxed.poses.first) % HEADINGS * world.nx + x) * world.ny + y
        assert relaxed.distance[layer, pose] == pytest.approx(cost, rel=1e-5, abs=1e-6)
    for goal in [key for key in expected if key[0] == 0][::7]:
        state = np.array([[*goal[1:], 0, 0, 0, 0]])
        back, _ = costs_to_go(world, rules, relaxed, np.array(start), state, np.zeros(1), 100.0)
        home = relaxed.follow * 4 * -world.tables.lowest
        layer = int(any(start[3:]))
        assert back[layer, start[2], start[0], start[1]] - home == pytest.approx(expected[goal], rel=1e-5, abs=1e-6)


def plain_relaxed_distances(twin, start, follow):
    """{(layer, x, y, heading): cost} according to the documentation of `hdsp.detailed.relaxed.relaxed_costs`."""
    settled, queue = {}, [(0.0, (int(any(start[3:])), *start[:3]))]
    while queue:
        cost, node = heapq.heappop(queue)
        if node not in settled:
            settled[node] = cost
            for reached, step in relaxed_edges(twin, follow, node):
                heapq.heappush(queue, (cost + step, reached))
    return settled
