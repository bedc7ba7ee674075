import numpy as np
import pytest

from hdsp.robot.robot import Robot
from hdsp.terrain.cost_maps import cost_maps
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import random_map
from tests.detailed.instances import blocky, toy
from tests.naive import Naive

MOMARO = Robot.load("momaro")


def assert_equal_to_the_twin(heights, robot, cells):
    maps, twin = cost_maps(HeightMap(heights), robot), Naive(heights, robot)
    for x, y in cells:
        assert maps.height_difference[x, y] == pytest.approx(twin.difference((x, y)), abs=1e-7)
        assert maps.unevenness[x, y] == pytest.approx(twin.unevenness((x, y)), rel=1e-6, abs=1e-6)
        assert maps.edge[x, y] == twin.edge((x, y))
        assert maps.standable[x, y] == twin.standable((x, y))


def test_cost_maps_equal_the_twins():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        heights = blocky(rng, cells=16, blocks=4)
        heights[rng.random(heights.shape) < 0.03] = np.nan
        assert_equal_to_the_twin(heights, toy(feet={"clearance": 0.036}), np.ndindex(heights.shape))


def test_cost_maps_of_terrains_equal_the_twins():
    rng = np.random.default_rng(0)
    for category in ("staircase", "cuboid_wall"):
        heights = random_map(2, category, 0).heights.copy()
        heights[40:42, 10:20] = np.nan
        assert_equal_to_the_twin(heights, MOMARO, rng.integers(0, 72, (250, 2)).tolist())


def test_a_wall_marks_its_own_edge_and_the_ground_before_it():
    heights = np.zeros((60, 60), np.float32)
    heights[30:] = 0.4
    maps = cost_maps(HeightMap(heights), MOMARO)
    assert np.flatnonzero(maps.edge[:, 20]).tolist() == [29, 30]
    assert maps.height_difference[29, 20] == np.float32(0.4)
    assert np.flatnonzero(~maps.standable[:, 20]).tolist() == list(range(26, 34))


def test_unevenness_is_proportional_to_height_and_ends_at_its_radius():
    heights = np.zeros((60, 60), np.float32)
    heights[30:] = 0.1
    single, double = (cost_maps(HeightMap(h), MOMARO).unevenness for h in (heights, 2 * heights))
    np.testing.assert_allclose(double, 2 * single, rtol=1e-6)
    assert np.flatnonzero(single[:, 30]).tolist() == list(range(18, 42))


def test_slight_slopes_are_driven():
    heights = np.repeat(np.arange(60, dtype=np.float32)[:, None] * 0.04, 60, axis=1)
    maps = cost_maps(HeightMap(heights), MOMARO)
    assert not maps.edge.any() and maps.standable.all()
    assert maps.unevenness.min() > 0


def test_unknown_ground_bears_no_foot_and_adds_no_unevenness():
    heights = np.zeros((40, 40), np.float32)
    heights[20, 20] = np.nan
    maps = cost_maps(HeightMap(heights), MOMARO)
    assert not maps.unevenness.any()
    assert maps.standable[24, 20] and not maps.standable[23, 20] and not maps.standable[22, 22]
