from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hdsp.base.errors import InputError
from hdsp.labels.rules import LabelSettings, label_map
from hdsp.labels.run.splits import LabelRun, SplitSettings
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.obstacles import Ramp, Scene, Tiles
from hdsp.terrain.scenes import ALL_CATEGORIES, CATEGORIES, TerrainSettings, random_scene
from hdsp.terrain.sensor_model import SensingSettings, sensed

NOTHING = SensingSettings(
    **dict.fromkeys(("tilt", "bumps", "jitter", "mixed", "white", "correlated", "borders", "holes", "smooth"), 0.0),
    sensor_height=(5.0, 6.0),
)
WALL = np.zeros((72, 72), np.float32)
WALL[50:53, 20:52] = 1.0


def sense(heights, strength, seed=0):
    return sensed(HeightMap(heights), strength, np.random.default_rng(seed)).heights


def run_of(**split):
    return LabelRun(
        SplitSettings(**{"seed": 5, "maps_per_category": 8, **split}),
        Robot.load("momaro"),
        TerrainSettings(),
        LabelSettings(),
    )


def test_sensors_without_faults_see_the_ground_as_it_is():
    np.testing.assert_array_equal(sense(np.zeros((72, 72)), NOTHING), 0)


def test_what_lies_behind_a_wall_is_unknown_and_what_lies_before_it_known():
    low = replace(NOTHING, sensors=(1, 1), sensor_distance=(0.0, 0.0), sensor_height=(0.9, 0.9), around=0.0)
    heights = sense(WALL, low)
    assert np.isfinite(heights[:50]).all()
    assert np.isnan(heights[55:, 30:42]).all()
    assert np.isfinite(heights[55, :3]).all()  # beside the wall


def test_ground_near_the_start_is_always_known():
    blind = replace(NOTHING, borders=1.0, holes=50.0, around=0.4)
    x, y = np.indices((72, 72)) - 36
    for seed in range(5):
        heights = sense(WALL, blind, seed)
        assert np.isfinite(heights[np.hypot(x, y) * 0.025 <= 0.4]).all()
        assert np.isnan(heights).any()


def test_each_amount_changes_the_map_and_stays_within_its_bounds():
    flat, block = np.zeros((72, 72)), np.where(np.indices((72, 72))[0] > 45, 0.3, 0.0)
    tilted = sense(flat, replace(NOTHING, tilt=0.08))
    slope = np.hypot(*np.gradient(tilted.astype(float), 0.025))
    assert 0 < slope.max() <= np.tan(0.08) + 1e-4 and np.ptp(slope) < 1e-4
    for name, ground, largest in [
        ("bumps", flat, 0.06),
        ("white", flat, 0.07),
        ("correlated", flat, 0.02),
        ("mixed", block, 0.3),
        ("jitter", block, 0.3),
    ]:
        changed = sense(ground, replace(NOTHING, **{name: getattr(SensingSettings(), name)}))
        assert 0 < np.abs(changed - ground).max() <= largest, name


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 119), st.integers(0, 119))
def test_a_sensed_map_depends_on_its_own_numbers_alone(first, second):
    run = run_of(sensing=True, categories=ALL_CATEGORIES, heading_residues=(0, 1))
    before = run.terrain_of(first).heights
    run.terrain_of(second)
    np.testing.assert_array_equal(run.terrain_of(first).heights, before)
    assert first == second or not np.array_equal(run.terrain_of(second).heights, before, equal_nan=True)


def test_labels_are_those_of_the_planner_on_the_map_that_the_network_sees():
    run = run_of(sensing=True)
    for number in range(0, run.split.maps, 9):  # maps with one cuboid
        terrain = run.terrain_of(number)
        tasks = label_map(terrain, run.robot, run.settings, 0)
        if tasks is not None:
            np.testing.assert_array_equal(tasks.heights, terrain.heights)
            return
    raise AssertionError("no map with a valid start")


def test_splits_without_sensing_keep_maps_and_names_whatever_its_strength():
    plain = run_of()
    other = LabelRun(plain.split, plain.robot, plain.terrain, plain.settings, SensingSettings(white=0.1))
    assert plain.labels_hash == other.labels_hash
    strong = LabelRun(replace(plain.split, sensing=True), *other_parts(other))
    assert strong.labels_hash != LabelRun(strong.split, plain.robot, plain.terrain, plain.settings).labels_hash
    np.testing.assert_array_equal(plain.terrain_of(3).heights, other.terrain_of(3).heights)


def other_parts(run):
    return run.robot, run.terrain, run.settings, run.sensing


def test_richer_categories_come_after_those_of_the_paper():
    assert ALL_CATEGORIES[:9] == CATEGORIES and SplitSettings(1, 1).categories == CATEGORIES
    kinds = {type(o) for index in range(12) for o in random_scene(3, "mixed_4", index).obstacles}
    assert {Ramp, Tiles} <= kinds
    assert [len(random_scene(1, f"mixed_{n}", 0).obstacles) for n in (2, 3, 4)] == [2, 3, 4]
    assert random_scene(2, "tiles_mixed", 1) == random_scene(2, "tiles_mixed", 1)


def test_tiles_have_the_height_of_their_middle_and_their_slope():
    tiles = Tiles(0.0, 0.0, 0.0, 1.0, 0.5, 0.3, 0.5, (((0.1, 0.0, 0.2),), ((0.3, 0.1, 0.0),)))
    scene = Scene((tiles,))
    x, y = np.array([-0.25, -0.25, 0.25, 0.35, 0.6]), np.array([0.0, 0.1, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(scene.heights_at(x, y), [0.1, 0.12, 0.3, 0.31, 0.0], atol=1e-6)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"white": -0.1}, r"SensingSettings\.white is -0\.1; need at least 0"),
        ({"sensors": (0, 2)}, r"sensors\[0\] is 0; need at least 1"),
        ({"sensor_height": (2.0, 1.0)}, r"sensor_height is \[2\.0, 1\.0\]; need the smaller number first"),
        ({"mixed": 1.5}, r"mixed is 1\.5; need at most 1"),
    ],
)
def test_strengths_out_of_range_are_named(wrong, message):
    with pytest.raises(InputError, match=message):
        SensingSettings(**wrong)
    with pytest.raises(InputError, match="need true or false"):
        SplitSettings(1, 1, sensing="yes")
