"""Rays, the lidar and its cloud, against analytic distances."""

import math

import numpy as np
import pytest

from hdsp.base.errors import InputError
from hdsp.terrain.arenas import Arena
from hdsp.terrain.obstacles import Block, Ramp, Scene
from hdsp.terrain.simulation.lidar import Lidar, along, scan
from hdsp.terrain.simulation.mujoco_world import MujocoWorld

pytest.importorskip("mujoco")

BOX = Block(2.5, 1.5, 0.4, 0.6, 0.4, 0.5)
RAMP = Ramp(1.0, 3.0, 0.7, 1.0, 0.6, 0.3)
COARSE = Lidar(noise=0.0, azimuth_step=0.02, speed=2.0, spin=5.0)


@pytest.fixture(scope="module")
def world():
    return MujocoWorld(Arena(4.0, Scene((BOX, RAMP))))


def toward(origin, points):
    """Unit vectors to points, and distances to these points."""
    ways = np.asarray(points) - origin
    return ways / np.linalg.norm(ways, axis=1, keepdims=True), np.linalg.norm(ways, axis=1)


def test_rays_meet_plane_box_and_ramp_where_they_are(world):
    origin = np.array([2.0, 2.5, 1.6])
    on_floor = [(0.5, 0.5, 0.0), (3.5, 3.5, 0.0), (2.0, 2.5, 0.0)]
    on_box = [(2.5, 1.5, 0.5), (2.6, 1.5, 0.5)]
    c, s = math.cos(RAMP.yaw), math.sin(RAMP.yaw)
    on_ramp = [
        (1.0 + a * c - b * s, 3.0 + a * s + b * c, 0.3 * (0.5 + a)) for a in (-0.4, 0.0, 0.45) for b in (-0.2, 0.2)
    ]
    directions, distances = toward(origin, [*on_floor, *on_box, *on_ramp])
    np.testing.assert_allclose(world.ranges(origin, directions, 30.0), distances, atol=1e-6)


def test_rays_meet_the_side_of_a_box(world):
    # The ray follows the axis of the box and hits the middle of its end face.
    c, s = math.cos(BOX.yaw), math.sin(BOX.yaw)
    origin = np.array([BOX.x - 1.2 * c, BOX.y - 1.2 * s, 0.25])
    assert world.ranges(origin, np.array([[c, s, 0.0]]), 30.0) == pytest.approx([0.9], abs=1e-6)


def test_what_is_too_far_or_nowhere_is_infinite(world):
    ranges = world.ranges((2.0, 2.5, 1.6), np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]), 1.5)
    assert np.isinf(ranges).all()


def test_the_beams_have_length_one_and_lie_on_the_cones_of_the_sensor():
    lidar = Lidar(blind=0.0)
    for angle in (0.0, 0.7, 4.0):
        beams = lidar.directions(angle)
        np.testing.assert_allclose(np.linalg.norm(beams, axis=1), 1.0)
        axis = np.array([math.cos(angle), math.sin(angle), 0.0])
        off = np.degrees(np.arcsin(beams @ axis))
        assert np.unique(off.round(6)).tolist() == pytest.approx(np.arange(-15, 16, 2).tolist())
        assert len(beams) == 16 * 900


def test_the_robot_hides_what_is_straight_below():
    beams = Lidar().directions(0.3)
    assert np.degrees(np.arccos(-beams[:, 2])).min() > 25


def test_without_noise_all_points_lie_on_the_scene(world):
    cloud = scan(world, [(2.0, 2.5), (3.5, 2.5)], COARSE, np.random.default_rng(0))
    assert len(cloud.points) > 2000
    assert distance_to_scene(world, cloud.points).max() < 1e-5


def test_the_registered_cloud_reproduces_the_scene_within_noise(world):
    noisy = Lidar(noise=0.03, azimuth_step=0.02, speed=2.0, spin=5.0)
    exact = scan(world, [(2.0, 2.5), (3.5, 2.5)], COARSE, np.random.default_rng(0))
    cloud = scan(world, [(2.0, 2.5), (3.5, 2.5)], noisy, np.random.default_rng(0))
    off = np.linalg.norm(cloud.points - exact.points, axis=1)
    assert np.sqrt((off**2).mean()) == pytest.approx(0.03, rel=0.05)
    beams = toward(0, exact.points - exact.origins)[0]
    across = np.linalg.norm(np.cross(cloud.points - exact.points, beams), axis=1)
    assert across.max() < 1e-5, "noise is along the beams"


def test_a_scan_is_a_function_of_its_seed(world):
    lidar = Lidar(azimuth_step=0.05, speed=2.0, spin=5.0)
    clouds = [scan(world, [(2.0, 2.5), (2.5, 2.5)], lidar, np.random.default_rng(seed)).points for seed in (1, 1, 2)]
    np.testing.assert_array_equal(clouds[0], clouds[1])
    assert (clouds[0] != clouds[2]).any()


def test_stations_are_evenly_spaced_around_corners():
    stations = along([(0.0, 0.0), (0.3, 0.0), (0.3, 0.4)], 0.1)
    np.testing.assert_allclose(stations[[0, 3, 7]], [(0, 0), (0.3, 0), (0.3, 0.4)], atol=1e-9)
    assert len(along([(1.0, 1.0)], 0.1)) == 1


def test_wrong_input_is_named(world):
    with pytest.raises(InputError, match="leaves the arena"):
        scan(world, [(2.0, 2.0), (5.0, 2.0)], COARSE, np.random.default_rng(0))
    with pytest.raises(InputError, match="path of shape"):
        along(np.zeros((0, 2)), 0.1)
    with pytest.raises(InputError, match=r"Lidar\.noise is -1"):
        Lidar(noise=-1.0)
    with pytest.raises(InputError, match=r"Lidar\.beams is 0"):
        Lidar(beams=0)
    with pytest.raises(InputError, match="whole number"):
        Lidar(beams=2.5)


def distance_to_scene(world, points):
    """Distance from points to the nearest surface, from each obstacle's shape."""
    found = [np.abs(points[:, 2])]
    for block in (BOX, RAMP):
        c, s = math.cos(block.yaw), math.sin(block.yaw)
        x, y = points[:, 0] - block.x, points[:, 1] - block.y
        along_, across = c * x + s * y, -s * x + c * y
        top = block.height if block is BOX else block.height * (0.5 + along_ / block.length)
        outside = np.stack([abs(along_) - block.length / 2, abs(across) - block.width / 2, points[:, 2] - top])
        found.append(np.where((outside < 1e-5).all(axis=0), -outside.max(axis=0), np.inf))
    return np.abs(np.min(found, axis=0))
