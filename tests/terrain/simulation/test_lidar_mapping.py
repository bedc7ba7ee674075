"""From rays to height maps: fusion, smoothing, tours, and accuracy of a scanned map."""

import numpy as np
import pytest

from hdsp.base.errors import InputError
from hdsp.robot.robot import Robot
from hdsp.terrain.arenas import Arena, read_arena, walls_around
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.obstacles import Block, Scene
from hdsp.terrain.simulation.fusion import Surface, fuse, smooth
from hdsp.terrain.simulation.lidar import Lidar
from hdsp.terrain.simulation.lidar_mapping import accuracy, scanned_map
from hdsp.terrain.simulation.tour import tour

ARENA = read_arena(
    {
        "size": 4.0,
        "wall_height": 1.0,
        "wall_thickness": 0.1,
        "walls": [[2.0, 0.05, 2.0, 1.6]],
        "blocks": [{"x": 3.0, "y": 3.0, "length": 0.8, "width": 0.6, "height": 0.2}],
    }
)


def rays(origin, ends, noise, random):
    """Points and origins for measurements of ``ends`` with noise along the rays."""
    ways = ends - origin
    length = np.linalg.norm(ways, axis=1, keepdims=True)
    points = origin + ways * (1 + random.normal(0, noise, (len(ends), 1)) / length)
    return points.astype(np.float32), np.broadcast_to(np.float32(origin), points.shape)


def test_noise_in_front_of_a_wall_does_not_widen_it():
    random = np.random.default_rng(0)
    # The ground ends at x = 1, where a wall of 1 m begins; most rays hit the wall.
    ground = np.column_stack([random.uniform(0, 1, 20000), random.uniform(0, 1, 20000), np.zeros(20000)])
    face = np.column_stack([np.ones(200000), random.uniform(0, 1, 200000), random.uniform(0, 1, 200000)])
    points, origins = rays(np.array([-1.0, 0.5, 1.6]), np.concatenate([ground, face]), 0.03, random)
    high = fuse(points, origins, (48, 40)).heights > 0.2
    assert not high[:39].any(), "at most one cell before the wall"
    assert high[39].mean() < 0.3
    assert high[40].mean() > 0.9
    # The textbook method, the highest point in each cell, would place the wall too near.
    highest = np.zeros((48, 40))
    inside = ((points[:, :2] >= 0) & (points[:, :2] < (1.2, 1.0))).all(axis=1)
    np.maximum.at(highest, tuple((points[inside, :2] / 0.025).astype(int).T), points[inside, 2])
    assert (highest[37] > 0.2).mean() > 0.9


def test_ground_is_flat_at_any_angle_of_the_rays():
    random = np.random.default_rng(1)
    ends = np.column_stack([random.uniform(0, 0.5, (40000, 2)), np.full(40000, 0.1)])
    for origin in ([-1.3, 0.25, 1.6], [-3.0, 0.25, 0.6], [-6.0, -6.0, 0.4]):
        surface = fuse(*rays(np.array(origin), ends, 0.03, random), (20, 20))
        inner = np.s_[4:-4, 4:-4]  # no points lie beyond the border, so no rays cross it
        assert np.abs(surface.heights - 0.1)[inner].max() < 0.03
        assert np.abs(smooth(surface, 0.03) - 0.1)[inner].max() < 0.006


def test_smoothing_keeps_edges_and_unknown_cells():
    random = np.random.default_rng(2)
    truth = np.zeros((40, 40), np.float32)
    truth[20:] = 0.06
    noisy = (truth + random.normal(0, 0.005, truth.shape)).astype(np.float32)
    noisy[5, 5] = np.nan
    noisy[30, 30] = 0.5
    heights = smooth(Surface(noisy, np.full(truth.shape, 30, np.int32)), 0.03)
    assert np.isnan(heights[5, 5]) and np.isnan(heights).sum() == 1
    error = np.abs(heights - truth)
    error[5, 5] = 0
    assert error.max() < 0.01, "the lone cell is back in its plane, the step is where it was"


def test_unseen_cells_are_unknown():
    points, origins = rays(
        np.array([0.0, 0.0, 1.0]), np.full((10, 3), (0.51, 0.51, 0.0)), 0.0, np.random.default_rng(0)
    )
    surface = fuse(points, origins, (40, 40))
    assert np.isfinite(surface.heights).sum() == 1
    assert surface.heights[20, 20] == pytest.approx(0.0, abs=1e-6)
    assert np.isnan(fuse(points[:0], origins[:0], (4, 4)).heights).all()


def test_a_tour_keeps_clear_and_comes_near_all_free_ground():
    path = tour(ARENA, (1.0, 1.0), clearance=0.3, spacing=0.8)
    assert path[0] == pytest.approx((1.0, 1.0), abs=0.05)
    x, y = path.T
    assert (np.hypot(*np.diff(path, axis=0).T) < 0.08).all()
    beside = np.hypot(np.maximum(abs(x - 2.0) - 0.05, 0), np.maximum(y - 1.65, 0))
    assert min(beside.min(), (np.minimum(x, y) - 0.1).min(), (3.9 - np.maximum(x, y)).min()) > 0.28
    for corner in ((0.6, 0.6), (3.4, 0.6), (0.6, 3.4)):
        assert np.hypot(*(path - corner).T).min() < 0.8
    with pytest.raises(InputError, match="not on free ground"):
        tour(ARENA, (2.0, 1.0))
    with pytest.raises(InputError, match="not on free ground"):
        tour(ARENA, (9.0, 1.0))


def test_a_scanned_map_is_true_enough_for_a_planner():
    pytest.importorskip("mujoco")
    lidar = Lidar(azimuth_step=0.014)
    scanned, true = scanned_map(ARENA, (1.0, 1.0), lidar, seed=3), ARENA.height_map()
    found = accuracy(scanned, true, Robot.load("momaro"))
    assert found["unknown_share"] < 0.02
    assert found["wrong_share"] < 0.04
    assert found["rms_flat"] < 0.002
    assert found["false_edges"] < 4.0  # beside walls, because the sensor is coarse
    assert found["missed_edges"] < 0.01
    assert found["standable_lost"] < 0.02
    np.testing.assert_array_equal(scanned_map(ARENA, (1.0, 1.0), lidar, seed=3).heights, scanned.heights)
    with pytest.raises(InputError, match="scan seed -1"):
        scanned_map(ARENA, (1.0, 1.0), lidar, seed=-1)


def test_accuracy_counts_what_it_says():
    true = Arena(2.0, Scene((*walls_around(2.0, 1.0, 0.1), Block(1.0, 1.0, 0.0, 0.4, 0.4, 0.2)))).height_map()
    robot = Robot.load("momaro")
    assert set(accuracy(true, true, robot).values()) == {0.0}
    heights = true.heights.copy()
    heights[20, 20] = 0.1  # one high cell makes nine edge cells
    heights[60, 20] = np.nan
    found = accuracy(HeightMap(heights), true, robot)
    assert found["false_edges"] == pytest.approx(9 / 4.0)
    assert found["unknown_share"] == pytest.approx(1 / 6400)
    assert found["wrong_share"] == pytest.approx(1 / 6399)
    assert found["missed_edges"] == 0
    assert found["standable_lost"] > 0 and found["standable_gained"] == 0
    gone = np.where(true.heights == np.float32(0.2), 0.0, true.heights)
    assert accuracy(HeightMap(gone), true, robot)["missed_edges"] > 0.05
