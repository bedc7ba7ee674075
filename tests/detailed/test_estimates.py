"""The estimates of the search kernels against true costs."""

import heapq

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from hdsp.detailed.actions import Rules
from hdsp.detailed.estimate import estimate, geometric_estimate, least_foot_cost, pose_estimate, with_footing
from hdsp.detailed.footing import efforts_to, find_footing
from hdsp.detailed.relaxed import _least_edge, _neighbour, pose_costs, pose_distances
from hdsp.detailed.states import pack_states, unpack_states
from hdsp.detailed.world import build_world
from hdsp.heightmap import HeightMap
from hdsp.lattice import HEADINGS
from hdsp.robot import Robot
from hdsp.terrain import CATEGORIES, random_map
from tests.detailed.instances import blocky, near_edges, successor_arrays, toy, valid_states
from tests.naive import Naive, dijkstra

costs = st.floats(0.01, 3.0)


@st.composite
def robots(draw):
    """Toy robots with all costs drawn."""
    ahead = draw(st.floats(0.3, 2.0))
    return toy(
        drive={
            "unevenness_cost": draw(st.floats(0.01, 1.0)),
            "deviation_cost": {
                "ahead": ahead, "side": draw(st.floats(0.3, 4.0)), "behind": draw(st.floats(0.3, 4.0)),
                "side_from": 0.785, "side_to": 2.356,
            },
        },
        turn={"cost": draw(st.floats(0.001, 0.2))},
        foot_move={"cost_per_metre": draw(costs)},
        base_shift={"cost_per_metre": draw(costs)},
        step={"cost": draw(st.floats(0.0, 0.1)), "cost_per_metre": draw(costs), "cost_per_height": draw(costs)},
    )  # fmt: skip


def estimates(parameters, world, states):
    return np.array([estimate(parameters, key) for key in pack_states(states, world.tables.lowest)])


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
@given(robot=robots(), seed=st.integers(0, 10_000))
def test_relaxed_poses_feet_and_steps_never_exceed_the_true_cost(robot, seed):
    world, twin, states = scene(robot, seed)
    rules = Rules()
    relaxed, footing = pose_costs(world, rules), find_footing(world, rules, least_foot_cost(world))
    true = dijkstra(twin, states[0], most=80).cost
    reach = pose_distances(world, rules, relaxed, np.array([states[0][:3]]), np.zeros(1), False, np.inf)
    for goal, cost in list(true.items())[::13]:
        assert reach[goal[2], goal[0], goal[1]] <= cost * (1 + 1e-5) + 1e-6
        to_go = pose_distances(world, rules, relaxed, np.array([goal[:3]]), np.zeros(1), True, np.inf)
        parameters = pose_estimate(world, to_go, np.array([goal[3:]]))
        parameters = with_footing(parameters, footing, efforts_to(footing, world, np.array([goal])))
        assert estimates(parameters, world, [states[0]])[0] <= cost * (1 + 1e-5) + 1e-6
        assert estimates(parameters, world, [goal])[0] == 0


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    robot=robots(), seed=st.integers(0, 10_000), factor=st.sampled_from([0.4, 1.0, 1.6]), backward=st.booleans(),
    limit=st.sampled_from([0.3, np.inf]),
)  # fmt: skip
def test_relaxed_distances_equal_a_plain_dijkstra_over_poses(robot, seed, factor, backward, limit):
    world, _, states = scene(robot, seed)
    rules = Rules(heading_center=states[0][2], heading_window=3, turn_cost_factor=factor)
    relaxed = pose_costs(world, rules)
    source = states[0][:3]
    found = pose_distances(world, rules, relaxed, np.array([source]), np.zeros(1), backward, limit)
    expected = plain_pose_distances(world, rules, relaxed, source, backward)
    expected[expected > limit] = np.inf
    assert np.allclose(found, expected, rtol=1e-5, atol=1e-6)


def plain_pose_distances(world, rules, relaxed, source, backward):
    distance = np.full((HEADINGS, world.nx, world.ny), np.inf)
    queue, settled = [(0.0, source)], set()
    while queue:
        cost, (x, y, h) = heapq.heappop(queue)
        if (x, y, h) in settled:
            continue
        settled.add((x, y, h))
        distance[h, x, y] = cost
        for action in range(24):
            kind, other, nx, ny = _neighbour(world.tables, h, x, y, action, backward)
            if not (0 <= nx < world.nx and 0 <= ny < world.ny) or np.isinf(relaxed[other, nx, ny]):
                continue
            ends = [relaxed[h, x, y], relaxed[other, nx, ny]]
            if backward:
                ends.reverse()
            heapq.heappush(queue, (cost + _least_edge(world, rules, h, kind, *ends), (nx, ny, other)))
    return distance
