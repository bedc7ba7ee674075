import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hdsp.robot import lattice
from hdsp.terrain.obstacles import Bank, Block, Ramp, Scene, Staircase, Tiles, Tilted, TiltedGround
from tests import naive_terrain

CELL = 0.025


def test_the_first_riser_is_at_the_position_and_the_last_step_is_two_metres_deep():
    stairs = Staircase(0.5 - CELL / 2, 0.0, 0.0, steps=3, rise=0.2, tread=0.3, width=1.0, depth=2.0)
    profile = Scene((stairs,)).rasterise((160, 41), (20, 20)).heights[:, 20]
    rises = np.flatnonzero(np.diff(profile)) + 1 - 20
    np.testing.assert_allclose(rises * CELL, [0.5, 0.8, 1.1, 3.1], atol=1e-6)
    np.testing.assert_allclose(np.diff(profile)[rises + 19], [0.2, 0.2, 0.2, -0.6], atol=1e-6)


@settings(max_examples=20, deadline=None)
@given(
    st.floats(-0.9, 0.9),
    st.floats(-0.9, 0.9),
    st.floats(-3.1, 3.1),
    st.floats(0.05, 3),
    st.floats(0.05, 3),
    st.floats(0.1, 2),
)
def test_cells_take_the_height_at_their_centre(x, y, yaw, length, width, height):
    block = Block(x, y, yaw, length, width, height)
    heights = Scene((block,)).rasterise((24, 20), (12, 9)).heights
    expected = [
        [height if naive_terrain.block_covers(block, (i - 12) * CELL, (j - 9) * CELL) else 0.0 for j in range(20)]
        for i in range(24)
    ]
    np.testing.assert_allclose(heights, expected, rtol=1e-6)


def test_where_obstacles_overlap_the_highest_counts():
    low, high = Block(0, 0, 0, 1, 1, 0.1), Block(0.2, 0, 0, 0.2, 2, 0.8)
    one, other = (Scene(obstacles).rasterise((60, 60), (20, 20)).heights for obstacles in ((low, high), (high, low)))
    np.testing.assert_array_equal(one, other)
    assert one[28, 20] == np.float32(0.8) and one[20, 20] == np.float32(0.1) and one[59, 59] == 0


@settings(max_examples=20, deadline=None)
@given(st.floats(-0.9, 0.9), st.floats(-0.9, 0.9), st.floats(-3.1, 3.1), st.floats(0.05, 1.5), st.floats(0.05, 1))
def test_a_bank_rises_over_its_run_and_is_level_behind(x, y, yaw, run, height):
    def heights(run, along):
        at = np.array(along) - (run + 1.0) / 2
        bank = Bank(x, y, yaw, run + 1.0, 2.0, height, run)
        return Scene((bank,)).heights_at(x + at * np.cos(yaw), y + at * np.sin(yaw))

    slope = heights(run, [-0.01, run / 4, run / 2, run + 0.01, run + 0.99, run + 1.01])
    np.testing.assert_allclose(slope, [0.0, height / 4, height / 2, height, height, 0.0], atol=1e-6)
    np.testing.assert_allclose(heights(0.0, [-0.01, 0.01, 0.99]), [0.0, height, height], atol=1e-6)


def test_a_tilted_block_has_its_height_in_the_middle_and_ends_at_the_ground():
    block = Tilted(0.5, 0.0, np.pi / 2, 1.0, 2.0, 0.1, slope_along=0.4, slope_across=0.05)  # its length is along y
    x, y = np.array([0.5, 0.5, 0.5, 0.3, 0.5]), np.array([0.0, 0.4, -0.3, 0.0, 0.6])
    np.testing.assert_allclose(Scene((block,)).heights_at(x, y), [0.1, 0.26, 0.0, 0.11, 0.0], atol=1e-6)


def test_obstacles_stand_on_tilted_ground_and_turn_with_it():
    scene = Scene((Block(0.0, 0.0, 0.0, 0.4, 0.4, 0.1),), TiltedGround(0.2, -0.1))
    x, y = np.array([0.0, 0.1, 1.0]), np.array([0.0, 0.1, 2.0])
    np.testing.assert_allclose(scene.heights_at(x, y), [0.1, 0.11, 0.0], atol=1e-6)
    straight, turned = (scene.rasterise((41, 41), (20, 20), angle).heights for angle in (0.0, np.pi / 2))
    np.testing.assert_allclose(turned, np.rot90(straight), atol=1e-6)


TILES = Tiles(
    0.3, -0.2, 0.7, 1.0, 0.7, 0.3, 0.4, tuple(tuple((0.2, 0.1 * i, 0.2 * j) for j in (1, 2)) for i in range(3))
)


@pytest.mark.parametrize(
    "block",
    [
        Block(0.1, 0.2, 0.3, 1.0, 0.5, 0.2),
        Ramp(0.1, 0.2, 2.0, 1.0, 0.5, 0.2),
        Bank(0.1, 0.2, -1.0, 1.5, 0.5, 0.2, 0.4),
        Bank(0.1, 0.2, -1.0, 1.5, 0.5, 0.2, 0.0),
        Tilted(0.1, 0.2, 1.0, 1.0, 0.5, 0.3, 0.2, -0.3),
        TILES,
    ],
)
def test_the_faces_of_a_block_make_up_its_upper_side(block):
    x, y = np.random.default_rng(0).uniform(-1, 1, (2, 3000))
    found = np.zeros(x.shape)
    for face in block.faces():
        turn = lattice.rotation(-face.yaw)
        along, across = turn @ (x - face.x, y - face.y)
        on = (abs(along) <= face.length / 2) & (abs(across) <= face.width / 2)
        found[on] = np.maximum(face.height + face.slope_along * along + face.slope_across * across, 0.0)[on]
    np.testing.assert_allclose(found, Scene((block,)).heights_at(x, y), atol=1e-6)
