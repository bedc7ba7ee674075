"""Plans on maps as robots measure them, by the numbers of the trials in which earlier versions failed."""

import numpy as np
import pytest

from hdsp.abstract.manual import ManualCosts
from hdsp.base.errors import InputError
from hdsp.detailed.search.outcome import Status
from hdsp.planning.collisions import check_plan
from hdsp.planning.heuristics import AbstractHeuristic, GeometricHeuristic
from hdsp.planning.planner import Planner
from hdsp.robot.robot import Robot
from hdsp.terrain.arenas import Arena
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.obstacles import Block, Scene
from tests.terrain.test_conditioning import coarse, smooth, white

SIDE = 4.0  # m
START, GOAL = (0.8, 2.0, 0.0), (3.0, 2.2, 0.2)
KERB = Arena(SIDE, Scene((Block(3.9, 2.0, 0.1, 4.0, 9.0, 0.15),)))
UP = (0.8, 2.0, 0.1), (3.0, 2.2, 0.1)


def planned(terrain, ends=(START, GOAL), **options):
    return Planner(terrain, heuristic="manual").plan(*ends, weight=1.25, time=60.0, **options)


@pytest.fixture(scope="module")
def flat():
    terrain = HeightMap.flat((160, 160))
    return terrain, planned(terrain).cost


@pytest.fixture(scope="module")
def kerb():
    terrain = KERB.height_map()
    return terrain, planned(terrain, UP).cost


@pytest.mark.parametrize(("sigma", "most"), [(0.01, 1.1), (0.015, 1.12), (0.02, 1.15)])
def test_m1_white_noise_on_level_ground(flat, sigma, most):
    terrain, cost = flat
    planner = Planner(HeightMap(terrain.heights + white(terrain.shape, sigma, 1)), heuristic="manual")
    plan = planner.plan(START, GOAL, weight=1.25)
    assert plan.solved and plan.steps == 0 and plan.cost <= most * cost
    assert f"noise of {100 * planner.conditioning.noise.deviation:.1f} cm removed" in str(planner.conditioning)
    assert any("noise" in note for note in plan.terrain.frame.notes)


@pytest.mark.parametrize("sigma", [0.02, 0.03])
def test_m2_smooth_noise_over_a_kerb(kerb, sigma):
    terrain, cost = kerb
    plan = planned(HeightMap(terrain.heights + smooth(terrain.shape, sigma, seed=2)), UP)
    assert plan.solved and plan.steps == 4 and plan.cost <= 1.3 * cost
    assert check_plan(KERB, plan, Robot.load("momaro"), 0.02).free


@pytest.mark.parametrize("share", [0.002, 0.05])
@pytest.mark.parametrize("seed", range(3))
def test_m3_unknown_cells_on_level_ground(flat, share, seed):
    terrain, cost = flat
    heights = np.where(np.random.default_rng(seed).random(terrain.shape) < share, np.nan, terrain.heights)
    plan = planned(HeightMap(heights))
    assert plan.solved and plan.cost == pytest.approx(cost, rel=1e-3)


@pytest.mark.parametrize("factor", [2, 4])
def test_m5_coarse_cells_over_a_kerb(kerb, factor):
    terrain, cost = kerb
    plan = planned(coarse(terrain, factor), UP)
    assert plan.solved and plan.steps == 4 and plan.cost == pytest.approx(cost, rel=0.1)
    assert check_plan(KERB, plan, Robot.load("momaro"), 0.02).free


def test_m5_a_kerb_higher_than_the_robot_steps_stays_closed_in_coarse_cells():
    terrain = Arena(SIDE, Scene((Block(3.9, 2.0, 0.1, 4.0, 9.0, 0.5),))).height_map()
    for factor in (2, 4):
        assert str(planned(coarse(terrain, factor), UP).status) == "infeasible"


def test_without_conditioning_a_map_is_planned_on_as_it_is(flat):
    terrain, cost = flat
    noisy = HeightMap(terrain.heights + white(terrain.shape, 0.005, 1))
    planner = Planner(noisy, heuristic="manual", conditioning=None)
    assert planner.terrain is noisy and planner.conditioning is None
    assert planner.plan(START, GOAL, weight=1.25).cost > 1.1 * cost
    exact = Planner(terrain)
    assert exact.terrain is terrain and not exact.conditioning.changed


@pytest.mark.parametrize("cell", [0.025, 0.05])
def test_an_update_conditions_the_change_and_gives_the_plans_of_a_new_planner(cell):
    rng = np.random.default_rng(5)
    count = round(SIDE / cell)
    heights = 0.01 * rng.standard_normal((count, count)).astype(np.float32)
    planner = Planner(HeightMap(heights, resolution=cell), heuristic="grid")
    before = planner.plan(START, GOAL, weight=1.0)
    wall = slice(round(1.8 / cell), round(1.9 / cell)), slice(round(0.2 / cell), round(2.4 / cell))
    changed = heights.copy()
    changed[wall] += 0.8
    region = (wall[0].start, wall[1].start, wall[0].stop, wall[1].stop)
    after = planner.update(HeightMap(changed, resolution=cell), region).plan(START, GOAL, weight=1.0)
    fresh = Planner(HeightMap(changed, resolution=cell), heuristic="grid").plan(START, GOAL, weight=1.0)
    # Both plans are optimal. Their maps differ a little, since only the new planner estimates the noise with the wall.
    assert after.bound == fresh.bound == 1 and after.cost == pytest.approx(fresh.cost, rel=0.03)
    assert after.cost > before.cost
    again = planner.update(HeightMap(heights, resolution=cell)).plan(START, GOAL, weight=1.0)
    np.testing.assert_array_equal(again.states, before.states)


def test_a_map_that_fills_up_is_measured_again():
    noisy = HeightMap(white((160, 160), 0.01))
    first = np.full((160, 160), np.nan, np.float32)
    first[:20, :20] = 0.0
    planner = Planner(HeightMap(first), heuristic="manual")
    assert planner.conditioning.noise.window == 0
    assert planner.update(noisy).conditioning.noise.deviation == pytest.approx(0.01, rel=0.1)
    assert planner.plan(START, GOAL, weight=1.25).steps == 0


def test_a_measured_map_after_a_conditioned_one_is_conditioned_and_the_reverse():
    noisy = HeightMap(white((120, 120), 0.01))
    done = noisy.conditioned().terrain
    for first, second in ((done, noisy), (noisy, done)):
        planner, fresh = Planner(first).update(second), Planner(second)
        np.testing.assert_array_equal(planner.terrain.heights, fresh.terrain.heights)
        assert planner.conditioning == fresh.conditioning


def test_no_conditioning_is_advised_where_it_does_not_help():
    heights = np.zeros((160, 160), np.float32)
    x, y = np.indices(heights.shape)
    heights[np.hypot(x - 60, y - 80) < 24] = np.nan  # wider than the robot that stands there
    for conditioning in (True, None):
        plan = Planner(HeightMap(heights), conditioning=conditioning).plan((1.5, 2.0, 0.0), (3.4, 2.0, 0.0))
        assert plan.status == Status.INFEASIBLE and plan.assumed and "unknown ground at" in plan.explain()
        assert "conditioned map" not in plan.explain()


def test_a_map_that_changes_as_a_whole_is_measured_again():
    planner = Planner(HeightMap.flat((160, 160)), heuristic="manual")
    noisy = HeightMap(white((160, 160), 0.02))
    assert planner.update(noisy).conditioning.noise.deviation == pytest.approx(0.02, rel=0.1)
    assert (
        planner.plan(START, GOAL, weight=1.25).cost == Planner(noisy, heuristic="manual").plan(START, GOAL, 1.25).cost
    )


def test_a_heuristic_for_another_map_than_the_conditioned_one_is_refused():
    noisy = HeightMap(white((80, 80), 0.01))
    planner = Planner(noisy)
    for heuristic in (
        GeometricHeuristic(planner.world),
        AbstractHeuristic(planner.world, planner.terrain, ManualCosts(planner.robot)),
    ):
        with pytest.raises(InputError, match=r"before its conditioning"):
            Planner(noisy, heuristic=heuristic)
        assert Planner(planner.terrain, heuristic=heuristic).heuristic is heuristic
