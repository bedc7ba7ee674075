import numpy as np
import pytest

from hdsp.abstract import FlatCosts, OracleCosts
from hdsp.detailed.search.interpolation import CostsToGo, interpolated
from hdsp.detailed.states import pack, pack_states
from hdsp.detailed.world.world import build_world
from hdsp.planning.heuristics import AbstractHeuristic
from hdsp.planning.planner import Planner
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import random_map
from tests.detailed.instances import valid_states
from tests.naive import Naive
from tests.naive_to_go import to_go_between

MOMARO = Robot.load("momaro")


@pytest.mark.parametrize("kind", ["staircase", "cuboid_2"])
def test_the_kernel_equals_its_twin(kind):
    terrain, random = random_map(11, kind, 2), np.random.default_rng(3)
    world, twin = build_world(terrain, MOMARO), Naive(terrain.heights, MOMARO)
    shape = 16, *(n // 4 for n in terrain.shape)
    values = random.uniform(0, 2, shape).astype(np.float32)
    values[random.random(shape) < 0.3] = np.inf
    lowest, highest = MOMARO.offset_range()
    feet = {}
    packed = np.full(shape, -1, np.int32)
    for at in np.argwhere(random.random(shape) < 0.5).tolist():
        feet[tuple(at)] = tuple(random.integers(lowest, highest + 1, 4).tolist())
        packed[tuple(at)] = pack(0, 0, 0, *(offset - lowest for offset in feet[tuple(at)]))
    uneven = np.ones(shape[1:], bool)
    table = CostsToGo(values.ravel(), packed.ravel(), uneven.ravel(), *shape[1:])
    standing = valid_states(twin, random, 60)
    feet_of_state = random.integers(lowest, highest + 1, (len(standing), 8, 4)).tolist()
    stretched = [(*state[:3], *each) for state, some in zip(standing, feet_of_state, strict=True) for each in some]
    states = np.array([*standing, *filter(twin.valid, stretched)])
    keys = pack_states(states, world.tables.lowest)
    expected = [to_go_between(twin, values, feet, tuple(state)) for state in states.tolist()]
    np.testing.assert_allclose([interpolated(world, table, int(key)) for key in keys], expected, rtol=1e-5)
    assert np.isfinite(expected).sum() > 100
    assert (states[:, 3:] != 0).any(axis=1).sum() > 50


def test_cells_without_edges_around_need_no_correction():
    terrain = random_map(5, "cuboid_2", 1)
    world = build_world(terrain, MOMARO)
    heuristic = AbstractHeuristic(world, terrain, FlatCosts(MOMARO), "even")
    twin, random = Naive(terrain.heights, MOMARO), np.random.default_rng(0)
    states = valid_states(twin, random, 60)
    table = heuristic.set_goal(np.array(states[0])).to_go
    checked = table._replace(uneven=np.ones_like(table.uneven))
    keys = pack_states(states, world.tables.lowest)
    assert [interpolated(world, table, int(k)) for k in keys] == [interpolated(world, checked, int(k)) for k in keys]


def test_a_climb_keeps_g_plus_h_nearly_constant():
    heights = np.zeros((96, 56), np.float32)
    heights[48:] = 0.15
    terrain = HeightMap(heights)
    # Costs along the climb alone: a lane straight ahead.
    costs = Lane()
    planner = Planner(terrain, MOMARO, costs, conditioning=None)
    plan = planner.plan((0.6, 0.7, 0.0), (1.8, 0.7, 0.0), weight=1.25, polish=0)
    assert plan.solved
    assert plan.steps == 4
    lattice = states_of(planner, plan)
    g = np.concatenate([[0.0], np.cumsum(plan.action_costs)])
    f = g + planner.heuristic(lattice)
    off = (lattice[:, 3:] != 0).any(axis=1)
    assert off.sum() > 20
    assert np.ptp(f[off]) < 0.15 * plan.cost
    assert plan.stats.expansions < 20 * len(lattice)


class Lane(OracleCosts):
    """Costs of the detailed planner for the heading along x."""

    def __init__(self):
        super().__init__(MOMARO)

    def edges(self, height_map, region=None, mask=None):
        lane = np.zeros_like(mask)
        lane[0, :, 5:9] = mask[0, :, 5:9]
        return super().edges(height_map, region, lane)


def states_of(planner, plan):
    poses = [planner.grid.to_lattice(state[:3])[:3] for state in plan.states]
    return np.concatenate([poses, np.rint(plan.states[:, 3:] / 0.025).astype(int)], axis=1).astype(np.int64)
