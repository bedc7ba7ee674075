"""The start of a plan: ground under the robot that the map does not show, poses that the robot cannot leave."""

import heapq
import math
import tracemalloc

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from hdsp import HeightMap, InputError, Planner, Status
from hdsp.detailed.search.leaving import leave
from hdsp.detailed.world.world import build_world
from hdsp.planning.ends import nearby
from hdsp.planning.ends.nearby import can_leave, length_of
from hdsp.robot.lattice import HEADINGS, RESOLUTION, Grid, cells, heading_angle
from tests.detailed.instances import NIMBLE, blocky, valid_states
from tests.naive import Naive

START, GOAL = (1.0, 2.0, 0.0), (3.2, 2.0, 0.0)


def flat(cells_x=160, cells_y=160):
    return np.zeros((cells_x, cells_y), np.float32)


def disc(heights, pose, radius):
    x, y = np.meshgrid(*((np.arange(n) + 0.5) * RESOLUTION for n in heights.shape), indexing="ij")
    return np.hypot(x - pose[0], y - pose[1]) < radius


def rectangle(heights, pose, length, width):
    """Cells in a rectangle around a pose along its heading."""
    x, y = np.meshgrid(*((np.arange(n) + 0.5) * RESOLUTION for n in heights.shape), indexing="ij")
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    ahead, left = (x - pose[0]) * cos + (y - pose[1]) * sin, (y - pose[1]) * cos - (x - pose[0]) * sin
    return (abs(ahead) <= length / 2) & (abs(left) <= width / 2)


def planner(heights, heuristic="geometric"):
    return Planner(HeightMap(heights), heuristic=heuristic, conditioning=None)


@pytest.mark.parametrize("heuristic", [pytest.param("geometric", marks=pytest.mark.nightly), "manual"])
@pytest.mark.parametrize("radius", [0.1, 0.25, 0.35])
@pytest.mark.parametrize("heading", [0.0, 0.7])
def test_m4_a_hole_under_the_robot_is_ground(heuristic, radius, heading):
    heights, start = flat(), (*START[:2], heading)
    heights[disc(heights, start, radius)] = np.nan
    those = planner(heights, heuristic)
    world, wanted = those.world, planner(flat()).plan(start, GOAL)
    plan = those.plan(start, GOAL)
    assert plan.cost == pytest.approx(wanted.cost, rel=0.03 if heuristic == "manual" else 1e-9)
    assert "unknown ground under the robot" in plan.assumed[0] and plan.assumed[0] in plan.explain()
    assert len(plan.refine().base) > 0
    assert those.world is world and np.isnan(those.terrain.heights).sum() == np.isnan(heights).sum()
    assert those.plan(start, GOAL, start_free=False).status == Status.INVALID_START
    *_, last = those.improve(start, GOAL)
    assert last.cost <= plan.cost + 1e-6 and last.bound == 1 and last.assumed == plan.assumed
    anchored = those.plan(start, GOAL, anchor_weight=1.5)
    assert last.cost - 1e-6 <= anchored.cost <= anchored.bound * last.cost + 1e-6


@pytest.mark.parametrize("heading", [0.0, 0.7, -2.0])
@pytest.mark.parametrize("length, width, height", [(0.75, 0.5, 0.8), (0.4, 0.3, 0.9), (0.875, 0.575, 0.3)])
def test_m4_the_robot_in_its_own_map_is_no_obstacle(heading, length, width, height):
    heights, start = flat(), (*START[:2], heading)
    heights[rectangle(heights, start, length, width)] = height
    plan = planner(heights).plan(start, GOAL)
    assert plan.cost == pytest.approx(planner(flat()).plan(start, GOAL).cost)
    assert f"up to {height:.2f} m high, are taken as the robot" in plan.assumed[0]
    assert np.isclose(plan.terrain.heights, 0, atol=1e-6).all() and plan.refine() is not None


def test_m4_hole_and_body_on_a_slope_become_the_slope():
    heights = flat()
    slope = (np.arange(160)[:, None] * RESOLUTION * 0.15 + heights).astype(np.float32)
    heights[:] = slope
    heights[disc(heights, START, 0.35)] = np.nan
    heights[rectangle(heights, START, 0.3, 0.2)] = 1.2
    plan = planner(heights).plan(START, GOAL)
    assert plan.solved and len(plan.assumed) == 2
    np.testing.assert_allclose(plan.terrain.heights, slope, atol=1e-5)


def test_m4_displaced_feet_stand_on_their_own_ground():
    heights = flat()
    state = (*START, 0.1, 0.0, -0.1, 0.0)
    feet = Planner(HeightMap(flat())).robot.foot_positions(np.array(state))
    for foot in feet:
        heights[disc(heights, foot, 0.05)] = np.nan
    plan = planner(heights).plan(state, GOAL)
    assert plan.solved and plan.assumed
    np.testing.assert_allclose(plan.states[0], planner(flat()).plan(state, GOAL).states[0])


def test_m4_only_the_ground_under_the_robot_changes_and_only_where_needed():
    heights = flat()
    heights[disc(heights, START, 0.6)] = np.nan
    plan = planner(heights).plan(START, GOAL)
    changed = np.isnan(heights) & np.isfinite(plan.terrain.heights)
    assert plan.status == Status.INFEASIBLE and changed.any()
    assert not (changed & ~rectangle(heights, START, 1.15, 0.9)).any()
    beside = flat()
    beside[disc(beside, (2.0, 1.0), 0.3)] = np.nan
    plan = planner(beside).plan(START, GOAL)
    assert (plan.assumed == () and plan.terrain.heights is planner(beside).terrain.heights) or plan.solved


@pytest.mark.parametrize("part", [np.s_[35:40, :], np.s_[20:60, 78:160], np.s_[33:47, 60:100]])
def test_m4_an_object_that_continues_beyond_the_robot_is_not_the_robot(part):
    heights = flat()
    heights[part] = 0.8
    heights[disc(heights, START, 0.1)] = np.nan
    plan = planner(heights).plan(START, GOAL)
    assert plan.status == Status.INVALID_START and plan.assumed == ()
    assert "0.80 m" in plan.explain() or "an edge" in plan.explain()


@pytest.mark.parametrize("left, side, height", [(0.34, 0.05, 0.9), (0.22, 0.1, 0.2), (0.22, 0.1, 0.28)])
def test_m4_a_low_object_under_the_robot_or_one_beside_it_is_not_the_robot(left, side, height):
    heights = flat()
    heights[rectangle(heights, (START[0] + 0.3, START[1] + left, 0.0), side, side)] = height
    plan = planner(heights).plan((*START, 0.0, 0.0, 0.0, 0.0), GOAL)
    assert plan.assumed == () and plan.status == Status.INVALID_START


def test_m4_on_a_map_without_any_ground_nothing_stands():
    assert planner(np.full((160, 160), np.nan, np.float32)).plan(START, GOAL).status == Status.INVALID_START
    with pytest.raises(InputError, match="start_free"):
        planner(flat()).plan(START, GOAL, start_free="yes")


def leaves(twin, start, distance):
    """Whether any reachable state lies at a distance (cells); the farthest states first."""
    seen, waiting = {start}, [(0.0, start)]
    while waiting:
        _, state = heapq.heappop(waiting)
        for _, reached, _ in twin.successors(state):
            if reached in seen:
                continue
            away = math.hypot(reached[0] - start[0], reached[1] - start[1])
            if away >= distance:
                return True
            seen.add(reached)
            heapq.heappush(waiting, (-away, reached))
    return False


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 10_000), neutral=st.booleans())
def test_q1_the_robot_can_leave_where_an_exhaustive_search_gets_away(seed, neutral):
    rng = np.random.default_rng(seed)
    heights = blocky(rng, cells=12, blocks=4, height=0.3)
    twin, world = Naive(heights, NIMBLE), build_world(HeightMap(heights), NIMBLE)
    states = valid_states(twin, rng, 3, neutral=neutral)
    assume(states)
    for state in states:
        distance = cells(length_of(NIMBLE))
        assert can_leave(world, NIMBLE, np.array(state)) == leaves(twin, tuple(state), distance)
        seen = leave(world, np.array(state), distance)
        assert seen is None or (np.hypot(*(seen[:, :2] - state[:2]).T) < distance).all()


def test_q1_standing_and_leaving_are_told_apart():
    free = planner(flat(100, 100))
    assert free.valid((1.25, 1.25, 0.0)) and free.can_leave((1.25, 1.25, 0.0))
    boxed = flat(100, 100)
    boxed[28:72, 31:33] = boxed[28:72, 67:69] = boxed[28:30, 31:69] = boxed[70:72, 31:69] = 1.0
    inside = planner(boxed)
    assert inside.valid((1.25, 1.25, 0.0)) and not inside.can_leave((1.25, 1.25, 0.0))
    assert not inside.valid((0.8, 0.9, 0.0)) and not inside.can_leave((0.8, 0.9, 0.0))


def test_q1_the_nearest_pose_is_the_first_that_stands_and_leaves():
    heights = flat(120, 120)
    heights[60:] = 1.0
    those = planner(heights)
    asked = (1.4, 1.5, 0.0)
    state = those.nearest(asked)
    assert not those.valid(asked) and those.can_leave(state)
    away = np.hypot(*(state[:2] - asked[:2])) + 0.3 * abs(state[2])
    for x in np.arange(0.7, 1.5, RESOLUTION):
        for heading in (-0.4, 0.0, 0.4, math.pi / 2):
            if np.hypot(x - asked[0], 0) + 0.3 * abs(heading) < away - 0.03:
                assert not those.can_leave((x, 1.5, heading))
    turned = those.nearest((*asked[:2], None))
    assert np.hypot(*(turned[:2] - asked[:2])) < np.hypot(*(state[:2] - asked[:2])) - 0.05
    assert those.plan(state, (0.6, 1.5, 0.0)).solved
    assert those.nearest((2.5, 1.5, 0.0), radius=0.2) is not None  # on the plateau
    assert planner(np.full((60, 60), np.nan, np.float32)).nearest((0.7, 0.7, 0.0)) is None
    with pytest.raises(InputError, match="radius"):
        those.nearest(asked, radius=-1)


def poses_within(grid, pose, heading_free, radius, per_radian):
    """All base poses within a distance at once, and their distances, the nearest first."""
    at = np.stack(np.indices(grid.shape), axis=-1).reshape(-1, 2)
    away = np.hypot(*(grid.center(at) - pose[:2]).T)
    turned = abs(np.mod(heading_angle(np.arange(HEADINGS)) - pose[2] + math.pi, 2 * math.pi) - math.pi)
    distance = away[:, None] + (0.0 if heading_free else per_radian) * turned
    cell, heading = np.nonzero(distance <= radius + 1e-9)
    order = np.lexsort((turned[heading], distance[cell, heading]))
    return np.column_stack([at[cell], heading])[order], distance[cell, heading][order]


@settings(max_examples=40, deadline=None)
@given(
    shape=st.tuples(st.integers(1, 30), st.integers(1, 30)),
    place=st.tuples(st.floats(0, 0.999), st.floats(0, 0.999), st.floats(-3.2, 3.2) | st.just(0.0)),
    free=st.booleans(),
    radius=st.sampled_from([0.0, 0.03, 0.2, 0.5, 3.0, 1e308]),
    per_radian=st.sampled_from([0.0, 0.05, 0.3, 2.0, 1e6]),
    centred=st.booleans(),
    first=st.sampled_from([0.01, 0.1, 1.1]),
)
def test_poses_from_near_to_far_are_all_poses_in_order(shape, place, free, radius, per_radian, centred, first):
    grid = Grid((412345.678, -2.0), shape)
    xy = np.array(grid.origin) + np.array(shape) * RESOLUTION * place[:2]
    pose = np.array([*(grid.center(grid.cell(xy)) if centred else xy), place[2]])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(nearby, "_FIRST_DISC", first)
        blocks = list(nearby._poses_outward(grid, pose, free, radius, per_radian))
    bases, distance = poses_within(grid, pose, free, radius, per_radian)
    np.testing.assert_array_equal(np.concatenate([np.empty((0, 3)), *(each[0] for each in blocks)]), bases)
    np.testing.assert_array_equal(np.concatenate([[], *(each[1] for each in blocks)]), distance)
    assert all(len(each[0]) <= 512 for each in blocks)


def test_the_nearest_of_many_poses_takes_little_memory():
    grid, pose = Grid((0.0, 0.0), (2000, 2000)), np.array([25.01, 25.01, 0.0])
    tracemalloc.start()
    bases, _ = next(nearby._poses_outward(grid, pose, False, 1e308, 0.3))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert bases[0].tolist() == [1000, 1000, 0] and most < 10e6


def test_q1_an_invalid_end_names_the_nearest_pose_that_works():
    heights = flat(120, 120)
    heights[60:] = 1.0
    those, inside = planner(heights), (0.7, 1.5, 0.0)
    for plan in (those.plan((1.4, 1.5, 0.0), inside), those.plan(inside, (1.4, 1.5, 0.0))):
        x, y = those.nearest((1.4, 1.5, 0.0))[:2]
        assert f"the nearest pose that works is ({x:.2f}, {y:.2f}) m" in plan.explain()
    nowhere = planner(np.full((60, 60), np.nan, np.float32)).plan((0.7, 0.7, 0.0), (0.8, 0.7, 0.0))
    assert "no pose within 1 m works either" in nowhere.explain()


def edge_distances(heights, those, states):
    """Distance (m) from the nearest foot to the nearest cell beside an edge, at each state."""
    edges = np.zeros(heights.shape, bool)
    steps = abs(np.diff(heights, axis=0)) > those.robot.drive.highest_edge
    edges[:-1] |= steps
    edges[1:] |= steps
    at = those.grid.center(np.argwhere(edges))
    feet = those.robot.foot_positions(states)
    return np.hypot(*(feet[:, :, None] - at).transpose(3, 0, 1, 2)).min(axis=(1, 2))


@pytest.mark.parametrize("gap, heading, free", [(0.03, 0.0, True), (0.06, 0.3, False), (0.09, math.pi, True)])
def test_m4_a_robot_too_near_to_an_edge_drives_away_from_it_first(gap, heading, free):
    heights = flat()
    heights[60:] = 0.15
    those, goal = planner(heights), (0.9, 1.7, heading)
    ahead = those.robot.foot_positions(np.array([0, 0, heading, 0, 0, 0, 0]))[:, 0].max()
    start = (1.5 - gap - ahead - RESOLUTION / 2, 2.0, heading)
    asked = (*start, 0.0, 0.0, 0.0, 0.0)
    assert those.plan(asked, goal, start_free=free).status == Status.INVALID_START
    plan = those.plan(asked, goal, start_free=free, way_out=True)
    assert plan.solved and plan.way_out > 0 and f"the first {plan.way_out} actions lead out" in plan.explain()
    np.testing.assert_allclose(plan.states[0][:2], asked[:2], atol=RESOLUTION)
    assert plan.action_costs.sum() == pytest.approx(plan.cost) and len(plan.actions) == len(plan.states) - 1
    away = edge_distances(heights, those, plan.states[: plan.way_out + 1])
    assert (np.diff(away) >= -1e-9).all() and away[0] < those.robot.feet.clearance <= away[-1] + 1e-9
    assert those.can_leave(plan.states[plan.way_out]) and not those.valid(plan.states[plan.way_out - 1])
    assert len(plan.refine().base) > len(plan.actions)
    *_, last = those.improve(asked, goal, start_free=free, way_out=True)
    assert last.way_out == plan.way_out and last.cost == pytest.approx(plan.cost)


def test_m4_a_body_within_its_margin_drives_away_and_a_body_in_a_wall_does_not():
    heights = flat()
    heights[:, 96:] = 1.0  # 0.4 m beside the base
    those = Planner(HeightMap(heights), margin=0.15, conditioning=None)
    plan = those.plan((1.5, 2.0, 0.0), (2.5, 1.0, 0.0), way_out=True)
    assert those.plan((1.5, 2.0, 0.0), (2.5, 1.0, 0.0)).status == Status.INVALID_START
    assert plan.solved and plan.way_out > 0 and plan.states[plan.way_out][1] < 2.0 and plan.refine() is not None
    within = those.plan((1.5, 2.3, 0.0), (2.5, 1.0, 0.0), way_out=True)
    assert within.status == Status.INVALID_START and within.way_out == 0
    free = planner(flat()).plan(START, GOAL, way_out=True)
    assert free.solved and free.way_out == 0 and free.assumed == ()
