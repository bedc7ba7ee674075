import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hdsp.base.errors import InputError
from hdsp.robot.lattice import HEADINGS, heading_angle
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.patches import crop_patches, patch_offsets
from hdsp.terrain.pointcloud import Camera, depth_points


@given(st.integers(0, HEADINGS - 1), st.sampled_from([72, 71, 8]))
def test_offsets_turn_exactly_with_every_quarter_turn(heading, cells):
    dx, dy = patch_offsets(float(heading_angle(heading)), cells)
    rotated_x, rotated_y = patch_offsets(float(heading_angle(heading + HEADINGS // 4)), cells)
    np.testing.assert_array_equal(rotated_x, -dy)
    np.testing.assert_array_equal(rotated_y, dx)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(st.integers(-3, 143), st.integers(-3, 123), st.integers(0, 63)), min_size=1, max_size=6),
    st.sampled_from([72, 9]),
)
def test_batched_patches_equal_single_ones(states, cells):
    terrain = HeightMap(np.random.default_rng(2).random((140, 120)), origin=(5.0, -3.0))
    states = np.array(states)
    patches = crop_patches(terrain.heights, states[:, :2], states[:, 2], cells)
    assert patches.dtype == np.float32
    for patch, (ix, iy, heading) in zip(patches, states, strict=True):
        np.testing.assert_array_equal(patch, terrain.crop_cells(ix, iy, heading, cells).heights)
        center = (np.array((ix, iy)) + 0.5) * terrain.resolution + terrain.origin
        np.testing.assert_array_equal(patch, terrain.crop((*center, heading_angle(heading)), cells).heights)


def test_one_heading_serves_all_patches_and_wrong_shapes_are_refused():
    heights = np.arange(120 * 120, dtype=np.float32).reshape(120, 120)
    bases = np.array([[60, 60], [59, 61]])
    np.testing.assert_array_equal(crop_patches(heights, bases, 16), crop_patches(heights, bases, [16, 80]))
    np.testing.assert_array_equal(crop_patches(heights, bases, 16, 8.0), crop_patches(heights, bases, 16, 8))
    out = np.zeros((2, 72, 72), np.float32)
    assert crop_patches(heights, bases, 16, out=out) is out
    np.testing.assert_array_equal(out, crop_patches(heights, bases, 16))
    with pytest.raises(InputError, match="out is float32"):
        crop_patches(heights, bases, 16, out=out[:1])
    with pytest.raises(InputError, match=r"bases \(2,\)"):
        crop_patches(heights, np.array([60, 60]), 0)


def test_m6_masked_cells_are_unknown_in_patches_and_clouds():
    heights = np.ma.masked_array(np.zeros((9, 9)), mask=np.eye(9, dtype=bool))
    (patch,) = crop_patches(heights, [[4, 4]], 0, 9)
    assert (np.isnan(patch) == np.eye(9, dtype=bool)).all()
    image = np.ma.masked_array(np.ones((2, 2)), mask=[[True, False], [False, False]])
    assert len(depth_points(image, Camera(1.0, 1.0, 0.0, 0.0, depth_scale=1.0, nearest=0.1, farthest=9.0))) == 3
