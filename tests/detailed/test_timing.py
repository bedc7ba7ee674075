"""Times of motions: limits of speed and acceleration hold at any time, and the robot stays stable."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.timed_motions import excesses, findings
from hdsp import HeightMap, InputError, Planner
from hdsp.detailed.motion.motion import PHASES, Motion
from hdsp.detailed.motion.rounded_path import RoundedPath
from hdsp.robot.robot import Robot

MOMARO = Robot.load("momaro")
LIFT, SWING, LOWER = (PHASES.index(name) for name in ("lift", "swing", "lower"))


@pytest.fixture(scope="module")
def motion():
    heights = np.zeros((88, 60), np.float32)
    heights[38:42] = 0.2
    plan = Planner(HeightMap(heights), heuristic="manual").plan((0.5, 0.75, 0.0), (1.6, 0.75, 0.3), weight=2)
    return plan.refine()


def drive(places, robot=MOMARO):
    """A motion on flat ground on neutral feet, through base poses [n, 3]."""
    places = np.asarray(places, float)
    base = np.zeros((len(places), 6))
    base[:, [0, 1, 5]] = places
    base[:, 2] = robot.stance.base_height
    states = np.concatenate([places, np.zeros((len(places), 4))], axis=1)
    feet = np.concatenate([robot.foot_positions(states), np.zeros((len(places), 4, 1))], axis=2)
    n = len(places)
    terrain = HeightMap(np.zeros((400, 400), np.float32), (-5.0, -5.0))
    flags = np.ones((n, 4), bool), np.zeros(n, int), np.zeros(n, np.uint8)
    return Motion(base, feet, *flags, terrain, robot)


def test_a_straight_drive_is_a_trapezoid():
    """2 m at 0.5 m/s and 0.5 m/s2: one second to speed up, three at full speed, one to brake."""
    motion = drive([(x, 0.0, 0.0) for x in np.linspace(0, 2, 81)])
    assert motion.duration == pytest.approx(5.0, abs=1e-6)
    state = motion.at([0.0, 0.5, 1.0, 2.5, 4.0, 4.5, 5.0 - 1e-9])
    np.testing.assert_allclose(state.base[:, 0], [0, 0.0625, 0.25, 1.0, 1.75, 1.9375, 2.0], atol=1e-6)
    np.testing.assert_allclose(state.base_velocity[:, 0], [0, 0.25, 0.5, 0.5, 0.5, 0.25, 0], atol=1e-6)
    np.testing.assert_allclose(state.feet_velocity[:, 2, 0], state.base_velocity[:, 0], atol=1e-9)


def test_a_short_drive_is_a_triangle():
    motion = drive([(0.0, 0.0, 0.0), (0.125, 0.0, 0.0)])
    assert motion.duration == pytest.approx(1.0)  # 2 sqrt(0.125 / 0.5)
    assert motion.at(0.5).base_velocity[0] == pytest.approx(0.25)


def test_angles_turn_the_short_way():
    motion = drive([(0.0, 0.0, 3.1), (0.0, 0.0, -3.1)])
    assert abs(motion.at(np.linspace(0, motion.duration, 50)).base[:, 5]).min() >= 3.1
    assert motion.duration < 0.6


def test_no_limit_is_exceeded_and_every_state_is_stable(motion):
    assert max(excesses(motion, 200)) < 1e-6
    assert findings(motion, 50) == (0, [])


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["momaro", "go2w"]))
def test_no_limit_is_exceeded_on_random_ways(seed, name):
    random = np.random.default_rng(seed)
    motion = drive(np.cumsum(random.normal(0, [0.03, 0.03, 0.1], (12, 3)), axis=0), Robot.load(name))
    # Between headings, feet move on chords, not on arcs: their speed across the base is small, but no 0.
    speed, acceleration = excesses(motion, 300)
    assert speed < 1e-3 and acceleration < 0.05


def test_the_motion_passes_its_configurations(motion):
    assert (np.diff(motion.times) >= 0).all() and motion.times[0] == 0
    state = motion.at(motion.times)
    assert abs(state.base[:, :3] - motion.base[:, :3]).max() <= 0.0016
    assert abs(state.base[:, 3:] - motion.base[:, 3:]).max() <= 0.0031
    assert abs(state.feet - motion.feet).max() <= 0.0016
    for row in (0, -1):
        np.testing.assert_allclose(state.base[row], motion.base[row], atol=1e-9)
        np.testing.assert_allclose(state.base_velocity[row], 0, atol=1e-6)
        assert state.carries[row].all()


def test_feet_stop_where_they_leave_and_touch_the_ground(motion):
    changes = np.flatnonzero((np.diff(motion.carries, axis=0)).any(axis=1))
    assert len(changes) == 8  # four steps
    state = motion.at(motion.times[changes])
    np.testing.assert_allclose(state.base_velocity, 0, atol=1e-6)
    np.testing.assert_allclose(state.feet_velocity, 0, atol=1e-6)
    for start, end in changes.reshape(-1, 2):
        phases = motion.at(np.linspace(motion.times[start], motion.times[end], 60)[1:-1]).phase
        assert sorted(set(phases)) == [LIFT, SWING, LOWER] and (np.diff(phases.astype(int)) >= 0).all()


def test_the_robot_stops_nowhere_else(motion):
    changes = np.flatnonzero((np.diff(motion.carries, axis=0)).any(axis=1))
    halts = {0.0, motion.duration, *motion.times[changes].tolist()}
    between = np.array([time for time in motion.times.tolist() if time not in halts])
    state = motion.at(between)
    moving = abs(state.base_velocity).max(axis=1) + abs(state.feet_velocity).max(axis=(1, 2))
    assert len(between) > 200 and moving.min() > 0.01


def test_a_state_shows_itself_in_a_line(motion):
    for state in (motion.at(1.0), motion.at([0.0, 1.0])):
        assert repr(state).startswith("MotionState(time=float64 [") and len(repr(state)) <= 280


def test_contacts_change_at_their_time(motion):
    last = int(np.flatnonzero(np.diff(motion.carries, axis=0).any(axis=1))[0])
    foot = int(np.flatnonzero(motion.carries[last] != motion.carries[last + 1])[0])
    when = motion.times[last]
    before, after = motion.at(when), motion.at(when + 1e-6)
    assert before.carries.all() and not after.carries[foot]


def test_a_state_has_the_shape_of_its_time(motion):
    one, many = motion.at(1.0), motion.at([[0.5, 1.0, 1.5]])
    assert one.base.shape == (6,) and one.feet.shape == (4, 3) and one.margin.shape == ()
    assert many.base.shape == (1, 3, 6) and many.carries.shape == (1, 3, 4) and many.action.dtype == np.int64
    for name in ("base", "feet", "margin", "base_velocity"):
        np.testing.assert_allclose(getattr(many, name)[0, 1], getattr(one, name))
    assert one.margin == pytest.approx(dataclasses.replace(
        motion, base=one.base[None], feet=one.feet[None], carries=one.carries[None]
    ).margins()[0])  # fmt: skip


@pytest.mark.parametrize("wrong", [-0.1, np.nan, 1e6, [0.0, 1e6]])
def test_times_outside_the_motion_are_refused(motion, wrong):
    with pytest.raises(InputError, match=r"the motion lasts from 0 to \d+"):
        motion.at(wrong)


@pytest.mark.parametrize("wrong", ["soon", {}, 10**400, [[1.0], [1.0, 2.0]], True])
def test_times_and_rates_that_are_no_numbers_are_refused(motion, wrong, tmp_path):
    with pytest.raises(InputError, match=r"time .*: need numbers from 0 to"):
        motion.at(wrong)
    with pytest.raises(InputError, match=r"rate is .*; need a positive number"):
        motion.save(tmp_path / "motion.csv", rate=wrong)
    with pytest.raises(InputError, match=r"speed .*; need a positive number"):
        motion.animate(tmp_path / "motion.gif", speed=wrong)


def test_nothing_is_no_time(motion):
    with pytest.raises(InputError, match="time None: need numbers from 0 to"):
        motion.at(None)


def test_faster_limits_make_faster_motions(motion):
    values = MOMARO.to_dict()
    double = {name: {key: 2 * value for key, value in values[name].items()} for name in ("speeds", "accelerations")}
    faster = dataclasses.replace(motion, robot=Robot.load(values | double))
    assert motion.duration / 2 < faster.duration < 0.75 * motion.duration


def test_a_motion_that_rests_takes_no_time(motion):
    rest = dataclasses.replace(motion, **{
        name: getattr(motion, name)[:1] for name in ("base", "feet", "carries", "action", "phase")
    })  # fmt: skip
    assert rest.duration == 0 and rest.times.tolist() == [0]
    np.testing.assert_array_equal(rest.at(0.0).base, motion.base[0])


@given(st.integers(0, 2**32 - 1))
def test_rounded_paths_are_smooth_and_near_their_lines(seed):
    random = np.random.default_rng(seed)
    points, length = random.normal(size=(6, 2)), random.uniform(0.1, 1.0, 5)
    radius = np.zeros(6)
    radius[1:-1] = random.uniform(0.1, 0.5, 4) * np.minimum(length[:-1], length[1:])
    path = RoundedPath(points, length, radius)
    s = np.linspace(0, path.at[-1], 4001)
    at, slope = path(s)
    lines = np.stack([np.interp(s, path.at, column) for column in points.T], axis=1)
    bent = np.diff(np.diff(points, axis=0) / length[:, None], axis=0)
    bent = np.linalg.norm(bent, axis=1)
    assert np.linalg.norm(at - lines, axis=1).max() <= (bent * radius[1:-1] / 4).max() + 1e-9
    sharpest = (bent / (2 * radius[1:-1])).max()  # second derivative
    step = s[1] - s[0]
    assert np.linalg.norm(np.diff(slope, axis=0), axis=1).max() <= sharpest * step + 1e-9
    assert np.linalg.norm(np.diff(at, axis=0) / step - slope[:-1], axis=1).max() <= sharpest * step + 1e-9
    lines, arcs = path.pieces()
    assert (lines >= -1e-12).all() and lines.sum() + arcs.sum() == pytest.approx(length.sum())
