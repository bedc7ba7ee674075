import math
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hdsp.base.errors import InputError
from hdsp.terrain.obstacles import Bank, Staircase, Tilted
from hdsp.terrain.patches import crop_patches
from hdsp.terrain.scenes import ALL_CATEGORIES, CATEGORIES, SLOPE_CATEGORIES, TerrainSettings, random_map, random_scene
from tests import naive_terrain

CELL = 0.025
WIDE = 480  # cells; a map of this size contains every obstacle completely
seeds, indices, categories = st.integers(0, 2**63), st.integers(0, 10_000), st.sampled_from(CATEGORIES)


def kind(obstacle):
    if isinstance(obstacle, Staircase):
        return "staircase"
    return "wall" if obstacle.height >= 0.7 else "cuboid"


@pytest.mark.parametrize(
    ("category", "content"),
    [
        ("cuboid_1", ["cuboid"]),
        ("cuboid_2", ["cuboid"] * 2),
        ("cuboid_3", ["cuboid"] * 3),
        ("wall_1", ["wall"]),
        ("wall_2", ["wall"] * 2),
        ("cuboid_wall", ["cuboid", "wall"]),
        ("staircase", ["staircase"]),
        ("staircase_wall", ["staircase", "wall"]),
        ("staircase_focused", ["staircase"]),
    ],
)
def test_categories_contain_what_their_names_say(category, content):
    for index in range(20):
        assert [kind(obstacle) for obstacle in random_scene(1, category, index).obstacles] == content


@given(seeds, categories, indices)
def test_obstacles_lie_in_the_published_ranges(seed, category, index):
    for obstacle in random_scene(seed, category, index).obstacles:
        assert abs(obstacle.x) <= 0.9 and abs(obstacle.y) <= 0.9
        assert -math.pi <= obstacle.yaw <= math.pi
        if kind(obstacle) == "cuboid":
            assert 0.2 <= obstacle.length <= 2.0 and 0.2 <= obstacle.width <= 2.0 and 0.02 <= obstacle.height <= 0.4
        elif kind(obstacle) == "wall":
            assert 0.4 <= obstacle.length <= 3.0 and 0.05 <= obstacle.width <= 0.35 and 0.7 <= obstacle.height <= 2.0
        else:
            focused = category == "staircase_focused"
            assert 2 <= obstacle.steps <= 4
            assert 0.15 <= obstacle.rise <= 0.30 and 0.25 <= obstacle.tread <= 0.35 and obstacle.depth == 2.0
            assert (1.4 if focused else 0.9) <= obstacle.width <= 2.0
            assert not focused or abs(obstacle.yaw) <= math.pi / 16


@settings(max_examples=25, deadline=None)
@example(107, "wall_1", 1640)
@given(seeds, st.sampled_from(["cuboid_1", "wall_1"]), indices)
def test_a_rasterised_block_has_the_measured_size_of_the_block(seed, category, index):
    (block,) = random_scene(seed, category, index).obstacles
    heights = random_map(seed, category, index, cells=WIDE).heights
    cells = np.argwhere(heights > 0)
    assert heights.max() == np.float32(block.height) and np.unique(heights).size <= 2
    border = (block.length + block.width) * 2 * CELL
    assert abs(len(cells) * CELL**2 - block.length * block.width) <= border
    if len(cells) > 30:
        middle = (cells - WIDE // 2).mean(axis=0) * CELL
        # A thin wall slightly off the axis may have n cells of thickness in one half and n + 1 in the other. This moves
        # the mean of its cells toward the thicker half by length / (4 (2 n + 1)).
        thin = min(block.length, block.width)
        moved = max(block.length, block.width) / (4 * (2 * math.floor(thin / CELL) + 1))
        assert math.dist(middle, (block.x, block.y)) <= 0.03 + moved
        along = (cells - WIDE // 2) * CELL @ (math.cos(block.yaw), math.sin(block.yaw))
        assert abs(np.ptp(along) - block.length) <= 2.9 * CELL


@settings(max_examples=25, deadline=None)
@given(seeds, st.sampled_from(["staircase", "staircase_focused"]), indices)
def test_a_rasterised_staircase_rises_step_by_step_behind_its_position(seed, category, index):
    (stairs,) = random_scene(seed, category, index).obstacles
    heights = random_map(seed, category, index, cells=WIDE).heights
    levels = np.unique(heights)
    np.testing.assert_allclose(np.diff(levels), stairs.rise, atol=1e-6)
    assert len(levels) == stairs.steps + 1
    middle = WIDE // 2
    for along in np.arange(-0.6, 2.0 + 4 * 0.35, 0.07):
        x, y = stairs.x + along * math.cos(stairs.yaw), stairs.y + along * math.sin(stairs.yaw)
        ix, iy = round(x / CELL), round(y / CELL)
        expected = naive_terrain.staircase_height(stairs, ix * CELL, iy * CELL)
        assert heights[middle + ix, middle + iy] == pytest.approx(expected, abs=1e-6)


@settings(max_examples=20, deadline=None)
@given(seeds, categories, indices, st.integers(0, 3))
def test_a_scene_rotated_by_quarters_is_a_permutation_of_cells(seed, category, index, quarters):
    scene = random_scene(seed, category, index)
    straight = scene.rasterise((81, 81), (40, 40)).heights
    rotated = scene.rasterise((81, 81), (40, 40), quarters * math.pi / 2).heights
    np.testing.assert_array_equal(rotated, np.rot90(straight, quarters))


@settings(max_examples=20, deadline=None)
@given(seeds, categories, indices, st.integers(0, 63))
def test_the_robot_sees_the_same_scene_at_every_heading(seed, category, index, heading):
    straight = random_map(seed, category, index).heights
    rotated = random_map(seed, category, index, cells=104, heading=heading)
    patch = crop_patches(rotated.heights, np.array([[52, 52]]), heading)[0]
    assert not np.isnan(patch).any()
    # Cells at the borders of obstacles may fall on the other side; thin walls are mostly border.
    differing = (patch != straight).mean()
    assert differing < 0.08
    assert heading % 16 or differing == 0


def test_slopes_and_kerbs_come_after_all_older_categories():
    # The position of a category is part of the seed for its maps.
    assert ALL_CATEGORIES[9:15] == ("mixed_2", "mixed_3", "mixed_4", "ramp_mixed", "tiles_mixed", "clutter")
    assert ALL_CATEGORIES[15:] == SLOPE_CATEGORIES and len(set(ALL_CATEGORIES)) == len(ALL_CATEGORIES)


def test_slopes_and_kerbs_lie_in_their_ranges():
    angles = []
    for index in range(60):
        plane = random_scene(1, "plane_clutter", index)
        angles.append(math.atan(math.hypot(plane.ground.slope_x, plane.ground.slope_y)))
        assert len(plane.obstacles) == 3 and not random_scene(1, "plane", index).obstacles
        (ramp,) = random_scene(1, "long_ramp", index).obstacles
        assert 0.05 <= math.atan(ramp.height / ramp.run) <= 0.35 and 1.0 <= ramp.run <= 4.0
        assert math.isclose(ramp.length - ramp.run, 2.0) and random_scene(1, "long_ramp", index).ground is None
        along = [end - ramp.length / 2 for end in (0.0, ramp.run)]  # its foot and its top
        places = [(ramp.x + a * math.cos(ramp.yaw), ramp.y + a * math.sin(ramp.yaw)) for a in along]
        assert any(max(abs(x), abs(y)) <= 0.9 for x, y in places)
        assert all(isinstance(block, Tilted) for block in random_scene(1, "tilted_2", index).obstacles)
        for category, low, high in (("kerb", 0.0, 0.0), ("kerb_smeared", 0.05, 0.15)):
            (kerb,) = random_scene(1, category, index).obstacles
            assert isinstance(kerb, Bank) and low <= kerb.run <= high and 0.05 <= kerb.height <= 0.2
    assert 0.03 <= min(angles) < 0.1 and 0.3 < max(angles) <= 0.35  # both sides of the limit of robots


def test_the_start_is_at_the_centre_of_the_middle_cell_and_at_world_zero():
    terrain = random_map(1, "cuboid_1", 0)
    assert terrain.shape == (72, 72)
    assert terrain.height_at(0.0, 0.0) == terrain.heights[36, 36]
    np.testing.assert_allclose(terrain.origin, -36.5 * CELL)


@given(seeds, st.permutations(range(6)))
def test_maps_do_not_depend_on_the_order_in_which_they_are_made(seed, order):
    names = [(CATEGORIES[k % 9], k // 2) for k in range(6)]
    straight = {name: random_scene(seed, *name) for name in names}
    assert all(random_scene(seed, *names[k]) == straight[names[k]] for k in order)


def test_seed_category_and_index_each_give_another_map():
    scenes = [random_scene(seed, category, index) for seed in (1, 2) for category in CATEGORIES for index in (0, 1)]
    positions = {(scene.obstacles[0].x, scene.obstacles[0].y) for scene in scenes}
    assert len(positions) == len(scenes)


def test_a_map_stays_the_same_from_version_to_version():
    # Labels identify maps by (seed, category, index); with other numbers here all labels would be wrong.
    stairs = random_scene(1, "staircase_focused", 7).obstacles[0]
    assert (stairs.steps, round(stairs.x, 9), round(stairs.rise, 9)) == (2, 0.468219536, 0.285411001)


def test_ranges_are_used_evenly_to_their_ends():
    cuboids = [random_scene(5, "cuboid_1", index).obstacles[0] for index in range(2000)]
    for name, low, high in [("length", 0.2, 2.0), ("width", 0.2, 2.0), ("height", 0.02, 0.4), ("x", -0.9, 0.9)]:
        values = np.array([getattr(cuboid, name) for cuboid in cuboids])
        counts, _ = np.histogram(values, bins=8, range=(low, high))
        assert counts.sum() == 2000 and abs(counts - 250).max() < 5 * math.sqrt(250), name
    steps = [random_scene(5, "staircase", index).obstacles[0].steps for index in range(300)]
    assert min(np.bincount(steps)[2:]) > 60


def test_settings_change_what_is_drawn():
    scene = random_scene(1, "cuboid_1", 0, replace(TerrainSettings(), cuboid_height=(1.5, 1.6)))
    assert 1.5 <= scene.obstacles[0].height <= 1.6


@pytest.mark.parametrize("name", [field.name for field in fields(TerrainSettings)])
def test_settings_out_of_range_are_named(name):
    for wrong in (-1.0, (2.0, 1.0), (0.0, 1.0), "high", (1.0, math.inf)):
        with pytest.raises(InputError, match=rf"TerrainSettings\.{name}"):
            TerrainSettings(**{name: wrong})
    with pytest.raises(InputError, match=r"staircase_steps\[1\] is 3\.5; need a whole number"):
        TerrainSettings(staircase_steps=(2, 3.5))


def test_wrong_names_of_maps_are_refused():
    with pytest.raises(InputError, match="category 'ramp'; need one of cuboid_1"):
        random_map(1, "ramp", 0)
    with pytest.raises(InputError, match="seed -1"):
        random_map(-1, "wall_1", 0)
