import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hdsp.base.errors import InputError
from hdsp.terrain.pointcloud import FloorSettings, Plane, describe_points, fit_floor, level, register
from tests.terrain.pointcloud.clouds import moved, rectangle, room, wall


@settings(max_examples=10)
@given(st.floats(-9, 9), st.floats(-9, 9), st.floats(-3, 3), st.integers(0, 99))
def test_a_tilted_floor_is_found_to_a_centimetre_and_half_a_degree(roll, pitch, height, seed):
    cloud = moved(room(noise=0.01, seed=seed, ceiling=2.5), roll, pitch, shift=(0.3, -0.2, height))
    floor = fit_floor(cloud)
    true_normal = Rotation.from_euler("xyz", [roll, pitch, 0], degrees=True).apply([0, 0, 1])
    assert math.degrees(math.acos(min(1, floor.normal @ true_normal))) < 0.5
    on_floor = np.array([0.3, -0.2, height])  # the floor's origin after the motion
    assert abs(floor.heights(on_floor[None])[0]) < 0.01
    levelled = level(cloud, floor)
    assert abs(np.median(levelled[: 200 * 150 // 4][:, 2])) < 0.01
    assert fit_floor(levelled).tilt < math.radians(0.1)


def test_the_floor_is_the_lowest_large_plane_not_the_largest():
    landing = rectangle((2, 6), (-2, 2), 0.64)
    floor = fit_floor(np.concatenate([rectangle((0, 2), (-1, 1), 0.0), landing, rectangle((0, 6), (-2, 2), 2.6)]))
    assert floor.offset == pytest.approx(0.0, abs=0.005)


def test_a_few_reflections_below_the_floor_are_not_the_floor():
    mirrored = rectangle((0, 0.5), (0, 0.5), -0.8)
    assert fit_floor(np.concatenate([room(), mirrored])).offset == pytest.approx(0.0, abs=0.005)


def test_dense_ground_near_the_sensor_weighs_no_more_than_the_rest():
    dense = rectangle((0, 0.4), (0, 0.4), 0.04, spacing=0.002)  # a plate with more points than the whole floor
    assert fit_floor(np.concatenate([room(), dense])).offset == pytest.approx(0.0, abs=0.005)


def test_without_a_nearly_horizontal_plane_there_is_no_floor():
    with pytest.raises(InputError, match="no floor among 10000 points: no plane within 15 degrees"):
        fit_floor(wall(0.0, (0, 2), (0, 2)))
    steep = moved(rectangle((0, 2), (0, 2), 0), pitch=25)
    with pytest.raises(InputError, match="no floor"):
        fit_floor(steep)
    assert fit_floor(steep, FloorSettings(max_tilt=0.6)).tilt == pytest.approx(math.radians(25), abs=0.01)


def test_levelling_moves_no_point_far_even_with_coordinates_of_a_survey():
    far = moved(room(), pitch=2) + (4.5e5, 5.6e6, 60.0)
    levelled = level(far, fit_floor(far))
    assert np.abs(levelled[:, :2] - far[:, :2]).max() < 0.05
    assert abs(np.median(levelled[:, 2])) < 0.01


@settings(max_examples=3)
@given(st.floats(-0.25, 0.25), st.floats(-0.25, 0.25), st.floats(-8, 8), st.integers(0, 99))
def test_a_second_scan_is_laid_on_the_first(x, y, yaw, seed):
    first = np.concatenate([room(seed=seed), wall(-2, (-1.5, 1.5), (0, 1.5)), wall(2, (-1.5, 1.0), (0, 1.5))])
    across = wall(-1.5, (-2, 2), (0, 1.5))[:, [1, 0, 2]]
    first = np.concatenate([first, across])
    true = np.eye(4)
    true[:3, :3] = Rotation.from_euler("z", yaw, degrees=True).as_matrix()
    true[:3, 3] = x, y, 0.02
    second = (first - true[:3, 3]) @ true[:3, :3]
    found = register(second, first)
    np.testing.assert_allclose(found, true, atol=0.01)


def test_clouds_that_do_not_overlap_are_refused():
    with pytest.raises(InputError, match=r"registration: 0 pairs of points within 0\.50 m"):
        register(room(), room() + (50, 0, 0))


@pytest.mark.parametrize("name", ["max_tilt", "thickness", "voxel", "reach"])
def test_settings_out_of_range_are_named(name):
    with pytest.raises(InputError, match=rf"FloorSettings\.{name} is -1; need a positive number"):
        FloorSettings(**{name: -1})


FEW = rectangle((0, 0.1), (0, 0.1), 0)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: fit_floor(np.zeros((0, 3))), "points: there is no point"),
        (lambda: fit_floor("cloud.pcd"), "points are 'cloud"),
        (lambda: fit_floor([[1, 2, 3], [1, 2]]), "points are"),
        (lambda: fit_floor(np.full((4, 3), np.nan)), "points: 4 of 4 are not finite"),
        (lambda: fit_floor(np.array([[0, 0, 0], [1e30, 1, 1]])), "too much for voxels of 0.05 m; are they in metres"),
        (lambda: fit_floor(np.array([[0, 0, 0], [1e308, -1e308, 1]])), "too much for voxels"),
        (lambda: fit_floor(np.zeros((5, 3))), "no floor among 5 points"),
        (lambda: fit_floor(room(), "steep"), "settings is 'steep'"),
        (lambda: level(np.zeros((0, 3)), Plane(np.array([0, 0, 1.0]), 0.0, 9)), "there is no point"),
        (lambda: register(room(), FEW), "a target of [0-9] voxels; need at least 10"),
        (lambda: register(FEW, room()), r"registration: \d pairs"),
        (lambda: register(np.zeros((0, 3)), room()), "points: there is no point"),
        (lambda: register(room(), "cloud.pcd"), "points of the target are 'cloud"),
        (lambda: register(room(), room(), guess=(1, 2, 3)), r"guess is \[1, 2, 3\]; need a motion \[4, 4\]"),
        (lambda: register(room(), room(), guess="near"), "guess is 'near'"),
        (lambda: register(room(), room(), reach=0), "reach is 0; need a positive number of metres"),
        (lambda: register(room(), room(), voxel="fine"), "voxel is 'fine'"),
        (lambda: describe_points(np.zeros((0, 3))), "there is no point"),
        (lambda: describe_points(None), "points"),
    ],
)
def test_clouds_and_arguments_that_are_none_are_refused(call, words):
    with pytest.raises(InputError, match=words):
        call()


@pytest.mark.parametrize("points", [[[0, 0, 0]], [[0, 0, 0], [1, 1, 0]], (np.eye(3) * 9).tolist()])
def test_clouds_of_few_points_are_described(points):
    assert describe_points(points).startswith(f"{len(points)} points")
