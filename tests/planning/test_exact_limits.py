"""Ground that just reaches a limit of the robot is passed at any altitude of the map; more is refused and named."""

import numpy as np
import pytest

from hdsp import HeightMap, Planner
from hdsp.detailed.causes.state_faults import faults_of
from hdsp.detailed.search.outcome import Status
from hdsp.robot.robot import Robot
from hdsp.terrain.cost_maps import cost_maps
from tests.naive import Naive

MOMARO = Robot.load("momaro")
ALTITUDES = 0.0, 0.1, -41.7, 120.3, 1500.1


def over(kerb, altitude, robot="momaro"):
    """Plan over a kerb across the map, in m; the other ground is level at the altitude."""
    heights = altitude + np.where(np.arange(200)[:, None] >= 100, kerb, np.zeros((1, 120)))
    return Planner(HeightMap(heights), robot, heuristic="manual").plan((1.2, 1.5, 0.0), (3.7, 1.5, 0.0))


@pytest.mark.parametrize("altitude", ALTITUDES)
def test_a_kerb_as_high_as_the_limit_is_stepped_over_and_a_millimetre_more_is_not(altitude):
    most = MOMARO.step.max_height
    plan = over(most, altitude)
    assert plan.solved and any(action.stepping_foot is not None for action in plan.actions)
    words = over(most + 1e-3, altitude).explain()
    assert "a step there rises or falls by 0.301 m; the robot steps up to 0.3 m" in words


@pytest.mark.parametrize("altitude", ALTITUDES)
def test_wheels_drive_over_a_kerb_as_high_as_their_limit_but_no_higher(altitude):
    edge = MOMARO.drive.highest_edge
    assert not any(action.stepping_foot is not None for action in over(edge, altitude).actions)
    assert any(action.stepping_foot is not None for action in over(edge + 1e-3, altitude).actions)


@pytest.mark.parametrize("altitude", ALTITUDES)
@pytest.mark.parametrize("name", ["momaro", "go2w"])
def test_ramps_and_kerbs_at_the_limit_bear_feet_as_in_the_twin(altitude, name):
    robot = Robot.load(name)
    x = np.arange(40)[:, None] * 0.025 + np.zeros((1, 40))
    ramp, kerb = x * min(robot.slope.steepest()), np.where(x > 0.5, robot.drive.highest_edge, 0.0)
    for heights in (altitude + ramp, altitude + kerb):
        terrain = HeightMap(heights)
        maps, twin = cost_maps(terrain, robot), Naive(terrain.heights, robot)
        assert maps.standable.all() and not maps.edge.any() and not maps.steep.any()
        for cell in ((15, 20), (19, 20), (20, 20)):
            assert twin.standable(cell) and not twin.steep(cell, 0)


def test_words_never_name_a_need_within_the_limit():
    plan = over(MOMARO.step.max_height + 2e-4, 0.0)
    assert plan.status == Status.INFEASIBLE
    assert "a step there rises or falls by 0.3002 m; the robot steps up to 0.3 m" in plan.explain()
    assert "a step there is" not in plan.explain()


def test_no_edge_is_named_where_wheels_pass():
    heights = 120.3 + np.where(np.arange(120)[:, None] >= 60, MOMARO.drive.highest_edge, np.zeros((1, 120)))
    planner = Planner(HeightMap(heights))
    state = np.array([60, 60, 0, 0, 0, 0, 0])
    assert faults_of(planner.world, planner.grid, MOMARO, state) == ()
