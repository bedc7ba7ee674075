import numpy as np
import pytest

from hdsp.base.errors import InputError
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.pointcloud import MapSettings, describe_points, map_points
from tests.terrain.pointcloud.clouds import box, moved, rectangle, room, wall


def surface(height, x, y, spacing=0.03):
    """Points on the ground of height ``height(x, y)`` with 3 mm of noise."""
    grid = np.meshgrid(np.arange(*x, spacing), np.arange(*y, spacing), indexing="ij")
    points = np.stack([*grid, height(*grid)], axis=-1).reshape(-1, 3)
    return points + np.random.default_rng(0).normal(0, 0.003, points.shape)


def rising(degrees, start=0.0):
    slope = np.tan(np.radians(degrees))
    return lambda x, y: np.where(x < start, 0.0, (x - start) * slope)


def heights_along(terrain, x, y=1.0):
    return np.array([float(terrain.height_at(value, y)) for value in x])


@pytest.mark.parametrize(("degrees", "flat", "length"), [(5, 2, 4), (12, 2, 4), (8, 1, 6)])
def test_m8_a_ramp_beside_a_level_floor_keeps_its_slope(degrees, flat, length):
    terrain = HeightMap.from_points(surface(rising(degrees, flat), (0, flat + length), (0, 2)))
    x = np.linspace(0.2, flat + length - 0.2, 20)
    np.testing.assert_allclose(heights_along(terrain, x), rising(degrees, flat)(x, 0), atol=0.02)
    assert any("kept: other ground is level" in note for note in terrain.frame.notes)


@pytest.mark.parametrize(("degrees", "size"), [(5, 6), (12, 6), (12, 20), (25, 6)])
def test_m8_a_hillside_keeps_its_slope_and_all_its_ground(degrees, size):
    terrain = HeightMap.from_points(surface(rising(degrees), (0, size), (0, 4), 0.04))
    x = np.linspace(0.3, size - 0.3, 10)
    heights = heights_along(terrain, x)
    np.testing.assert_allclose(np.diff(heights), np.diff(x) * np.tan(np.radians(degrees)), atol=0.02)
    assert any(f"ground inclined by {degrees}.0 degrees, kept" in note for note in terrain.frame.notes)


def test_m8_rolling_ground_keeps_its_heights():
    def height(x, y):
        return 1.2 * np.sin(x / 3) + 0.8 * np.cos(y / 2.5)

    points = surface(height, (0, 10), (0, 10), 0.05)
    terrain = HeightMap.from_points(points)
    x, y = np.meshgrid(np.linspace(0.5, 9.5, 10), np.linspace(0.5, 9.5, 10))
    lift = terrain.frame.to_source[2, 3]
    np.testing.assert_allclose(terrain.height_at(x, y) + lift, height(x, y), atol=0.03)
    np.testing.assert_array_equal(terrain.frame.to_source[:3, :3], np.eye(3))


def test_m8_stairs_higher_than_a_storey_are_whole():
    points = surface(lambda x, y: np.clip(np.floor(x / 0.3) + 1, 0, 20) * 0.17, (-2, 7), (0, 1.5), 0.025)
    terrain = HeightMap.from_points(points)
    assert np.nanmax(terrain.heights) == pytest.approx(3.4, abs=0.02)


def test_m8_walls_tell_a_slope_from_a_tilted_sensor():
    driveway = np.concatenate([surface(rising(7), (0, 9), (0, 3)), wall(9, (0, 3), (1.1, 4)), wall(0, (0, 3), (0, 3))])
    report = map_points(driveway).report
    assert report.floor is None and any("7.0 degrees, kept: walls are vertical" in note for note in report.notes)
    walls = [wall(-2, (-1.5, 1.5), (0, 2)), wall(2, (-1.5, 1.5), (0, 2))]
    report = map_points(moved(np.concatenate([room(), *walls]), roll=3, pitch=8)).report
    assert any("8.5 degrees, levelled: walls are perpendicular" in note for note in report.notes)


def test_a_larger_tilt_is_levelled_on_the_word_of_the_user_only():
    tilted = moved(room(), 3, 6)
    assert map_points(tilted).report.floor is None
    report = map_points(tilted, MapSettings(level=True)).report
    assert np.rad2deg(report.floor.tilt) == pytest.approx(6.7, abs=0.1)


@pytest.mark.parametrize("settings", [MapSettings(level=True), MapSettings()])
def test_levelled_points_go_back_to_the_cloud(settings):
    cloud = moved(np.concatenate([room(0.0), rectangle((-2, 2), (-1.5, 1.5), 2.4)]), 4, -3, shift=(412345, 5654321, 59))
    terrain = HeightMap.from_points(cloud, settings)
    mapped = terrain.frame.points_from_source(cloud)
    assert abs(np.median(mapped[:30000, 2])) < 0.01
    on_map = terrain.height_at(mapped[:20000, 0], mapped[:20000, 1])
    assert np.nanmedian(np.abs(on_map - mapped[:20000, 2])) < 0.01
    np.testing.assert_allclose(terrain.frame.points_to_source(mapped), cloud, atol=1e-6)


def furnished(walls=4, ceiling=False):
    """A room of 5 x 4 x 2.5 m with a table and a chest."""
    sides = [wall(0, (0, 4), (0, 2.5), 0.04), wall(5, (0, 4), (0, 2.5), 0.04)]
    sides += [wall(y, (0, 5), (0, 2.5), 0.04)[:, [1, 0, 2]] for y in (0, 4)]
    parts = [rectangle((0, 5), (0, 4), 0, 0.04), box((0.5, 1.5), (0.5, 1.2), 0.7), box((2, 2.4), (1, 1.5), 0.45)]
    above = [rectangle((0, 5), (0, 4), 2.5, 0.04)] if ceiling else []
    points = np.concatenate([*parts, *sides[:walls], *above])
    return points + np.random.default_rng(0).normal(0, 0.003, points.shape)


@pytest.mark.parametrize("ceiling", [False, True])
@pytest.mark.parametrize(("order", "signs", "axes"), [
    ([1, 2, 0], (1, 1, 1), "z,x,y"), ([1, 2, 0], (-1, -1, 1), "z,-x,-y"), ([2, 0, 1], (1, 1, 1), "y,z,x"),
])  # fmt: skip
def test_m16_a_room_with_another_axis_up_is_refused_with_the_axes_that_help(order, signs, axes, ceiling):
    turned = furnished(ceiling=ceiling)[:, order] * signs
    with pytest.raises(InputError, match=rf"may be up: .*--axes={axes} makes it up"):
        map_points(turned)
    assert f"--axes={axes}" in describe_points(turned)
    assert map_points(turned, MapSettings(check_up=False)).heights.size  # the user knows better


def test_m16_a_floor_without_walls_is_refused_as_well():
    with pytest.raises(InputError, match=r"y may be up: .*--axes=z,x,y"):
        map_points(room()[:, [1, 2, 0]])


@pytest.mark.parametrize("ceiling", [False, True])
@pytest.mark.parametrize("walls", [1, 2, 4])
def test_m16_a_room_with_z_up_is_not_refused(walls, ceiling):
    report = map_points(furnished(walls, ceiling)).report
    assert report.doubts == ()


def seen_by_a_camera(pitch):
    """A floor 1 m below a camera and a wall 3 m ahead of it, in the camera's axes x right, y down, z ahead."""
    across, down = np.meshgrid(np.linspace(-0.6, 0.6, 150), np.linspace(-0.45, 0.45, 110))
    rays = np.stack([across, down, np.ones_like(across)], axis=-1).reshape(-1, 3)
    world = moved(rays[:, [2, 0, 1]] * (1, -1, -1), pitch=pitch)
    floor = np.where(world[:, 2] < 0, 1 / np.maximum(-world[:, 2], 1e-9), np.inf)
    points = rays * np.minimum(floor, 3 / np.maximum(world[:, 0], 1e-9))[:, None]
    return points + np.random.default_rng(0).normal(0, 0.003, points.shape)


@pytest.mark.parametrize(("pitch", "words"), [(15, "of the points lie under the floor: is z up"), (30, "z,-x,-y")])
def test_m16_views_of_a_camera_are_doubted_in_its_axes_and_taken_in_ours(pitch, words):
    view = seen_by_a_camera(pitch)
    assert words in " ".join(map_points(view).report.doubts)
    ours = map_points(view[:, [2, 0, 1]] * (1, -1, -1)).report
    assert any(f"{pitch - 0.1:.1f} degrees" in note or f"{pitch}.0 degrees" in note for note in ours.notes)


def test_m16_doubts_are_warnings():
    hallway = [rectangle((0, 10), (0, 1.6), z) for z in (0, 2.5)]
    hallway += [wall(y, (0, 10), (0, 2.5))[:, [1, 0, 2]] for y in (0, 1.6)]
    with pytest.warns(UserWarning, match="may be up"):
        terrain = HeightMap.from_points(np.concatenate(hallway))
    assert np.nanmedian(terrain.heights) == pytest.approx(0, abs=0.01)
    with pytest.warns(UserWarning, match="-z may be up: all other points lie below the floor"):
        HeightMap.from_points(room() * (1, -1, -1))
