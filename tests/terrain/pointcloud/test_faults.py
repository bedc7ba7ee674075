import numpy as np
import pytest

from hdsp.base.errors import InputError
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.pointcloud import MapSettings, describe_points, map_points
from tests.terrain.pointcloud.clouds import moved, rectangle, room, wall

FLOOR = rectangle((0, 4), (0, 4), 0.0) + np.random.default_rng(0).normal(0, 0.003, (40000, 3))
FAR = [[900, 700, 1]]


@pytest.mark.parametrize("cloud", [FLOOR, moved(FLOOR, 2, -1)])
def test_m9_the_box_is_cut_before_the_extent_is_judged(cloud):
    crowd = np.random.default_rng(1).uniform(500, 3000, (2000, 3))
    for far in (FAR, crowd):
        terrain = HeightMap.from_points(np.concatenate([cloud, far]), MapSettings(box=(0, 0, 4, 4)))
        assert terrain.size == pytest.approx((4, 4), abs=0.06)
        assert np.nanmax(np.abs(terrain.heights)) < 0.02
    with pytest.raises(InputError, match=r"none is left in the box .*they span x .* to 900"):
        map_points(np.concatenate([cloud, FAR]), MapSettings(box=(50, 50, 60, 60)))


def test_coordinates_of_a_projected_cloud_keep_their_decimals_in_messages():
    cloud = FLOOR + (412345.678, 5654321.25, 0)
    with pytest.raises(InputError, match=r"they span x 41\d{4}\.\d+ to 41\d{4}\.\d+, y 565\d{4}\.\d+ to 565"):
        map_points(cloud, MapSettings(box=(50, 50, 60, 60)))
    mapped = map_points(np.concatenate([cloud, [[412999.125, 5654999.5, 1]]]))
    assert any("e.g. (412999.12, 5654999.5, 1)" in note for note in mapped.report.notes)


def test_coordinates_of_a_survey_that_went_through_float32_are_refused():
    cloud = (FLOOR + (412345.678, 5654321.123, 312.4)).astype(np.float32)
    with pytest.raises(InputError, match=r"x has steps of 0\.03125 m, as float32 has at 412,34\d m; need float64, or"):
        map_points(cloud)
    assert "x has steps of 0.03125 m" in describe_points(cloud)
    with pytest.raises(InputError, match=r"y has steps of 0\.5 m, as float32 has at 5,654,32\d m"):
        map_points(cloud, resolution=0.2)
    assert map_points((FLOOR + (412, 565, 312)).astype(np.float32)).heights.shape[0] >= 160
    assert map_points(np.round(FLOOR + (412345.678, 5654321.123, 312.4), 2)).heights.shape[0] >= 160


@pytest.mark.parametrize("resolution", ["0.05", np.nan, 0, -1, True, None, np.inf, [0.05], 10**400, 1e-300, 1e5])
def test_a_resolution_is_looked_at_before_the_points(resolution):
    with pytest.raises(InputError, match=r"^resolution is .*; need 0\.0001 to 10000 metres per cell$"):
        HeightMap.from_points(FLOOR, resolution=resolution)


def test_m9_lone_points_far_away_are_left_out_and_said():
    terrain = HeightMap.from_points(np.concatenate([FLOOR, FAR, [[2, 2, -4000]]]))
    assert terrain.size == pytest.approx((4, 4), abs=0.06)
    assert any("2 lone points far away left out, e.g. (900, 700, 1)" in note for note in terrain.frame.notes)
    with pytest.raises(InputError, match=r"span 3004 x 2004 x .*cut a box out of them: most lie in x 0\.\d+ to 3003"):
        HeightMap.from_points(np.concatenate([FLOOR, FLOOR + (3000, 2000, 0)]))


@pytest.mark.parametrize(
    ("value", "share", "base"),
    [(-9999.0, 0.3, 0), (-9999.0, 0.7, 59.2), (-32768.0, 0.7, 0), (1e30, 0.3, 0), (3.4e38, 0.3, 59.2), (-99.0, 0.7, 0),
     (65.535, 0.3, 0), (0.0, 0.3, 59.2)],
)  # fmt: skip
def test_m10_heights_without_data_are_left_out_and_said(value, share, base):
    points = FLOOR + (0, 0, base)
    lost = points[:, 0] > 4 * (1 - share)
    points[lost, 2] = value
    terrain = HeightMap.from_points(points)
    assert np.nanmax(np.abs(terrain.heights)) < 0.02
    assert terrain.size[0] == pytest.approx(4 * (1 - share), abs=0.06)
    said = f"{lost.sum():,} points with the no-data value z = {value:g} left out"
    assert said in terrain.frame.notes and said in describe_points(points)


def test_m10_several_values_and_flat_ground():
    points = rectangle((0, 4), (0, 4), 0.0)
    points[points[:, 0] > 1.2, 2] = -9999
    points[points[:, 0] > 3.0, 2] = -32768
    mapped = map_points(points)
    assert sum("no-data value" in note for note in mapped.report.notes) == 2
    assert not mapped.heights.any()


def test_m10_echoes_at_the_origin_of_a_survey_are_no_points():
    points = np.concatenate([FLOOR + (412345.678, 5654321.123, 59.2), np.zeros((50, 3))])
    terrain = HeightMap.from_points(points)
    assert terrain.size == pytest.approx((4, 4), abs=0.06)
    assert "50 points with the no-data value x = 0 left out" in terrain.frame.notes


def test_m10_walls_and_ceilings_are_data():
    points = np.concatenate([room(0.0), wall(-2, (-1.5, 1.5), (0, 6)), rectangle((-2, 2), (-1.5, 1.5), 6.0)])
    assert not any("no-data" in note for note in map_points(points).report.notes)
    assert "no-data" not in describe_points(points * 1000)


def test_points_under_the_ground_are_counted():
    mirrored = np.concatenate([room(), rectangle((0, 0.5), (0, 0.5), -1.8)])
    assert any(
        "625 points lower than 0.5 m under the ground dropped" in note for note in map_points(mirrored).report.notes
    )
    assert "625 points more than 0.5 m below the floor, down to -1.80 m" in describe_points(mirrored)


def test_millimetres_are_suspected():
    tall = np.concatenate([room(), wall(-2, (-1.5, 1.5), (0, 2.5))]) * 1000
    assert "millimetres: units 0.001" in describe_points(tall)
    with pytest.raises(InputError, match=r"in metres.* millimetres: units 0\.001"):
        map_points(tall)
    assert "or millimetres (0.001)" in describe_points(room() * 1000)
