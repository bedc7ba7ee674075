import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from hdsp.base.errors import InputError
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.map_frame import MapFrame
from tests import naive_terrain

RESOLUTION = 0.025
finite = st.floats(-5, 5, width=32)
heights_with_gaps = hnp.arrays(
    np.float32, hnp.array_shapes(min_dims=2, max_dims=2, max_side=12), elements=finite | st.just(math.nan)
)


def numbered(nx, ny, **placement):
    """A map with all heights different."""
    return HeightMap(np.arange(nx * ny, dtype=np.float32).reshape(nx, ny), **placement)


def pose_of(terrain, ix, iy, theta=0.0):
    return (*(np.array((ix, iy)) + 0.5) * terrain.resolution + terrain.origin, theta)


@settings(max_examples=40, deadline=None)
@given(
    heights=heights_with_gaps,
    origin=st.tuples(finite, finite),
    resolution=st.floats(0.01, 0.5),
    suffix=st.sampled_from([".npz", ".h5", ".hdf5"]),
)
def test_a_saved_map_is_loaded_as_it_was(tmp_path_factory, heights, origin, resolution, suffix):
    path = tmp_path_factory.mktemp("maps") / f"map{suffix}"
    HeightMap(heights, origin, resolution).save(path)
    loaded = HeightMap.load(path)
    np.testing.assert_array_equal(loaded.heights, heights)
    assert (loaded.origin, loaded.resolution) == (origin, resolution)
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_heights_cannot_be_changed_and_do_not_follow_what_they_were_made_from():
    source = np.zeros((3, 4), np.float32)
    terrain = HeightMap(source)
    source[0, 0] = 1
    assert terrain.heights[0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        terrain.heights[0, 0] = 1


@pytest.mark.parametrize("kind", [complex, bool, str, "datetime64[s]", "timedelta64[s]"])
def test_heights_of_another_type_than_numbers_are_refused(kind):
    with pytest.raises(InputError, match=r"height map: heights have the type .*; need numbers in metres"):
        HeightMap(np.zeros((4, 4), int).astype(kind))
    with pytest.raises(InputError, match="heights have the type"):
        HeightMap([["1", "2"], ["3", "4"]])
    assert HeightMap(np.zeros((2, 2), object)).shape == (2, 2)


def test_half_precision_heights_far_from_zero_bring_a_warning(tmp_path, recwarn):
    near, far = np.full((4, 4), 3.1, np.float16), np.full((4, 4), 312.4, np.float16)
    far[0, 0] = np.nan
    HeightMap(near)
    assert not recwarn.list
    words = r"heights are float16, with steps of 0\.25 m at 312\.5 m; need float32"
    with pytest.warns(UserWarning, match=words):
        HeightMap(far)
    np.save(tmp_path / "a.npy", far)
    assert re.match(words, HeightMap.load(tmp_path / "a.npy", resolution=0.05).frame.notes[0])


@pytest.mark.parametrize("dtype", [np.float32, np.int16])
def test_m6_masked_cells_are_unknown(dtype):
    heights = np.ma.masked_array(np.arange(6).reshape(2, 3).astype(dtype), mask=[[0, 1, 0], [0, 0, 1]])
    heights.data[0, 1] = 99 if dtype == np.int16 else np.inf
    np.testing.assert_array_equal(HeightMap(heights).heights, [[0, math.nan, 2], [3, 4, math.nan]])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([[0.0, math.inf]],), r"cell \(0, 1\) is infinite"),
        (([[0.0, 1e300]],), r"cell \(0, 1\) is infinite"),
        (([1.0, 2.0],), r"shape \(2,\)"),
        ((np.zeros((0, 3)),), r"shape \(0, 3\)"),
        ((np.zeros((2, 2)), (0, math.nan)), "origin"),
        ((np.zeros((2, 2)), (0, 0, 0)), "origin"),
        ((np.zeros((2, 2)), (0, 0), 0.0), "resolution is 0.0"),
        ((np.zeros((2, 2)), (0, 0), math.nan), "resolution is nan"),
        ((np.zeros((2, 2)), (0, 0), "0.1"), "resolution is '0.1'"),
        ((np.zeros((2, 2)), (0, 0), True), "resolution is True"),
        ((np.zeros((2, 2)), "12"), "origin is '12'"),
        ((np.zeros((2, 2)), (True, 0)), r"origin is \[True, 0\]"),
        (("high",), "2D array"),
        (([[10**400, 0]],), "2D array"),
        ((np.zeros((2, 2)), (10**400, 0)), "origin"),
        ((np.zeros((2, 2)), (0, 0), 10**400), "resolution"),
    ],
)
def test_invalid_maps_are_refused_by_name(arguments, words):
    with pytest.raises(InputError, match=words):
        HeightMap(*arguments)


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_damaged_files_end_in_one_line_that_names_them(tmp_path, suffix):
    path = tmp_path / f"map{suffix}"
    numbered(20, 20).save(path)
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(InputError, match=path.name) as error:
        HeightMap.load(path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_h9_flipped_bytes_never_give_another_map_silently_or_another_error(tmp_path, suffix):
    path = tmp_path / f"map{suffix}"
    terrain = HeightMap(np.random.default_rng(0).random((12, 12)), (3.5, -2.25), 0.05)
    terrain.save(path)
    content = path.read_bytes()
    small = [content.index(np.float64(value).tobytes()) for value in (3.5, 0.05)] if suffix == ".h5" else []
    for place in [*range(0, len(content), max(1, len(content) // 120)), *(at + k for at in small for k in range(8))]:
        path.write_bytes(content[:place] + bytes([content[place] ^ 0x55]) + content[place + 1 :])
        try:
            loaded = HeightMap.load(path)
        except InputError:
            continue
        np.testing.assert_array_equal(loaded.heights, terrain.heights)
        assert (loaded.origin, loaded.resolution) == (terrain.origin, terrain.resolution)


def test_files_that_are_no_maps_are_refused(tmp_path):
    np.savez(tmp_path / "other.npz", depth=np.zeros(3))
    with pytest.raises(InputError, match=r"other\.npz: entry heights is missing"):
        HeightMap.load(tmp_path / "other.npz")
    with pytest.raises(InputError, match=r"none\.npz: no such file"):
        HeightMap.load(tmp_path / "none.npz")
    with pytest.raises(InputError, match=r"suffix '\.docx'; need one of \.npz, .*\(height maps\) or \.pcd, "):
        HeightMap.load(tmp_path / "map.docx")
    with pytest.raises(InputError, match=r"suffix '\.txt'"):
        numbered(2, 2).save(tmp_path / "map.txt")
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot write"):
        numbered(2, 2).save(tmp_path / "file" / "map.npz")


def test_height_at_follows_the_convention_of_cells():
    terrain = numbered(4, 3, origin=(1.0, -1.0), resolution=0.5)
    assert terrain.size == (2.0, 1.5)
    assert terrain.height_at(1.0, -1.0) == 0
    assert terrain.height_at(1.49, -1.0) == 0
    assert terrain.height_at(1.5, -1.0) == terrain.heights[1, 0]
    assert terrain.height_at(1.25, -0.25) == terrain.heights[0, 1]
    outside = terrain.height_at(np.array([0.99, 3.0, 1.2]), np.array([-0.9, -0.9, 0.5]))
    assert np.isnan(outside).all()


def test_a_patch_at_heading_0_is_a_slice_with_the_base_at_its_origin():
    terrain = numbered(100, 90, origin=(3.0, -2.0))
    patch = terrain.crop(pose_of(terrain, 50, 40))
    np.testing.assert_array_equal(patch.heights, terrain.heights[14:86, 4:76])
    assert patch.height_at(0.0, 0.0) == terrain.heights[50, 40]
    assert patch.height_at(0.05, -0.025) == terrain.heights[52, 39]


@given(st.integers(0, 29), st.integers(0, 19), st.integers(0, 3), st.integers(1, 16))
def test_at_quarter_turns_a_patch_is_an_exact_permutation_of_cells(ix, iy, quarter, cells):
    terrain = numbered(30, 20, origin=(-0.3, 0.7))
    patch = terrain.crop(pose_of(terrain, ix, iy, quarter * math.pi / 2), cells).heights
    c, s = [(1, 0), (0, 1), (-1, 0), (0, -1)][quarter]
    for i in range(cells):
        for j in range(cells):
            ahead, left = i - cells // 2, j - cells // 2
            x, y = ix + c * ahead - s * left, iy + s * ahead + c * left
            inside = 0 <= x < 30 and 0 <= y < 20
            assert patch[i, j] == terrain.heights[x, y] if inside else np.isnan(patch[i, j])


@settings(max_examples=30, deadline=None)
@given(x=st.floats(-0.2, 1.2), y=st.floats(-0.2, 0.9), theta=st.floats(-7, 7))
def test_a_patch_at_any_pose_equals_its_definition(x, y, theta):
    terrain = HeightMap(np.random.default_rng(1).random((40, 28)), origin=(0.011, -0.003))
    patch = terrain.crop((x, y, theta), 12).heights
    # The definition does not assign a sample on the border between two cells to one of them.
    beside = [(x + dx, y + dy, theta) for dx in (-1e-7, 1e-7) for dy in (-1e-7, 1e-7)]
    expected = [naive_terrain.crop(terrain.heights, terrain.origin, RESOLUTION, pose, 12) for pose in beside]
    assert np.any([np.isclose(patch, each, atol=0, equal_nan=True) for each in expected], axis=0).all()


@pytest.mark.parametrize("pose", [(0.0, 0.0), (0.0, math.nan, 0.0), ("a", 0, 0), (10**400, 0, 0)])
def test_a_pose_that_is_none_is_refused(pose):
    with pytest.raises(InputError, match="pose"):
        numbered(4, 4).crop(pose)


@pytest.mark.parametrize("angle", [math.nan, math.inf, -math.inf, "a", None, 10**400, [1.0, 2.0]])
def test_an_angle_that_is_none_is_refused(angle):
    with pytest.raises(InputError, match="; need a finite number of radians"):
        numbered(4, 4).rotate(angle)


def framed():
    """A map with a frame of its own."""
    motion = np.eye(4)
    motion[:2, :2], motion[:3, 3] = [[0.6, -0.8], [0.8, 0.6]], (100.0, -20.0, 3.0)
    return numbered(31, 23, origin=(1.0, -2.0)), MapFrame("odom", "EPSG:25832", motion, ("a note",))


@given(st.floats(-4, 4) | st.integers(-5, 5).map(lambda quarters: quarters * math.pi / 2))
def test_a_rotated_map_leads_to_the_same_source(angle):
    plain, frame = framed()
    for terrain in (plain, HeightMap(plain.heights, plain.origin, plain.resolution, frame)):
        rotated = terrain.rotate(angle)
        assert (rotated.frame.name, rotated.frame.crs, rotated.frame.notes) == (
            terrain.frame.name,
            terrain.frame.crs,
            terrain.frame.notes,
        )
        c, s = math.cos(angle), math.sin(angle)
        x, y = np.random.default_rng(2).uniform(-0.3, 0.3, (2, 20))
        turned = np.column_stack([c * x - s * y, s * x + c * y]) + rotated.center
        places = np.column_stack([x, y]) + terrain.center
        np.testing.assert_allclose(
            rotated.frame.points_to_source(np.column_stack([turned, x])),
            terrain.frame.points_to_source(np.column_stack([places, x])),
            atol=1e-9,
        )


def test_a_turned_map_is_not_its_source_until_it_is_turned_back():
    terrain = numbered(30, 20, origin=(1.0, 2.0))
    for quarters in (1, 2, 3):
        turned = terrain.rotate(quarters * math.pi / 2)
        assert not turned.frame.is_source and turned.rotate(-quarters * math.pi / 2).frame.is_source
    assert terrain.rotate(2 * math.pi).frame.is_source and terrain.rotate(0).frame.is_source


def test_a_patch_leads_to_the_source_of_its_map():
    plain, frame = framed()
    terrain = HeightMap(plain.heights, plain.origin, plain.resolution, frame)
    pose = (1.31, -1.77, 0.7)
    at_cell = (*np.add(terrain.origin, (12.5 * RESOLUTION, 9.5 * RESOLUTION)), math.pi / 4)
    for patch, (x, y, theta) in ((terrain.crop(pose, 8), pose), (terrain.crop_cells(12, 9, 8, 8), at_cell)):
        assert (patch.frame.name, patch.frame.crs, patch.frame.notes) == ("odom", "EPSG:25832", ("a note",))
        ahead = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.2]])
        c, s = math.cos(theta), math.sin(theta)
        in_map = [(x + c * u - s * v, y + s * u + c * v, z) for u, v, z in ahead]
        expected = terrain.frame.points_to_source(in_map)
        np.testing.assert_allclose(patch.frame.points_to_source(ahead), expected, atol=1e-12)


@pytest.mark.parametrize("cells", [3.0, np.float64(3), np.int8(3), np.array(3)])
def test_a_whole_number_of_any_type_is_a_side(cells):
    terrain = numbered(6, 6)
    for patch in (terrain.crop((0.0625, 0.0625, 0.0), cells), terrain.crop_cells(2, 2, 0, cells)):
        np.testing.assert_array_equal(patch.heights, terrain.heights[1:4, 1:4])
    assert HeightMap.flat((4, cells)).shape == (4, 3)


@pytest.mark.parametrize("cells", [0, -1, 1.5, "3", None, 10**400, True, np.bool_(True)])
def test_a_side_that_is_none_is_refused(cells):
    with pytest.raises(InputError, match=r"patch of .* need a whole number from 1 to 10,000"):
        numbered(4, 4).crop((0.0, 0.0, 0.0), cells)
    with pytest.raises(InputError, match="shape"):
        HeightMap.flat((4, cells))


@pytest.mark.parametrize("motion", ["x", None, [[1, 2], [3]], [[10**400] * 4] * 4])
def test_a_frame_that_is_none_is_refused(motion):
    with pytest.raises(InputError, match=r"to_source is .*; need a rigid motion"):
        MapFrame(to_source=motion)


@given(st.integers(1, 9), st.integers(1, 9), st.integers(-5, 5))
def test_four_quarter_turns_bring_a_map_back(nx, ny, quarters):
    terrain = numbered(nx, ny, origin=(1.0, 2.0))
    rotated = terrain.rotate(quarters * math.pi / 2)
    assert sorted(rotated.heights.ravel()) == sorted(terrain.heights.ravel())
    np.testing.assert_allclose(rotated.center, terrain.center)
    back = rotated.rotate(-quarters * math.pi / 2)
    np.testing.assert_array_equal(back.heights, terrain.heights)
    np.testing.assert_allclose(back.origin, terrain.origin, atol=1e-12)


def test_a_quarter_turn_goes_from_x_to_y():
    rotated = numbered(3, 2).rotate(math.pi / 2)
    # Cells ahead of the centre, at +x, are now to its left, at +y.
    np.testing.assert_array_equal(rotated.heights[:, -1], numbered(3, 2).heights[-1, ::-1])


@given(st.floats(-4, 4))
def test_a_rotated_map_has_every_height_where_the_turn_takes_it(angle):
    terrain = numbered(31, 23)
    rotated = terrain.rotate(angle)
    c, s = math.cos(angle), math.sin(angle)
    for ix, iy in [(15, 11), (3, 4), (29, 20), (2, 19)]:
        x, y = np.array(pose_of(terrain, ix, iy)[:2]) - terrain.center
        found = rotated.height_at(rotated.center[0] + c * x - s * y, rotated.center[1] + s * x + c * y)
        jx, jy = divmod(int(found), 23)
        assert abs(jx - ix) <= 1 and abs(jy - iy) <= 1
