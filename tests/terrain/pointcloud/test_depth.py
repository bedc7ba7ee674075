import numpy as np
import pytest

from hdsp.base.errors import InputError
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.pointcloud import Camera, depth_points
from hdsp.terrain.pointcloud.depth import elevation_points, read_image

CAMERA = Camera(fx=100.0, fy=100.0, cx=80.0, cy=60.0, depth_scale=0.001)

#: Camera to world for a camera that looks along +x: its x is our -y, its y our -z, its z our x.
AHEAD = (-0.5, 0.5, -0.5, 0.5)


def test_a_wall_ahead_is_a_plane_at_its_distance():
    points = depth_points(np.full((120, 160), 2000), CAMERA, (1.0, 2.0, 0.5, *AHEAD))
    assert len(points) == 120 * 160
    np.testing.assert_allclose(points[:, 0], 3.0, atol=1e-9)
    # The first pixel, at the upper left, is to the left (+y) and above.
    np.testing.assert_allclose(points[0], [3.0, 2.0 + 80 / 100 * 2, 0.5 + 60 / 100 * 2], atol=1e-9)


def test_pixels_without_a_measurement_or_out_of_range_give_no_points():
    image = np.zeros((10, 10))
    image[0, 0], image[0, 1], image[0, 2] = 100, 9000, 1500
    assert len(depth_points(image, CAMERA)) == 1
    assert depth_points(image, CAMERA)[0, 2] == pytest.approx(1.5)


def test_m19_zeros_are_no_points_for_a_camera_without_a_nearest_depth():
    camera = Camera(100.0, 100.0, 80.0, 60.0, 0.001, nearest=0.0)
    image = np.zeros((10, 10))
    image[2, 3] = 1200
    np.testing.assert_allclose(depth_points(image, camera)[:, 2], [1.2])


def test_a_stride_takes_every_nth_pixel():
    camera = Camera(100.0, 100.0, 80.0, 60.0, 0.001, stride=2)
    image = np.random.default_rng(0).integers(500, 3000, (20, 30))
    everything = depth_points(image, CAMERA).reshape(20, 30, 3)
    np.testing.assert_array_equal(depth_points(image, camera), everything[::2, ::2].reshape(-1, 3))


def test_a_picture_of_heights_becomes_a_map_with_its_steps():
    image = np.full((40, 60), 102, np.uint8)
    image[:20] = 204  # the upper half of the image is ahead
    image[:, :10] = 0  # the left part of the image is to the left
    terrain = HeightMap.from_points(elevation_points(image, highest=1.25, pixel=0.04))
    assert terrain.size == pytest.approx((1.575, 1.975), abs=0.05)
    assert terrain.height_at(terrain.origin[0] + 0.3, terrain.origin[1] + 1) == pytest.approx(0.0, abs=0.01)
    assert terrain.height_at(terrain.origin[0] + 1.3, terrain.origin[1] + 1) == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: depth_points(np.zeros(5), CAMERA), "depth image has shape"),
        (lambda: depth_points(np.zeros((5, 5)), CAMERA, (0, 0, 0)), "pose of a depth image"),
        (lambda: depth_points(np.zeros((5, 5)), CAMERA, (0,) * 7), "quaternion"),
        (lambda: Camera(0.0, 1.0, 0.0, 0.0, 1.0), r"Camera\.fx is 0\.0; need a positive number"),
        (lambda: Camera(1.0, 1.0, 0.0, 0.0, 1.0, nearest=5.0), r"Camera\.nearest is 5\.0; need less than farthest"),
        (lambda: depth_points("depth.png", CAMERA), "depth image is 'depth.png'; need grey values"),
        (lambda: depth_points([[1], [1, 2]], CAMERA), "depth image is"),
        (lambda: depth_points(np.zeros((5, 5)), "camera"), "camera is 'camera'; need a mapping"),
        (lambda: depth_points(np.zeros((5, 5)), CAMERA, "ahead"), "pose of a depth image is 'ahead'"),
        (lambda: elevation_points(np.zeros((1, 5)), 1.0, 0.04), "picture of a height map"),
        (lambda: elevation_points(np.zeros((5, 5)), 1.0, 0.04, 0), r"Elevation\.spacing is 0; need a positive number"),
    ],
)
def test_bad_input_is_named(call, words):
    with pytest.raises(InputError, match=words):
        call()


def test_images_are_read_if_they_are_grey(tmp_path):
    image = pytest.importorskip("PIL.Image")
    depth = np.arange(12, dtype=np.uint16).reshape(3, 4) * 5000
    image.fromarray(depth).save(tmp_path / "depth.png")
    np.testing.assert_array_equal(read_image(tmp_path / "depth.png"), depth)
    grey = np.repeat(np.arange(6, dtype=np.uint8).reshape(2, 3, 1), 3, axis=2)
    image.fromarray(grey).save(tmp_path / "grey.png")
    np.testing.assert_array_equal(read_image(tmp_path / "grey.png"), grey[..., 0])
    grey[0, 0, 1] = 77
    image.fromarray(grey).save(tmp_path / "colour.png")
    with pytest.raises(InputError, match="need one channel"):
        read_image(tmp_path / "colour.png")
    (tmp_path / "torn.png").write_bytes((tmp_path / "depth.png").read_bytes()[:40])
    with pytest.raises(InputError, match=r"torn\.png cannot be read"):
        read_image(tmp_path / "torn.png")
    with pytest.raises(InputError, match="no such file"):
        read_image(tmp_path / "none.png")
