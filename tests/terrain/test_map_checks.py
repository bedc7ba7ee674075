import numpy as np
import pytest

from hdsp.planning.planner import Planner
from hdsp.terrain import ALL_CATEGORIES, random_map, suspicions
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.map_frame import MapFrame
from hdsp.terrain.no_data import implausible_heights

RANDOM = np.random.default_rng(3)


def ground(shape=(120, 120), noise=0.005):
    """Flat ground with a kerb of 0.15 m and noise."""
    heights = RANDOM.normal(0, noise, shape) if noise else np.zeros(shape)
    heights[:, 60:] += 0.15
    return heights


def put(heights, value, share):
    return np.where(RANDOM.random(heights.shape) < share, value, heights)


def told(heights, resolution=0.025, **more):
    return "; ".join(suspicions(HeightMap(heights, resolution=resolution, **more)))


@pytest.mark.parametrize("noise", [0, 0.005, 0.03])
def test_ordinary_ground_raises_no_suspicion(noise):
    assert told(ground(noise=noise)) == ""
    assert told(put(ground(noise=noise), np.nan, 0.3)) == ""


@pytest.mark.parametrize("category", ALL_CATEGORIES)
def test_random_scenes_raise_no_suspicion_of_units_or_values(category):
    terrain = random_map(1, category, 0)
    assert implausible_heights(terrain.heights, terrain.resolution) == ()


@pytest.mark.parametrize("noise", [0, 0.0008, 0.005, 0.03])
def test_m18_millimetres_are_suspected_and_a_planner_warns(noise):
    heights = ground(noise=noise) * 1000
    assert "millimetres or centimetres?" in told(heights)
    with pytest.warns(UserWarning, match="terrain: heights from .* m in cells of 0.025 m: millimetres or centimetres"):
        Planner(heights, resolution=0.025)


@pytest.mark.parametrize("value", [-9999, -9999.99, -32768, 65535, -1e6, 1e6, 1e20])
def test_m10_no_data_values_in_an_array_are_named(value):
    assert f"with the no-data value {value:g}; make it NaN" in told(put(ground() + 412, value, 0.01))


@pytest.mark.filterwarnings("ignore:terrain. 120 cells lie under the ground")
@pytest.mark.parametrize("value", [0.0, 65.535, -99.0])
def test_a_planner_warns_of_a_patch_with_one_height_far_from_all_others(value):
    heights = ground() + 312
    heights[60:66, 30:50] = value
    with pytest.warns(
        UserWarning, match=f"terrain: 0.8% of the known cells have the height {value:g} m, .* all others"
    ):
        Planner(heights, resolution=0.025)


def test_a_planner_warns_of_cells_deep_under_the_ground(recwarn):
    Planner(put(ground(), np.nan, 0.3), resolution=0.025)
    Planner(np.where(np.arange(120) < 4, 9.0, ground()), resolution=0.025)  # a wall
    assert not recwarn.list
    with pytest.warns(UserWarning, match=r"terrain: 40 cells lie under the ground, the lowest by 4\.0 m"):
        Planner(np.where(np.arange(14400).reshape(120, 120) % 360 == 7, -4.0, ground(noise=0)), resolution=0.025)


@pytest.mark.parametrize(
    ("heights", "words"),
    [
        (np.full((80, 80), np.nan), "no cell is known"),
        (np.ones((80, 80)), "all known heights are 1 m"),
        (put(ground() + 412, 0.0, 0.05), "of the known cells have the height 0 m, 41"),
        (put(ground(), -4.0, 0.0005), "under the ground, the lowest by 4"),
        (ground() - 4, "the ground lies 3.9"),
        (np.cumsum(np.full((80, 80), 0.1), axis=0) - 4, "most of the ground is steeper than 72 degrees"),
        (put(ground(), np.nan, 0.9), "90% of the cells are unknown"),
    ],
)
def test_unusual_heights_are_named(heights, words):
    assert words in told(heights)


@pytest.mark.parametrize(
    ("shape", "resolution", "words"),
    [
        ((80, 80), 0.5, "cells of 0.5 m are too coarse"),
        ((80, 80), 0.15, "cells of 0.15 m are coarse"),
        ((1200, 1200), 0.002, "far finer than the planner's"),
        ((20, 90), 0.025, "0.5 x 2.25 m are smaller than a robot needs"),
        ((900, 900), 0.2, "180 x 180 m are 51,840,000 cells"),
    ],
)
def test_cells_and_sizes_that_do_not_suit_the_planner_are_named(shape, resolution, words):
    heights = np.zeros(shape)
    heights[0, 0] = 0.01
    assert words in told(heights, resolution)


def test_ground_far_from_zero_is_in_order_where_a_crs_says_what_zero_is():
    assert told(ground() + 412, frame=MapFrame(crs="EPSG:25832")) == ""
