"""Animations: pictures of a motion by a depth buffer, as GIF and MP4."""

import itertools
import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from hdsp import HeightMap, InputError
from hdsp.detailed.motion.local_motion import relative
from hdsp.detailed.motion.motion import Motion
from hdsp.robot.robot import Robot
from hdsp.viz.motion_figure import motion_profile, save_motion
from hdsp.viz.recordings import animation
from hdsp.viz.recordings.film_settings import FilmSettings
from hdsp.viz.recordings.z_buffer import Canvas, ParallelCamera, Triangles

RED, GREEN = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
LIGHT = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def motion():
    """A drive of 0.4 m, with a wheel in the air in its second half; the check of motions would refuse it."""
    robot, n = Robot.load("go2w"), 17
    base = np.zeros((n, 6))
    base[:, 0], base[:, 1], base[:, 2] = np.linspace(0.8, 1.2, n), 0.9, robot.stance.base_height
    states = np.concatenate([base[:, [0, 1, 5]], np.zeros((n, 4))], axis=1)
    feet = np.concatenate([robot.foot_positions(states), np.zeros((n, 4, 1))], axis=2)
    carries = np.ones((n, 4), bool)
    carries[9:-1, 3] = False
    heights = np.zeros((80, 72), np.float32)
    heights[:, 60:], heights[:10, :10] = 0.3, np.nan
    return Motion(
        base, feet, carries, np.zeros(n, int), 2 * (~carries[:, 3]).astype(np.uint8), HeightMap(heights), robot
    )


def square(z, color):
    """A square of 1 m over the origin, seen from above."""
    corners = np.array([(0, 0, z), (1, 0, z), (1, 1, z), (0, 1, z)], float)
    return Triangles(corners[[[0, 1, 2], [0, 2, 3]]], np.array([color, color]))


@pytest.mark.parametrize("order", itertools.permutations(range(2)))
def test_the_nearer_surface_is_seen_in_any_order(order):
    shapes = [square(0.0, RED), square(0.5, GREEN)]
    canvas = Canvas(ParallelCamera(0.0, np.pi / 2, np.concatenate([s.corners.reshape(-1, 3) for s in shapes]), 40))
    for k in order:
        canvas.draw(shapes[k], LIGHT, ambient=1.0)
    assert (canvas.pixels[5:-5, 5:-5] == GREEN).all()
    np.testing.assert_allclose(canvas.camera.world(canvas.depth)[20, 20, 2], 0.5)


def test_surfaces_that_face_away_are_not_seen():
    shape = square(0.0, RED)
    canvas = Canvas(ParallelCamera(0.0, np.pi / 2, shape.corners.reshape(-1, 3), 40))
    canvas.draw(Triangles(shape.corners[:, ::-1], shape.colors), LIGHT)
    assert np.isinf(canvas.depth).all() and (canvas.pixels == 1).all()


def test_a_camera_sees_points_at_their_pixels():
    points = np.random.default_rng(0).uniform(-1, 1, (30, 3))
    camera = ParallelCamera(0.7, 0.4, points, 200)
    seen = camera.see(points)
    assert (seen[:, :2] >= 0).all() and (seen[:, :2] <= camera.size).all()
    depth = np.full(camera.size[::-1], np.nan)
    rows, columns = np.floor(seen[:, 1]).astype(int), np.floor(seen[:, 0]).astype(int)
    depth[rows, columns] = seen[:, 2]
    assert abs(camera.world(depth)[rows, columns] - points).max() < 1.5 / camera.scale
    assert np.ptp(points @ camera.axes[0]) * camera.scale == pytest.approx(0.92 * 200)


def test_a_gif_shows_the_robot_moving(motion, tmp_path):
    path = motion.animate(tmp_path / "run.gif", fps=5, width=160)
    picture = Image.open(path)
    assert picture.width == 160 and picture.n_frames == pytest.approx(5 * motion.duration, abs=2)
    frames = []
    for k in range(picture.n_frames):
        picture.seek(k)
        frames.append(np.asarray(picture.convert("RGB"), int))
    blue = [(frame[..., 2] - frame[..., 0] > 40)[10:-5].nonzero()[1].mean() for frame in frames]
    assert blue[-1] - blue[0] > 15 and (np.diff(blue) > -1).all()  # the base moves to the right
    orange = [((frame[..., 0] > 150) & (frame[..., 2] < 60)).sum() for frame in frames]
    assert max(orange[len(frames) // 2 + 1 :]) > 2 * orange[0] + 5  # a wheel in the air


def test_pictures_on_a_projected_map_are_those_near_zero(motion, tmp_path):
    """Single precision has steps of half a metre there."""
    far = relative(motion, (-412345.678, -5654321.123))
    assert far.terrain.origin == (412345.678, 5654321.123)
    frames = []
    for k, each in enumerate((motion, far)):
        with Image.open(each.animate(tmp_path / f"{k}.gif", speed=9, fps=2, width=160)) as film:
            frames.append(np.asarray(film.convert("RGB"), float))
    assert np.abs(frames[0] - frames[1]).mean() < 1 and frames[0].std() > 10


@pytest.mark.parametrize(
    ("look", "words"),
    [
        ({"speed": "2"}, r"speed '2'; need a positive number"),
        ({"fps": None}, r"fps None; need 0\.1 to 100"),
        ({"fps": 0.01}, r"fps 0\.01; need 0\.1 to 100"),
        ({"width": 200.5}, r"width 200\.5; need a whole number of pixels, 64 to 3840"),
        ({"width": True}, r"width True; need a whole number"),
        ({"speed": 1e-4}, r"speed 0\.0001, fps 12\.5: [\d,]+ pictures; need at most 10,000"),
        ({"speed": 1e-310}, r"pictures; need at most 10,000"),
    ],
)
def test_arguments_out_of_range_are_named(motion, tmp_path, look, words):
    with pytest.raises(InputError, match=words):
        motion.animate(tmp_path / "run.gif", **look)
    assert list(tmp_path.iterdir()) == []


def test_a_gif_beyond_memory_is_refused_before_it_is_drawn(motion, tmp_path, monkeypatch):
    monkeypatch.setattr(animation, "_MOST_PIXELS", 20_000)
    with pytest.raises(InputError, match=r"GIF: \d+ pictures of 80 x \d+ pixels; need at most 20,000 pixels in all"):
        motion.animate(tmp_path / "run.gif", width=80)
    assert list(tmp_path.iterdir()) == []


def test_a_default_speed_fits_any_motion(motion, tmp_path):
    slow = replace(motion, robot=replace(motion.robot, speeds=replace(motion.robot.speeds, drive=1e-5)))
    assert slow.duration > 20_000
    with Image.open(slow.animate(tmp_path / "slow.gif", fps=0.5, width=np.int64(100))) as film:
        assert film.n_frames == 7
    assert FilmSettings.of(slow.duration, None, 12.5).speed == slow.duration / 12
    with pytest.raises(InputError, match=r"rate is 1000: .* states in .* s; need at most 5,000,000"):
        slow.save(tmp_path / "slow.csv", rate=1000)


@pytest.mark.parametrize("moments", [1, 2.5, "6", 31])
def test_a_strip_has_a_whole_number_of_moments(motion, tmp_path, moments):
    with pytest.raises(InputError, match="need a whole number from 2 to 30"):
        save_motion(motion, tmp_path / "strip.png", moments)


def test_a_wall_has_one_colour(motion):
    heights = np.zeros((80, 72), np.float32)
    heights[:, 50:] = 0.3  # its face lies at 1.25 m, between the cells, exactly also in single precision
    scene = animation._Film(replace(motion, terrain=HeightMap(heights)), FilmSettings(1.0, 1.0), 320)._scene
    x, y, z = np.moveaxis(scene.camera.world(scene.depth), -1, 0)
    wall = (abs(y - 1.25) < 1e-4) & (z > 0.05) & (z < 0.25) & (x > 0.6) & (x < 1.3)
    assert wall.sum() > 500 and np.ptp(scene.pixels[wall], axis=0).max() < 1e-3


def test_films_and_recordings_fill_unknown_ground_once(motion, tmp_path, monkeypatch):
    filled, fill = [], ndimage.distance_transform_edt
    monkeypatch.setattr(
        ndimage, "distance_transform_edt", lambda *args, **more: filled.append(1) or fill(*args, **more)
    )
    assert np.isfinite(animation._Film(motion, FilmSettings(1.0, 1.0), 320)._scene.depth).any() and len(filled) == 1
    motion.save(tmp_path / "run.mcap", rate=2.0)
    assert len(filled) == 2


def test_the_profile_of_a_motion_keeps_its_height_over_unknown_ground(motion):
    heights = motion.terrain.heights + np.float32(500)
    heights[35:45] = np.nan
    base, feet = motion.base.copy(), motion.feet.copy()
    base[:, 2] += 500
    feet[..., 2] += 500
    terrain = HeightMap(heights, motion.terrain.origin)
    for ground in (terrain, HeightMap(heights * np.nan, terrain.origin)):
        (axes,) = motion_profile(replace(motion, base=base, feet=feet, terrain=ground)).axes
        low, high = axes.get_ylim()
        assert 499.5 < low < 500 and high < 501


def test_an_mp4_is_written(motion, tmp_path):
    from imageio_ffmpeg import read_frames

    motion.animate(tmp_path / "run.mp4", width=160)
    frames = read_frames(str(tmp_path / "run.mp4"))
    assert next(frames)["fps"] == 12.5
    assert sum(1 for _ in frames) == pytest.approx(12.5 * motion.duration, abs=2)


def test_wrong_animations_are_refused(motion, tmp_path, monkeypatch):
    for look, words in (({"speed": 0}, "speed 0"), ({"fps": 1e4}, "fps 10000"), ({"width": 8}, "width 8")):
        with pytest.raises(InputError, match=words):
            motion.animate(tmp_path / "run.gif", **look)
    with pytest.raises(InputError, match=r"suffix '\.avi'"):
        motion.animate(tmp_path / "run.avi")
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(InputError, match=r"pip install 'hdsp\[video\]'"):
        motion.animate(tmp_path / "run.mp4", width=64, fps=1)
    assert list(tmp_path.iterdir()) == []
