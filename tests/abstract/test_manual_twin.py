"""Kernels of the manual abstraction against its rules in plain Python."""

import numpy as np
import pytest

from hdsp.abstract import ManualCosts
from hdsp.abstract.manual import ManualSettings
from hdsp.robot.lattice import N_ABSTRACT_ACTIONS
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import random_map
from tests.naive_manual import NaiveManual


@pytest.mark.parametrize("robot", ["momaro", "go2w"])
def test_manual_edges_follow_the_rules(robot):
    robot, random = Robot.load(robot), np.random.default_rng(4)
    heights = random_map(1300, "cuboid_2", 5, cells=120).heights.copy()
    heights[60:80, 20:80] += 0.15
    heights[100:104, 90:99] = np.nan
    edges = ManualCosts(robot).edges(HeightMap(heights))
    twin = NaiveManual(heights, robot, ManualSettings())
    finite = np.argwhere(np.isfinite(edges).any(axis=3))
    states = [*random.permutation(finite)[:12].tolist(), *random.integers(0, (16, 30, 30), (8, 3)).tolist()]
    expected = [[twin.edge(*state, action) for action in range(N_ABSTRACT_ACTIONS)] for state in states]
    found = np.array([edges[tuple(state)] for state in states])
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    assert 0.2 < np.isfinite(found).mean() < 0.9
