"""Motions made from plans are feasible, and the check finds infeasible ones."""

import dataclasses

import numpy as np
import pytest

from hdsp import HeightMap, InputError, Planner, RefinementError
from hdsp.detailed.motion.motion import PHASES, Motion
from hdsp.detailed.motion.refinement import refine
from hdsp.robot.robot import Robot

MOMARO = Robot.load("momaro")
BAR = slice(38, 42)


def with_bar(height=0.2):
    heights = np.zeros((88, 60), np.float32)
    heights[BAR] = height
    return HeightMap(heights)


def stretched(**legs):
    values = MOMARO.to_dict()
    return Robot.load({**values, "legs": {**values["legs"], **legs}})


@pytest.fixture(scope="module")
def plan():
    plan = Planner(with_bar(), heuristic="manual").plan((0.5, 0.75, 0.0), (1.6, 0.75, 0.0), weight=2)
    assert plan.solved and plan.steps == 4
    return plan


@pytest.fixture(scope="module")
def motion(plan):
    return plan.refine()


def test_a_motion_passes_its_check(motion):
    assert motion.check() == [] and isinstance(motion, Motion)
    stance, legs = MOMARO.stance, MOMARO.legs
    assert motion.margins().min() >= stance.margin
    lengths = motion.leg_lengths()
    assert legs.min_length <= lengths.min() and lengths.max() <= legs.max_length
    assert motion.heights_over_ground().min() >= 0
    assert motion.swing_clearances().min() >= stance.swing_clearance
    assert motion.body_penetrations().max() == 0


def test_a_motion_leads_from_the_start_to_the_goal_of_the_plan(plan, motion):
    for end in (0, -1):
        np.testing.assert_allclose(motion.base[end, [0, 1, 5]], plan.states[end, :3], atol=1e-9)
        assert motion.base[end, 2] == pytest.approx(MOMARO.stance.base_height)
        assert motion.carries[end].all()
    assert (np.diff(motion.action) >= 0).all() and set(motion.action) == set(range(len(plan.actions)))


def test_nothing_jumps(motion):
    assert abs(np.diff(motion.base[:, :3], axis=0)).max() <= 0.026
    assert abs(np.diff(motion.base[:, 3:], axis=0)).max() <= 0.11  # a heading step
    moved = np.linalg.norm(np.diff(motion.feet, axis=0), axis=2)
    assert moved.max() <= 0.1  # the largest foot movement while the robot turns by a heading step


def test_a_step_lifts_one_foot_over_the_bar(plan, motion):
    for k, action in enumerate(plan.actions):
        rows = motion.action == k
        lifted = ~motion.carries[rows]
        if action.stepping_foot is None:
            assert not lifted.any()
            continue
        assert (lifted.sum(axis=0) > 0).sum() == 1 and lifted.sum(axis=1).max() == 1
        assert motion.feet[rows][lifted][:, 2].max() >= 0.2 + MOMARO.stance.swing_clearance
        phases = motion.phase[rows]
        order = phases[np.flatnonzero(np.diff(phases)) + 1].tolist()
        assert [PHASES[p] for p in order][-4:] == ["lift", "swing", "lower", "lean"]


def changed(motion, **arrays):
    return dataclasses.replace(motion, **arrays)


def first_step(motion):
    return int(np.flatnonzero(motion.phase == PHASES.index("swing"))[3])


def moved(array, row, column, by):
    result = array.copy()
    result[row, column] += by
    return result


def test_the_check_finds_what_is_wrong(motion):
    n = first_step(motion)
    swinging = int(np.flatnonzero(~motion.carries[n])[0])
    standing = (swinging + 1) % 4

    def foot(which, dz):
        feet = motion.feet.copy()
        feet[n, which, 2] += dz
        return feet

    wrong = {
        "inside the support polygon": {"base": moved(motion.base, n, 1, 0.2)},
        "leg would be": {"base": moved(motion.base, n, 2, 0.5)},
        "into the body": {"base": moved(motion.base, n, 2, -0.33)},
        "below the ground": {"feet": foot(standing, -0.01)},
        "above the ground": {"feet": foot(standing, 0.01)},
        "above what lies on its way": {"feet": foot(swinging, -0.04)},
        "leans": {"base": moved(motion.base, n, 3, 0.4)},
    }
    for words, change in wrong.items():
        found = changed(motion, **change).problems()
        assert found and all(row == n for row, _ in found), words
        assert any(words in why for _, why in found), (words, found)
    carries = motion.carries.copy()
    carries[n] = False
    assert any("support polygon" in line for line in changed(motion, carries=carries).check())


def test_a_step_beyond_the_legs_is_refused_by_name(plan):
    with pytest.raises(
        RefinementError, match=r"step \w+ \+0\.\d+ at .* cannot be carried out.*0\.6 to 0\.68 m"
    ) as error:
        refine(plan.terrain, stretched(min_length=0.6, max_length=0.68), plan.states, plan.actions)
    assert plan.actions[error.value.action].stepping_foot is not None
    assert "\n" not in str(error.value)


def test_a_plan_that_does_not_exist_has_no_motion():
    plan = Planner(with_bar(1.0)).plan((0.5, 0.75, 0.0), (0.95, 0.75, 0.0))
    with pytest.raises(InputError, match="no plan to refine"):
        plan.refine()
