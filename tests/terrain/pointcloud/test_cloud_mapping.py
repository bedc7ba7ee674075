import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hdsp.base.errors import InputError
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.pointcloud import MapSettings, map_points
from tests.terrain.pointcloud.clouds import box, moved, rectangle, room, wall

AS_IT_IS = MapSettings(level=False, smooth=0, neighbours=0)


def test_a_tilted_room_becomes_a_level_map_with_its_box_and_without_its_ceiling():
    terrain = HeightMap.from_points(moved(room(noise=0.005, ceiling=2.4), 4, -3, shift=(0, 0, 1.2)))
    heights = terrain.heights
    assert np.nanmax(heights) < 0.4
    assert abs(np.nanmedian(heights)) < 0.01
    floor, top = np.abs(heights) < 0.03, np.abs(heights - 0.3) < 0.03
    assert np.nanstd(heights[floor]) < 0.01
    assert top.sum() * 0.025**2 == pytest.approx(0.5 * 0.4, rel=0.15)
    assert (floor | top).sum() > 0.97 * np.isfinite(heights).sum()


def test_the_report_tells_the_floor_and_how_much_was_filled():
    points = moved(rectangle((0, 2), (0, 2), 0.0), 3, shift=(0, 0, -1))
    hole = (np.abs(points[:, 0] - 1) < 0.05) & (np.abs(points[:, 1] - 1) < 0.05)
    mapped = map_points(points[~hole], MapSettings(smooth=0))
    report = mapped.report
    assert report.points == (~hole).sum() and 0 < report.kept <= report.points
    assert np.rad2deg(report.floor.tilt) == pytest.approx(3.0, abs=0.1)
    assert report.filled == pytest.approx(hole.sum() / len(points), abs=0.002)
    assert np.isfinite(mapped.heights).all() and mapped.heights.dtype == np.float32
    assert map_points(points + (0, 0, 1), AS_IT_IS).report.floor is None


def test_cells_lie_on_multiples_of_the_resolution_and_cover_the_points():
    terrain = HeightMap.from_points(rectangle((0.31, 1.33), (-0.71, 0.49), 0.2), AS_IT_IS)
    np.testing.assert_allclose(np.array(terrain.origin) / 0.025, np.rint(np.array(terrain.origin) / 0.025), atol=1e-6)
    assert terrain.origin == pytest.approx((0.3, -0.725))
    assert terrain.height_at(0.5, 0.0) == pytest.approx(0.2)
    assert np.isnan(terrain.height_at(1.5, 0.0))


def test_a_wall_is_as_high_as_its_points_and_a_lintel_is_dropped():
    door = rectangle((0, 1), (0.4, 0.8), 1.5)  # enough headroom
    shelf = rectangle((0, 1), (1.0, 1.4), 0.7)  # too little headroom
    points = np.concatenate([rectangle((0, 1), (0, 2), 0.0), wall(0.5, (0, 0.3), (0, 1.6)), door, shelf])
    terrain = HeightMap.from_points(points, AS_IT_IS)
    assert terrain.height_at(0.51, 0.1) == pytest.approx(1.58, abs=0.05)
    assert terrain.height_at(0.6, 0.6) == pytest.approx(0.0, abs=1e-6)
    assert terrain.height_at(0.6, 1.2) == pytest.approx(0.7, abs=1e-6)


def test_a_ceiling_alone_over_a_cell_leaves_it_unknown():
    points = np.concatenate([rectangle((0, 1), (0, 1), 0.0), rectangle((0, 2), (0, 1), 2.4)])
    assert HeightMap.from_points(points, AS_IT_IS).size[0] == pytest.approx(1.0)


@pytest.mark.parametrize(("width", "filled"), [(0.05, True), (0.1, True), (0.25, False), (0.5, False)])
def test_holes_are_filled_up_to_a_width_only(width, filled):
    floor = rectangle((0, 2), (0, 2), 0.0, spacing=0.0125)
    hole = (np.abs(floor[:, 0] - 1) < width / 2) & (np.abs(floor[:, 1] - 1) < width / 2)
    terrain = HeightMap.from_points(floor[~hole], AS_IT_IS)
    assert np.isfinite(terrain.height_at(1.0, 1.0)) == filled


def test_filling_does_not_grow_the_map_beyond_what_was_seen():
    seen = HeightMap.from_points(rectangle((0, 1), (0, 1), 0.0), MapSettings(level=False, fill=0, smooth=0))
    filled = HeightMap.from_points(rectangle((0, 1), (0, 1), 0.0), MapSettings(level=False, fill=5, smooth=0))
    np.testing.assert_array_equal(seen.heights, filled.heights)


def test_scan_lines_apart_make_closed_ground():
    lines = np.concatenate([rectangle((x, x + 0.001), (0, 2), 0.0, 0.01) for x in np.arange(0, 2, 0.08)])
    heights = HeightMap.from_points(lines, AS_IT_IS).heights
    assert np.isfinite(heights[:, 2:-2]).all()  # no closing at the ends of the lines


def test_smoothing_takes_noise_away_and_leaves_edges():
    rng = np.random.default_rng(3)
    points = np.concatenate([rectangle((0, 1), (0, 1), 0.0, 0.01), rectangle((1, 2), (0, 1), 0.1, 0.01)])
    points = points + rng.normal(0, [0, 0, 0.008], points.shape)
    rough = HeightMap.from_points(points, AS_IT_IS).heights
    smooth = HeightMap.from_points(points, MapSettings(level=False)).heights
    assert np.abs(np.diff(smooth, axis=0)).max() > 0.09
    assert np.median(np.abs(np.diff(smooth[:35], axis=0))) < 0.4 * np.median(np.abs(np.diff(rough[:35], axis=0)))


def test_single_points_in_the_air_are_dropped():
    spray = np.array([[0.5, 0.5, 1.0], [1.0, 1.0, 0.7]])
    terrain = HeightMap.from_points(np.concatenate([rectangle((0, 2), (0, 2), 0.0), spray]), MapSettings(level=False))
    assert np.nanmax(terrain.heights) < 1e-6


def test_points_that_are_not_finite_do_not_matter():
    points = room()
    spoiled = np.concatenate([points, [[np.nan, 0, 0], [0, np.inf, 0]]])
    np.testing.assert_array_equal(HeightMap.from_points(points).heights, HeightMap.from_points(spoiled).heights)


@settings(max_examples=15)
@given(st.integers(0, 3), st.integers(-40, 40), st.integers(-40, 40))
def test_turning_and_shifting_the_cloud_by_whole_cells_does_the_same_to_the_map(quarter, dx, dy):
    points = np.concatenate([rectangle((0.01, 0.9), (0.01, 0.6), 0.0), box((0.21, 0.41), (0.13, 0.33), 0.2)])
    c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarter]
    rotated = points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], float).T + (dx * 0.025, dy * 0.025, 0)
    heights = HeightMap.from_points(rotated, AS_IT_IS).heights
    np.testing.assert_allclose(heights, np.rot90(HeightMap.from_points(points, AS_IT_IS).heights, quarter), atol=0.011)


@settings(max_examples=20)
@given(st.integers(0, 10_000), st.integers(1, 300))
def test_any_cloud_gives_a_map_inside_its_bounds_or_an_error_of_one_line(seed, count):
    points = np.random.default_rng(seed).uniform(-1, 1, (count, 3)) * (1, 1, 0.4)
    try:
        terrain = HeightMap.from_points(points, MapSettings(level=False, island=3))
    except InputError as error:
        assert "\n" not in str(error)
        return
    assert np.nanmin(terrain.heights) >= points[:, 2].min() - 1e-6
    assert np.nanmax(terrain.heights) <= points[:, 2].max() + 1e-6
    assert terrain.size[0] <= 2.05 and terrain.size[1] <= 2.05


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (np.zeros((0, 3)), "none of 0 points is finite"),
        (np.full((5, 3), np.nan), "none of 5 points is finite"),
        (np.zeros((5, 2)), r"shape \(5, 2\); need \[n, 3\]"),
        ("cloud.pcd", r"points are 'cloud\.pcd'; need \[n, 3\].*HeightMap\.load read files"),
        ([[1, 2, 3], [1, 2]], r"points are \[\[1, 2, 3\], \[1, 2\]\]; need \[n, 3\]"),
        ([["1", "2", "3"]], "points are .* need"),
        (5.0, r"shape \(\); need \[n, 3\]"),
        (None, "points are None|shape"),
        (room() * 0.001, "in metres"),
        (room() * 1000, "more than 100,000,000 cells .* in metres"),
        (room() * (1, 1, 1e6), "in height: are they in metres"),
        (room() + (0, 0, 50), "no point is left|none is left"),
    ],
)
def test_what_is_no_scan_in_metres_is_refused(points, words):
    with pytest.raises(InputError, match=words):
        HeightMap.from_points(points, MapSettings(level=False))


def test_settings_are_settings_or_a_mapping():
    given, expected = (HeightMap.from_points(room(), own) for own in ({"level": False}, MapSettings(level=False)))
    np.testing.assert_array_equal(given.heights, expected.heights)
    with pytest.raises(InputError, match="settings is 'level'; need a mapping"):
        HeightMap.from_points(room(), "level")


@pytest.mark.parametrize(
    "values",
    [
        {"fill": -1}, {"headroom": 0}, {"lowest": 2.0}, {"box": (0, 0, 0, 1)}, {"smooth": float("nan")},
        {"surface": -1}, {"level": 1}, {"neighbours": 2.5}, {"box": (0, 0, 1)},
    ],
)  # fmt: skip
def test_settings_out_of_range_are_refused(values):
    with pytest.raises(InputError, match=rf"MapSettings\.{next(iter(values))}.* (need|is missing)"):
        MapSettings(**values)
