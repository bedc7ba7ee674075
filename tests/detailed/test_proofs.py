"""Proofs of unreachable goals: found where expected, and never for a reachable goal."""

import math
import time

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hdsp.base.gradual import finished
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.relaxed.heading_masks import PoseFlood, holds
from hdsp.detailed.relaxed.proofs import FOOT, POSE, why_unreachable
from hdsp.detailed.search.estimate import geometric_estimate
from hdsp.detailed.search.outcome import Limits, Status
from hdsp.detailed.search.weighted_astar import solve
from hdsp.detailed.world.world import build_world
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import CATEGORIES, random_map
from tests.detailed.instances import TOY, blocky, near_edges, toy, valid_states
from tests.naive import Naive, dijkstra

MOMARO = Robot.load("momaro")


@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    seed=st.integers(0, 10_000),
    backward=st.booleans(),
    sideways=st.booleans(),
    arcs=st.sampled_from([{}, {"on_the_spot": False, "radius": 0.3}]),
    window=st.sampled_from([2, 64]),
    neutral=st.booleans(),
)
def test_what_the_twin_reaches_is_never_called_unreachable(seed, backward, sideways, arcs, window, neutral):
    rng = np.random.default_rng(seed)
    heights = blocky(rng, cells=10)
    behind = TOY["drive"]["deviation_cost"]["behind"] if backward else math.inf
    drive = {"sideways": sideways, "deviation_cost": {**TOY["drive"]["deviation_cost"], "behind": behind}}
    robot = toy(base_shift={"backward": backward}, step={"backward": backward}, drive=drive, turn=arcs)
    states = valid_states(Naive(heights, robot), rng, 20, neutral=neutral)
    if not states:
        return
    start = (near_edges(Naive(heights, robot), states) + states)[0]
    twin = Naive(heights, robot, center=start[2], window=window)
    world, rules = build_world(HeightMap(heights), robot), Rules(start[2], window)
    for goal in list(dijkstra(twin, start, most=150).cost)[::7]:
        assert why_unreachable(world, np.array(start), np.array(goal), rules) is None


@pytest.mark.parametrize("category", CATEGORIES)
def test_proofs_agree_with_searches_to_the_end(category):
    rng = np.random.default_rng(1)
    for index in range(3):
        world, rules = build_world(random_map(5, category, index), MOMARO), Rules(0, 2)
        twin = Naive(world_heights(world), MOMARO)
        states = np.array(valid_states(twin, rng, 4, headings=[0, 1, 63]))
        for start, goal in zip(states, np.roll(states, 1, axis=0), strict=True):
            if why_unreachable(world, start, goal, rules) is not None:
                limits = Limits(expansions=50_000)
                found = solve(world, start, goal, geometric_estimate(world, goal), rules=rules, limits=limits)
                assert found.status[0] in (Status.INFEASIBLE, Status.EXPANSION_LIMIT)


def test_a_flood_toward_goals_ends_at_the_first_one_in_reach_and_else_reaches_all_it_can():
    rng, ended = np.random.default_rng(2), set()
    for category in CATEGORIES:
        world = build_world(random_map(5, category, 1), MOMARO)
        states = np.array(valid_states(Naive(world_heights(world), MOMARO), rng, 8, headings=range(0, 64, 8)))
        for start, goals in ((states[0], states[k : k + 2]) for k in range(1, len(states))):
            everywhere = PoseFlood(world, Rules()).reached_from(start, False)
            toward = finished(PoseFlood(world, Rules()).steps_from(start, False, goals))
            assert holds(toward, goals) == holds(everywhere, goals)
            assert (toward & ~everywhere == 0).all()
            assert holds(toward, goals) or (toward == everywhere).all()
            ended.add((holds(toward, goals), bool((toward == everywhere).all())))
    assert ended == {(True, False), (False, True)}


def world_heights(world):
    inner = slice(world.pad, world.pad + world.nx), slice(world.pad, world.pad + world.ny)
    return world.height.reshape(-1, world.stride)[inner]


def walled(opening: float, height: float, cells: int = 160) -> HeightMap:
    """A floor with a wall across its middle; the wall has an opening of a given width (m)."""
    heights = np.zeros((cells, cells), np.float32)
    wide = round(opening / 0.025)
    heights[79:81] = height
    heights[79:81, 60 : 60 + wide] = 0
    return HeightMap(heights)


def ends(terrain):
    return build_world(terrain, MOMARO), np.array([35, 70, 0, 0, 0, 0, 0]), np.array([120, 70, 0, 0, 0, 0, 0])


def test_a_door_that_is_too_narrow_is_named_with_what_the_body_hits():
    world, start, goal = ends(walled(0.5, 1.0))
    proof = why_unreachable(world, start, goal)
    assert proof.proof == POSE and proof.foot == -1
    assert proof.from_start[0] < 79 < 81 <= proof.from_goal[0]
    assert 55 <= proof.from_start[1] <= 85  # in front of the door, not elsewhere along the wall
    assert len(proof.blocked) == proof.from_goal[0] - proof.from_start[0] - 1
    assert len(proof.body_hits) and (world_heights(world)[tuple(proof.body_hits.T)] == 1).all()


def test_a_door_that_is_wide_enough_is_no_obstacle():
    assert why_unreachable(*ends(walled(0.8, 1.0))) is None


def test_a_bar_that_is_too_high_stops_a_foot_and_a_lower_one_does_not():
    world, start, goal = ends(walled(0.0, 0.37))
    proof = why_unreachable(world, start, goal)
    assert proof.proof == FOOT and proof.footless == (proof.foot,)
    assert proof.from_start[0] < 79 and proof.from_goal[0] >= 81
    assert why_unreachable(*ends(walled(0.0, 0.15))) is None


def test_a_large_map_takes_seconds_at_most():
    terrain = walled(0.5, 1.0, cells=400)
    world, start, goal = ends(terrain)
    why_unreachable(world, start, goal)  # compile
    began = time.perf_counter()
    assert why_unreachable(build_world(terrain, MOMARO), start, goal) is not None
    assert time.perf_counter() - began < 10
