import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hdsp.abstract.oracle import CostKind, task_costs
from hdsp.abstract.transform import best_feet, feet_at
from hdsp.base.errors import InputError
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.search.estimate import geometric_estimate
from hdsp.detailed.search.outcome import Limits, Status
from hdsp.detailed.search.weighted_astar import solve
from hdsp.detailed.world.world import build_world
from hdsp.labels.rules import LabelSettings, label_map
from hdsp.robot.lattice import ABSTRACT_ACTIONS, Grid
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import CATEGORIES, random_map
from tests.detailed.instances import blocky, toy
from tests.naive import Naive, dijkstra

MOMARO = Robot.load("momaro")

#: Costs on flat ground in the published labels, in action order (map 22 and others).
FLAT = [
    0.1, 0.38541, 0.3, 0.424264, 0.25, 0.424264, 0.3, 0.38541, 0.2, 0.406809, 0.670821, 0.6, 0.670821, 0.625018, 0.5,
    0.625018, 0.670821, 0.6, 0.670821, 0.406809, 0.036613, 0.036613,
]  # fmt: skip


def test_flat_ground_costs_what_the_published_labels_say():
    labels = label_map(HeightMap.flat((72, 72)), MOMARO)
    assert labels.feasible.all() and (labels.reason == Status.SOLVED).all()
    np.testing.assert_allclose(labels.cost, FLAT, atol=1e-5)
    np.testing.assert_allclose(labels.goals, ABSTRACT_ACTIONS)


@pytest.mark.parametrize("heading", [4, 12, 32])
def test_flat_ground_costs_the_same_after_turning_back(heading):
    labels = label_map(HeightMap.flat((104, 104)), MOMARO, start_heading=heading)
    assert labels.feasible.all() and labels.heights.shape == (72, 72)
    np.testing.assert_allclose(labels.cost[20:], FLAT[20:], atol=1e-5)
    if heading == 32:
        opposite = [ABSTRACT_ACTIONS.tolist().index([-dx, -dy, 0]) for dx, dy, _ in ABSTRACT_ACTIONS[:20].tolist()]
        np.testing.assert_allclose(labels.cost[:20], np.array(FLAT)[opposite], atol=1e-5)


@pytest.mark.parametrize("category", ["cuboid_2", "wall_1", "staircase", "staircase_focused"])
def test_labels_equal_separate_searches_with_another_heuristic(category):
    settings, compared = LabelSettings(), 0
    for index in range(4):
        terrain = random_map(31, category, index)
        labels = label_map(terrain, MOMARO, settings)
        if labels is None:
            continue
        world, grid = build_world(terrain, MOMARO), Grid(terrain.origin, terrain.shape)
        start = grid.to_lattice(labels.start[:3], labels.start[3:])
        for m in np.flatnonzero(labels.feasible):
            goal = grid.to_lattice(labels.goal[m, :3], labels.goal[m, 3:])
            turning = ABSTRACT_ACTIONS[m, 2] != 0
            rules = Rules(0, 4) if turning else Rules(0, settings.heading_window, settings.turn_cost_factor)
            limits = Limits(cost=1.0001 * float(labels.cost[m]) + 1e-5, expansions=60_000)
            alone = solve(world, start, goal, geometric_estimate(world, goal), rules=rules, limits=limits, paths=False)
            if alone.status == [Status.EXPANSION_LIMIT]:
                continue  # the plain heuristic is too slow for this one
            assert alone.status == [Status.SOLVED], f"map {index}, action {m}"
            assert alone.cost[0] == pytest.approx(labels.cost[m], rel=1e-4, abs=1e-5)
            compared += 1
    assert compared >= 8


@settings(max_examples=12, deadline=None)
@given(st.sampled_from(CATEGORIES), st.integers(0, 200), st.sampled_from([0, 4, 8]))
def test_planning_costs_never_exceed_labels_and_are_the_least_without_rules(category, index, heading):
    terrain = random_map(1003, category, index, cells=104)
    labels = label_map(terrain, MOMARO, LabelSettings(planning_costs=True), heading)
    if labels is None:
        return
    plain = label_map(terrain, MOMARO, LabelSettings(), heading)
    assert plain.planning_cost is None
    for name in plain._fields[:-1]:
        np.testing.assert_array_equal(getattr(labels, name), getattr(plain, name))
    cost, feasible = labels.planning_cost, labels.feasible
    assert cost.dtype == np.float32 and (cost[~feasible] == 0).all()
    assert (cost[feasible] > 0).all() and (cost[feasible] <= labels.cost[feasible]).all()
    world, grid = build_world(terrain, MOMARO), Grid(terrain.origin, terrain.shape)
    start = grid.to_lattice(labels.start[:3], labels.start[3:])
    alone = task_costs(world, start, LabelSettings(), 1.6, kind=CostKind.PLANNING)[1]
    np.testing.assert_allclose(alone[feasible], cost[feasible], rtol=1e-5)


def test_planning_costs_are_those_of_the_textbook_search():
    robot, compared = toy(), 0
    for seed, heading in ((0, 4), (0, 0), (1, 24)):
        heights = blocky(np.random.default_rng(seed), cells=14, blocks=2)
        world = build_world(HeightMap(heights), robot)
        start = feet_at(world, np.array([7, 7, heading]))
        if start is None:
            continue
        least = dijkstra(Naive(heights, robot), tuple(start.tolist()), most=1000).cost
        goals, costs, _ = task_costs(world, start, LabelSettings(), 2.0, kind=CostKind.PLANNING)
        for goal, cost in zip(map(tuple, goals.tolist()), costs, strict=True):
            if goal in least:
                compared += 1
                assert cost == pytest.approx(least[goal], rel=1e-5)
    assert compared >= 4


def test_labels_say_how_each_task_ended():
    found = [label_map(random_map(31, category, 1), MOMARO) for category in ("cuboid_2", "wall_1")]
    for labels in filter(None, found):
        assert_labels_are_complete(labels)
    assert any(labels is not None and not labels.feasible.all() for labels in found)


def assert_labels_are_complete(labels):
    assert (labels.feasible == (labels.reason == Status.SOLVED)).all()
    assert (labels.cost[~labels.feasible] == 0).all() and (labels.cost[labels.feasible] > 0).all()
    assert np.isfinite(labels.goal).all() and np.isfinite(labels.start).all()
    assert set(labels.reason.tolist()) <= set(Status) - {Status.INVALID_START}


def test_a_goal_in_a_wall_is_invalid_and_a_way_around_costs_more():
    heights = np.zeros((72, 72), np.float32)
    heights[58:] = 1.0  # the front feet, 13 cells ahead of the base, are blocked after 9 cells
    labels = label_map(HeightMap(heights), MOMARO)
    actions = ABSTRACT_ACTIONS.tolist()
    assert labels.reason[actions.index([2, 0, 0])] == Status.INVALID_GOAL
    assert not labels.feasible[actions.index([2, 1, 0])]
    assert labels.cost[actions.index([-2, 0, 0])] >= FLAT[actions.index([-2, 0, 0])] - 1e-6


def test_a_start_in_a_wall_has_no_labels():
    heights = np.zeros((72, 72), np.float32)
    heights[40:, :] = 1.0  # mainly the body collides
    assert label_map(HeightMap(heights), MOMARO) is None
    rubble = np.random.default_rng(0).uniform(0, 0.25, (72, 72))
    assert label_map(HeightMap(rubble), MOMARO) is None
    assert label_map(HeightMap(np.full((72, 72), np.nan, np.float32)), MOMARO) is None


def test_wrong_arguments_are_named():
    flat = HeightMap.flat((72, 72))
    with pytest.raises(InputError, match=r"71 x 72.*at least 72 x 72"):
        label_map(HeightMap.flat((71, 72)), MOMARO)
    for heading in (3, -4, 64):
        with pytest.raises(InputError, match=f"start heading {heading}"):
            label_map(flat, MOMARO, start_heading=heading)
    with pytest.raises(InputError, match=r"cost_limit_factor is 0\.0; need a positive number"):
        LabelSettings(cost_limit_factor=0.0)
    with pytest.raises(InputError, match="heading_window is -1; need at least 0"):
        LabelSettings(heading_window=-1)


def test_a_cost_limit_of_labelling_cuts_what_costs_more():
    factor = 0.3001 / max(FLAT)
    labels = label_map(HeightMap.flat((72, 72)), MOMARO, LabelSettings(cost_limit_factor=factor))
    assert labels.feasible.tolist() == [cost <= 0.3001 for cost in FLAT]
    assert (labels.reason[~labels.feasible] == Status.COST_LIMIT).all()


@pytest.mark.parametrize("seed", range(6))
def test_the_best_feet_are_those_found_by_trying_all(seed):
    robot = toy(feet={"neutral_preference": 0.9 * (seed % 2), "min_separation": 0.05 + 0.025 * (seed % 3)})
    rng = np.random.default_rng(seed)
    heights = blocky(rng, blocks=3)
    world, twin = build_world(HeightMap(heights), robot), Naive(heights, robot)
    found = 0
    for _ in range(12):
        base = (*rng.integers(1, 11, 2).tolist(), int(rng.integers(64)))
        value, state = twin.best_feet(*base)
        offsets = feet_at(world, np.array(base))
        if state is None:
            assert offsets is None
            continue
        found += 1
        chosen = tuple(offsets.tolist())
        assert chosen[:3] == base and twin.valid(chosen) and twin.separated(chosen)
        assert twin.feet_value(chosen) == pytest.approx(value, rel=1e-6)
        assert best_feet(world, *base)[0] * robot.drive.unevenness_cost + 1 == pytest.approx(value, rel=1e-5)
    assert found


def test_feet_are_neutral_on_even_ground():
    world = build_world(HeightMap.flat((72, 72)), MOMARO)
    assert feet_at(world, np.array([36, 36, 5])).tolist() == [36, 36, 5, 0, 0, 0, 0]
