import dataclasses

import numpy as np
import pytest

from hdsp.robot.robot import Robot
from hdsp.terrain.cost_maps import cost_maps
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import random_map
from tests.detailed.instances import blocky, tilted, toy
from tests.naive import Naive

MOMARO = Robot.load("momaro")


def assert_equal_to_the_twin(heights, robot, cells):
    maps, twin = cost_maps(HeightMap(heights), robot), Naive(heights, robot)
    for x, y in cells:
        assert maps.height_difference[x, y] == pytest.approx(twin.difference((x, y)), abs=1e-7)
        assert maps.unevenness[x, y] == pytest.approx(twin.unevenness((x, y)), rel=1e-6, abs=1e-6)
        assert maps.edge[x, y] == twin.edge((x, y))
        assert maps.standable[x, y] == twin.standable((x, y))
        for heading in range(0, 64, 5):
            assert bool(int(maps.steep[x, y]) >> heading & 1) == twin.steep((x, y), heading)


def test_cost_maps_equal_the_twins():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        heights = blocky(rng, cells=16, blocks=4)
        heights[rng.random(heights.shape) < 0.03] = np.nan
        heights = tilted(heights, rng) if seed > 1 else heights
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
    assert np.flatnonzero(~maps.standable[:, 20]).tolist() == list(range(25, 35))


def test_unevenness_is_proportional_to_height_and_ends_at_its_radius():
    heights = np.zeros((60, 60), np.float32)
    heights[30:] = 0.1
    single, double = (cost_maps(HeightMap(h), MOMARO).unevenness for h in (heights, 2 * heights))
    np.testing.assert_allclose(double, 2 * single, rtol=1e-6)
    # A foot that touches the block stands on it: the edge between footholds is one cell before the block.
    assert np.flatnonzero(single[:, 30]).tolist() == list(range(17, 41))
    np.testing.assert_allclose(single[29:41, 30], single[28:16:-1, 30], rtol=1e-6)


@pytest.mark.parametrize("ahead", [0.0, 0.4, 1.1, 2.5])
@pytest.mark.parametrize("share", [0.9, 1.0, 1.1])
def test_slopes_bear_a_foot_up_to_the_limit(ahead, share):
    x, y = (np.indices((60, 60)) + 0.5) * 0.025
    heights = np.tan(share * MOMARO.slope.max_pitch) * (np.cos(ahead) * x + np.sin(ahead) * y)
    maps = cost_maps(HeightMap(heights.astype(np.float32)), MOMARO)
    inner = maps.standable[6:-6, 6:-6]
    assert not maps.edge.any() and (inner.all() if share <= 1 else not inner.any())


def test_limits_ahead_and_across_depend_on_the_heading():
    robot = dataclasses.replace(MOMARO, slope=dataclasses.replace(MOMARO.slope, max_roll=0.1))
    heights = np.repeat(np.arange(60, dtype=np.float32)[:, None] * 0.025 * np.tan(0.2), 60, axis=1)
    steep = cost_maps(HeightMap(heights.astype(np.float32)), robot).steep[30, 30]
    allowed = [heading for heading in range(64) if not int(steep) >> heading & 1]
    assert 0 in allowed and 32 in allowed and 16 not in allowed and 8 not in allowed
    assert len(allowed) % 2 == 0 and len(allowed) < 24


@pytest.mark.parametrize("smeared", [0.025, 0.05, 0.1, 0.15])
@pytest.mark.parametrize("height", [0.04, 0.06, 0.1, 0.2])
def test_a_kerb_smeared_into_a_ramp_stops_wheels_like_a_sharp_one(height, smeared):
    x = np.arange(60) * 0.025
    heights = np.repeat((height * np.clip((x - 0.7) / smeared, 0, 1))[:, None], 60, axis=1).astype(np.float32)
    standable = cost_maps(HeightMap(heights), MOMARO).standable[20:40, 30]
    assert standable.all() if height <= 0.05 else not standable.all()


def test_unknown_ground_bears_no_foot_and_adds_no_unevenness():
    heights = np.zeros((40, 40), np.float32)
    heights[20, 20] = np.nan
    maps = cost_maps(HeightMap(heights), MOMARO)
    assert not maps.unevenness.any()
    assert maps.standable[25, 20] and not maps.standable[24, 20] and not maps.standable[23, 23]
