import numpy as np
import pytest

from hdsp.abstract import FlatCosts, ManualCosts
from hdsp.base.errors import InputError
from hdsp.base.gradual import finished
from hdsp.detailed.relaxed.foothold_regions import efforts_to
from hdsp.detailed.search.estimate import estimate
from hdsp.detailed.states import pack_states, unpack_states
from hdsp.detailed.world.world import build_world, cell_index
from hdsp.planning.heuristics import AbstractHeuristic, GeometricHeuristic, standing_states
from hdsp.planning.heuristics.standing import standing_steps, updated_standing
from hdsp.planning.map_changes import changed_cells
from hdsp.planning.measured_map import MeasuredMap
from hdsp.planning.planner import Planner
from hdsp.robot.lattice import (
    ABSTRACT_ACTIONS,
    CELLS_PER_ABSTRACT,
    abstract_anchor,
    abstract_shape,
)
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import random_map
from tests.detailed.instances import valid_states
from tests.naive import Naive
from tests.naive_to_go import to_go_between

MOMARO = Robot.load("momaro")


@pytest.fixture(scope="module")
def scene():
    terrain = random_map(4, "cuboid_2", 3)
    states = valid_states(Naive(terrain.heights, MOMARO), np.random.default_rng(0), 25)
    return terrain, build_world(terrain, MOMARO), np.array(states)


def heuristics(terrain, world):
    yield GeometricHeuristic(world)
    yield AbstractHeuristic(world, terrain, FlatCosts(MOMARO), "flat")
    yield AbstractHeuristic(world, terrain, ManualCosts(MOMARO), "manual")


def least_steps(heuristic, states, goal=None):
    """Least cost of foot steps from each state to the goal (default: the first state)."""
    goal = states[0] if goal is None else goal
    efforts = efforts_to(heuristic.foothold_regions, heuristic.world, goal[None])
    twin = Naive(heuristic.terrain.heights, MOMARO)
    totals = []
    for state in states.tolist():
        cells = [twin.foothold(state, foot) for foot in range(4)]
        flat = [int(cell_index(heuristic.world, *cell)) for cell in cells]
        totals.append(sum(efforts[foot, heuristic.foothold_regions.region[cell]] for foot, cell in enumerate(flat)))
    return np.array(totals)


def test_calling_a_heuristic_gives_what_the_kernel_sees(scene):
    terrain, world, states = scene
    for heuristic in heuristics(terrain, world):
        parameters = heuristic.set_goal(states[0])
        values = heuristic(states)
        assert values.shape == (len(states),)
        expected = [estimate(world, parameters, key) for key in pack_states(states, world.tables.lowest)]
        assert values.tolist() == expected
        assert (values >= 0).all()
        # An estimate is infinite only with a proof: no steps bring some foot to its goal.
        steps = least_steps(heuristic, states) if isinstance(heuristic, AbstractHeuristic) else np.zeros(len(states))
        np.testing.assert_array_equal(np.isinf(values), np.isinf(steps))


def test_a_heuristic_without_a_goal_says_so(scene):
    terrain, world, states = scene
    for heuristic in heuristics(terrain, world):
        with pytest.raises(InputError, match=f"{heuristic.name}.*set_goal"):
            heuristic(states)


def test_only_the_geometric_heuristic_claims_to_be_admissible_and_consistent(scene):
    assert [heuristic.admissible for heuristic in heuristics(*scene[:2])] == [True, False, False]
    assert [heuristic.consistent for heuristic in heuristics(*scene[:2])] == [True, False, False]


def test_the_geometric_heuristic_equals_its_twin(scene):
    terrain, world, states = scene
    twin, heuristic = Naive(terrain.heights, MOMARO), GeometricHeuristic(world)
    heuristic.set_goal(states[-1])
    expected = [twin.geometric(tuple(state), tuple(states[-1])) for state in states.tolist()]
    np.testing.assert_allclose(heuristic(states), expected, rtol=1e-9)


def test_an_abstract_heuristic_interpolates_the_cost_to_go(scene):
    terrain, world, states = scene
    heuristic, geometric = AbstractHeuristic(world, terrain, FlatCosts(MOMARO)), GeometricHeuristic(world)
    table = heuristic.set_goal(states[0]).to_go
    geometric.set_goal(states[0])
    values = table.values.reshape(16, table.nx, table.ny)
    packed = table.feet.reshape(values.shape)
    at = np.argwhere(packed >= 0)
    offsets = unpack_states(packed[tuple(at.T)].astype(np.int64), world.tables.lowest)[:, 3:]
    feet = dict(zip(map(tuple, at.tolist()), offsets.tolist(), strict=True))
    twin = Naive(terrain.heights, MOMARO)
    away = np.hypot(*(states[:, :2] - states[0, :2]).T) > CELLS_PER_ABSTRACT  # over the last cell, values fall to 0
    between = np.array([to_go_between(twin, values, feet, tuple(state)) for state in states.tolist()])
    chosen = away & np.isfinite(between)
    assert chosen.sum() > 10
    expected = np.maximum(geometric(states) + least_steps(heuristic, states), between)
    np.testing.assert_allclose(heuristic(states)[chosen], expected[chosen], rtol=1e-5)
    assert heuristic(states[:1])[0] == 0


def test_costs_to_go_on_even_ground_are_those_of_the_planner():
    planner = Planner(HeightMap.flat((100, 100)), MOMARO, FlatCosts(MOMARO))
    goal, starts = (1.3, 1.2, 0.7), np.random.default_rng(5).uniform((0.7, 0.7, -3), (1.8, 1.8, 3), (20, 3))
    ratios = []
    for start in starts[np.hypot(*(starts[:, :2] - goal[:2]).T) > 0.3].tolist():
        plan = planner.plan(tuple(start), goal, weight=1.0, polish=0.5)
        ratios.append(planner.heuristic(planner.grid.to_lattice(tuple(start))[None])[0] / plan.cost)
    assert ((np.array(ratios) > 0.8) & (np.array(ratios) < 1.2)).mean() >= 0.95


def test_states_that_the_abstraction_cuts_off_cost_more_than_their_way_on_even_ground(scene):
    terrain, world, states = scene

    class OnlyTurns(FlatCosts):
        def edges(self, height_map, region=None, mask=None):
            edges = super().edges(height_map, region, mask).copy()
            edges[..., ABSTRACT_ACTIONS[:, 2] == 0] = np.inf
            return edges

    heuristic = AbstractHeuristic(world, terrain, OnlyTurns(MOMARO), "turns")
    connected = AbstractHeuristic(world, terrain, FlatCosts(MOMARO), "flat")
    heuristic.set_goal(states[0])
    connected.set_goal(states[0])
    values, connected_values = heuristic(states), connected(states)
    steps = least_steps(heuristic, states)
    np.testing.assert_array_equal(np.isinf(values), np.isinf(steps))
    away = np.hypot(*(states[:, :2] - states[0, :2]).T) > 2 * CELLS_PER_ABSTRACT
    others = away & np.isfinite(steps)
    assert others.sum() > 10
    assert (values[others] > 1.5 * connected_values[others]).all()


def test_a_changed_terrain_asks_for_the_goal_again(scene):
    terrain, world, states = scene
    heuristic = AbstractHeuristic(world, terrain, FlatCosts(MOMARO))
    heuristic.set_goal(states[0])
    flat = HeightMap.flat(terrain.shape)
    heuristic.update(build_world(flat, MOMARO), flat)
    with pytest.raises(InputError, match="set_goal"):
        heuristic(states)
    assert np.isfinite(heuristic.set_goal(states[0]).outside)


def test_standing_states_are_those_with_some_valid_feet():
    side = 24
    heights = random_map(4, "staircase", 0, cells=side).heights
    few_feet = MOMARO.to_dict()["feet"] | {"offset_min": 0.0, "offset_max": 0.025}
    small = Robot.load(MOMARO.to_dict() | {"feet": few_feet})
    world, twin = build_world(HeightMap(heights), small), Naive(heights, small)
    standing = standing_states(world)
    n = side // CELLS_PER_ABSTRACT
    assert standing.shape == (16, n, n)
    for k, a, b in np.argwhere(standing)[::7].tolist() + np.argwhere(~standing)[::97].tolist():
        value, _ = twin.best_feet(*abstract_anchor(np.array([a, b, k])).tolist())
        assert standing[k, a, b] == np.isfinite(value)


class Local(FlatCosts):
    """Flat costs that grow with the ground height under the base; counts the evaluated states."""

    asked = 0

    def edges(self, height_map, region=None, mask=None):
        edges = super().edges(height_map, region, mask)
        first_x, first_y, end_x, end_y = region or (0, 0, *abstract_shape(height_map.shape))
        ground = np.nan_to_num(height_map.heights[2::4, 2::4])[first_x:end_x, first_y:end_y]
        type(self).asked += edges[..., 0].size if mask is None else int(np.sum(mask))
        return edges * (1 + abs(ground))[None, :, :, None]

    def affected(self, changed):
        nx, ny = abstract_shape(changed.shape)
        return np.repeat(changed[2::4, 2::4][None, :nx, :ny], 16, axis=0)


@pytest.mark.parametrize("seed", range(12))
def test_standing_states_after_a_change_are_those_of_a_new_map(seed):
    random = np.random.default_rng(seed)
    robot = Robot.load(("momaro", "anymal_wheels", "go2w")[seed % 3])
    terrain = random_map(seed, ("cuboid_2", "staircase", "plane_mixed", "long_ramp")[seed % 4], seed)
    heights = terrain.heights.copy()
    x, y = random.integers(0, np.array(heights.shape) - 8)
    heights[x : x + random.integers(1, 8), y : y + random.integers(1, 8)] = random.choice([np.nan, 0.05, 0.3, 1.0])
    before, after = build_world(terrain, robot), build_world(HeightMap(heights, terrain.origin), robot)
    former, expected = finished(standing_steps(before)), finished(standing_steps(after))
    np.testing.assert_array_equal(updated_standing(before, after, former), expected)
    assert (former != expected).any() or np.array_equal(before.standable, after.standable)
    np.testing.assert_array_equal(updated_standing(after, after, expected), expected)


@pytest.mark.parametrize("region", [None, (30, 30, 72, 72)])
def test_an_update_gives_what_a_new_heuristic_would(scene, region):
    terrain, world, states = scene
    heuristic = AbstractHeuristic(world, terrain, Local(MOMARO))
    heuristic.set_goal(states[0])
    heights = terrain.heights.copy()
    heights[36:, 40:] += 0.01  # a wheel rolls over that edge
    heights[60:62, 60:] = 0.9
    heights[50, 50] = np.nan
    after = HeightMap(heights, terrain.origin)
    new_world = build_world(after, MOMARO)
    asked = Local.asked
    heuristic.update(new_world, after, region)
    heuristic.set_goal(states[0])
    assert 0 < Local.asked - asked < asked
    fresh = AbstractHeuristic(new_world, after, Local(MOMARO))
    for goal in (states[0], states[1]):
        heuristic.set_goal(goal)
        fresh.set_goal(goal)
        np.testing.assert_array_equal(heuristic.graph.incoming, fresh.graph.incoming)
        np.testing.assert_array_equal(heuristic(states), fresh(states))


def test_an_update_that_changes_nothing_asks_for_nothing(scene):
    terrain, world, states = scene
    heuristic = AbstractHeuristic(world, terrain, Local(MOMARO))
    heuristic.set_goal(states[0])
    before, asked = heuristic(states), Local.asked
    heuristic.update(build_world(terrain, MOMARO), HeightMap(terrain.heights.copy(), terrain.origin))
    heuristic.set_goal(states[0])
    assert Local.asked == asked
    np.testing.assert_array_equal(heuristic(states), before)


def test_changed_cells_are_told_apart_from_unknown_ones():
    before = np.zeros((4, 5), np.float32)
    before[1, 1] = before[2, 2] = np.nan
    after = before.copy()
    after[1, 1], after[0, 4], after[3, 3] = 0.0, np.nan, 0.1
    changed = changed_cells(HeightMap(before), HeightMap(after))
    assert np.argwhere(changed).tolist() == [[0, 4], [1, 1], [3, 3]]
    inside = changed_cells(HeightMap(before), HeightMap(after), (0, 0, 2.0, np.int8(2)))
    assert np.argwhere(inside).tolist() == [[1, 1]]
    assert changed_cells(HeightMap(before), HeightMap(after[1:])) is None
    with pytest.raises(InputError, match="region"):
        changed_cells(HeightMap(before), HeightMap(after), (0, 0, 5, 5))
    _, passed_on = MeasuredMap(HeightMap(before), None).updated(HeightMap(after), (0, 0, 2.0, np.int8(2)))
    assert passed_on == (0, 0, 2, 2) and {type(value) for value in passed_on} == {int}
