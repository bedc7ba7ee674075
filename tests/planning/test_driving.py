"""A robot made from its file drives along our plans in MuJoCo."""

import json
import math
import os
import re
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.driven.tasks import map_of
from hdsp import HeightMap, InputError, Planner, Robot
from hdsp.detailed.motion.motion import Motion
from hdsp.planning.cli import main
from hdsp.planning.commands.drive_command import FAILED
from hdsp.planning.driving.contact_forces import ContactForces
from hdsp.planning.driving.drive_film import glass_walls, pictures
from hdsp.planning.driving.driven_run import Ending
from hdsp.planning.driving.follower import Follower
from hdsp.planning.driving.ground_model import rectangles
from hdsp.planning.driving.reference import Reference
from hdsp.planning.driving.robot_model import Dimensions, robot_mjcf
from hdsp.planning.driving.simulated_robot import SimulatedRobot
from hdsp.planning.margin import DRIVEN_MARGIN
from hdsp.terrain.obstacles import Bank, Block, Ramp, Scene, TiltedGround

os.environ.setdefault("MUJOCO_GL", "egl")  # read when MuJoCo is imported
mujoco = pytest.importorskip("mujoco")
pytest.importorskip("quadprog")

PRESETS = Robot.presets()
START = (1.0, 1.25, 0.0)


def block(height: float, begin: float = 1.8) -> HeightMap:
    """Level ground with a step across at x = ``begin``."""
    heights = np.zeros((160, 100), np.float32)
    heights[round(begin / 0.025) :] = height
    return HeightMap(heights)


@lru_cache
def plan(robot: str, goal: tuple[float, float, float], height: float = 0.0, weight: float = 2.0):
    found = Planner(block(height), robot, "geometric").plan(START, goal, weight=weight, refinable=True, polish=0)
    assert found.solved
    return found


def with_pitch(robot: Robot, more: float) -> Robot:
    """The robot with a larger limit of pitch, because cells round the slope of the ground."""
    return replace(robot, slope=replace(robot.slope, max_pitch=robot.slope.max_pitch + more))


def headed(run) -> float:
    """Heading at the end."""
    return float(run.motion.base[-1, 5])


@pytest.mark.parametrize("robot", PRESETS)
def test_a_robot_stands_still(robot):
    motion = plan(robot, START).refine()
    sim = SimulatedRobot(motion.robot, motion.terrain)
    sim.place(motion.base[0], motion.feet[0])
    follower = Follower(sim, Reference(motion, sim.size.radius), np.random.default_rng(0))
    for _ in range(round(10 / 0.004)):
        follower.control(0.004, hold=True)
        sim.step()
        sim.step()
    forces, touched = sim.contacts()
    assert not touched
    assert np.linalg.norm(sim.base_place() - motion.base[0, :3]) < 0.02
    assert np.linalg.norm(sim.velocity()) < 0.05
    assert forces[:, 2].sum() == pytest.approx(sim.size.weight, rel=0.1)


@pytest.mark.parametrize("robot", PRESETS)
def test_a_robot_drives_a_metre(robot):
    run = plan(robot, (2.0, 1.25, 0.0)).drive()
    assert run.success, run.cause
    assert run.motion.base[-1, 0] - run.motion.base[0, 0] == pytest.approx(1.0, abs=0.05)
    assert run.slip.max() < 0.01 and run.least_margin > 0.1
    assert 0 < run.energy < 1000
    assert (np.diff(run.progress) >= 0).all()


@pytest.mark.parametrize("robot", PRESETS)
def test_a_robot_turns(robot):
    run = plan(robot, (*START[:2], math.pi / 2)).drive()
    assert run.success, run.cause
    assert headed(run) == pytest.approx(math.pi / 2, abs=0.1)


@pytest.mark.parametrize(
    ("robot", "height", "weight"), [("momaro", 0.2, 2.0), ("anymal_wheels", 0.15, 2.0), ("go2w", 0.15, 1.2)]
)
def test_a_robot_steps_up(robot, height, weight):
    found = plan(robot, (2.5, 1.25, 0.0), height, weight)
    run = found.drive(Scene((Block(4.8, 1.25, 0.0, 6.0, 2.5, height),)))
    assert run.success, run.cause
    assert found.steps >= 4
    assert run.motion.base[-1, 2] - run.motion.base[0, 2] == pytest.approx(height, abs=0.03)
    assert run.slip.max() < 0.05


def test_a_drive_is_a_function_of_its_seed():
    found = plan("momaro", (1.5, 1.25, 0.0))
    first, again, other = (found.drive(seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(first.positions, again.positions) and first.energy == again.energy
    assert not np.array_equal(first.positions[: len(other.positions)], other.positions[: len(first.positions)])


FAR = np.array([412345.678, 5654321.123])  # single precision has steps of half a metre there


def far(terrain: HeightMap) -> HeightMap:
    return replace(terrain, origin=tuple(FAR + terrain.origin))


@pytest.mark.parametrize("natural", [False, True])
def test_ground_of_a_projected_map_lies_in_its_place(natural):
    heights = block(0.2).heights + (0.002 * np.random.default_rng(0).random((160, 100)) if natural else 0.0)
    near, robot = HeightMap(heights, (-3.0, 2.0)), Robot.load("momaro")
    one, other = SimulatedRobot(robot, near).model, SimulatedRobot(robot, far(near), tuple(FAR)).model
    assert one.nhfield == natural
    np.testing.assert_allclose(other.geom_pos, one.geom_pos, atol=1e-6)
    np.testing.assert_allclose(other.geom_size, one.geom_size, atol=1e-9)


@pytest.mark.parametrize("ground", [None, TiltedGround(0.1, -0.2)])
@pytest.mark.parametrize("place", [(0.0, 0.0), (412.0, -513.5)])
def test_ground_of_a_scene_has_its_heights_everywhere(ground, place):
    blocks = (
        Block(1.0, 0.5, 0.3, 1.0, 0.6, 0.2),
        Ramp(-1.5, 0.0, 1.2, 1.4, 1.0, 0.3),
        Bank(0.0, -1.6, 0.0, 1.2, 0.8, 0.25, 0.4),
    )
    moved = [replace(each, x=each.x + place[0], y=each.y + place[1]) for each in blocks]
    scene, sim = Scene(tuple(moved), ground), None
    sim = SimulatedRobot(Robot.load("momaro"), scene, place)
    sim.data.qpos[2] = 50.0  # the robot out of the way
    mujoco.mj_forward(sim.model, sim.data)
    hit, found, expected = np.zeros(1, np.int32), [], []
    for x, y in np.random.default_rng(0).uniform(-2.5, 2.5, (200, 2)):
        near = scene.heights_at(
            place[0] + x + np.array([0, 0, 0, 0.01, -0.01]), place[1] + y + np.array([0, 0.01, -0.01, 0, 0])
        )
        if np.ptp(near) < 0.02:  # not beside an edge
            top = 40.0 + float(near[0])
            found.append(top - mujoco.mj_ray(sim.model, sim.data, [x, y, top], [0, 0, -1], None, 1, -1, hit))
            expected.append(near[0])
    assert len(found) > 150
    np.testing.assert_allclose(found, expected, atol=2e-3)


def test_a_drive_on_a_projected_map_is_the_drive_near_zero(tmp_path):
    terrain, goal = block(0.2, 2.4), (1.5, 1.25, 0.0)
    near = plan("momaro", goal).drive(terrain)
    start, goal = ((*(FAR + pose[:2]), pose[2]) for pose in (START, goal))
    found = Planner(far(block(0.0)), "momaro", "geometric").plan(start, goal, weight=2.0, refinable=True, polish=0)
    run = found.drive(far(terrain))
    assert near.success and run.success, (near.cause, run.cause)
    assert run.place == tuple(FAR) and near.place == (0.0, 0.0)
    np.testing.assert_allclose(run.positions[-1], near.positions[-1], atol=0.02)
    np.testing.assert_allclose(run.motion.base[0] - (*FAR, 0, 0, 0, 0), near.motion.base[0], atol=1e-3)
    np.testing.assert_allclose(run.motion.feet[-1] - (*FAR, 0), near.motion.feet[-1], atol=0.02)
    assert run.energy == pytest.approx(near.energy, rel=0.1)
    wall = Scene((Block(FAR[0] + 1.7, FAR[1] + 1.25, 0.0, 0.1, 2.0, 1.0),))
    hit = found.drive(wall)
    assert hit.ending is Ending.BODY_TOUCHED and re.search(r"at \(41234\d\.\d\d, 565432\d\.\d\d\) m", hit.cause)
    try:
        shown = [next(pictures(each, [0], (160, 120))) for each in (run, near)]
    except InputError as error:
        pytest.skip(str(error))
    one, other = (np.asarray(picture.convert("RGB"), float) for picture in shown)
    assert np.abs(one - other).mean() < 2 and one.std() > 10


def test_a_drive_that_ends_at_once_is_a_motion(tmp_path):
    found = plan("momaro", (1.5, 1.25, 0.0))
    run = found.drive(Scene((Block(1.0, 1.25, 0.0, 2.0, 2.0, 0.5), Block(1.0, 1.25, 0.0, 0.2, 0.2, 1.5))))
    assert len(run.motion) == 1 and run.duration == 0 and not run.success
    state = run.motion.at([0.0, 0.1])
    assert not state.base_velocity.any() and not state.feet_velocity.any()
    np.testing.assert_array_equal(state.base, run.motion.base[[0, 0]])
    for wrong in ("soon", np.nan):
        with pytest.raises(InputError, match="time"):
            run.motion.at(wrong)
    for name in ("run.csv", "run.json", "run.npz", "run.mcap", "bag"):
        assert run.save(tmp_path / name).exists()
    assert len(Motion.load(tmp_path / "run.npz")) == 1
    json.dumps(run.facts(), allow_nan=False)
    assert repr(run.motion) == "DrivenMotion(momaro: 1 configurations, 1 actions, 0 of them steps)"
    try:
        assert run.save(tmp_path / "run.gif").stat().st_size > 1000
    except InputError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("seed", [None, "3", -1, 1.5, True])
def test_a_seed_that_is_none_is_refused(seed):
    with pytest.raises(InputError, match="seed is"):
        plan("momaro", (1.5, 1.25, 0.0)).drive(seed=seed)


def test_unknown_ground_ends_the_drive_with_its_cause():
    found = plan("momaro", (2.0, 1.25, 0.0))
    wall = Scene((Block(2.0, 1.25, 0.0, 0.1, 2.0, 1.0),))
    run = found.drive(wall)
    assert run.ending is Ending.BODY_TOUCHED and not run.success
    assert run.cause.startswith("the body touched the ground at (") and "in action" in run.cause
    sim = SimulatedRobot(run.motion.robot, wall)
    assert glass_walls(sim, run) and (sim.model.geom_rgba[sim.model.geom_bodyid == 0, 3] < 1).sum() == 1
    assert not glass_walls(SimulatedRobot(run.motion.robot, block(0.2)), run)
    assert run.facts()["ending"] == "body_touched"
    json.dumps(run.facts(), allow_nan=False)


def test_the_margin_covers_the_half_cell_that_a_map_hides():
    """The true wall begins 7 mm inside a body that the planner, with the centres of cells, believes free."""
    half = Robot.load("momaro").body.boxes[-2].half_width
    edge = START[1] + half - 0.007
    wall = Scene((Block(1.75, edge + 0.2, 0.0, 0.1, 0.4, 1.0),))
    terrain = map_of(wall, (4.0, 2.5))
    rooms = []
    for margin in (0.0, DRIVEN_MARGIN):
        found = Planner(terrain, "momaro", "geometric", margin=margin).plan(
            START, (2.3, *START[1:]), weight=2, refinable=True, polish=0
        )
        x, y, heading = found.refine().base[:, [0, 1, 5]].T
        along, across = np.cos(heading), np.sin(heading)
        dx, dy = np.array([[1.7], [1.75], [1.8]]) - x, edge - y
        outside = np.maximum(np.abs(dx * along + dy * across) - 0.4375, dy * along - dx * across - half)
        rooms.append(outside.min())
        if not margin:
            assert found.drive(wall).ending is Ending.BODY_TOUCHED
    assert rooms[0] < 0 and rooms[1] > 0.01  # a robot leaves its motion by up to a centimetre


def test_a_robot_brakes_on_the_steepest_ground_that_it_plans():
    robot = Robot.load("go2w")
    ramp = Scene((Ramp(2.5, 1.5, 0.0, 5.0, 3.0, 5.0 * math.tan(robot.slope.max_pitch)),))
    down = (3.0, 1.5, math.pi), (2.5, 1.5, math.pi)
    terrain = map_of(ramp, (5.0, 3.0))
    found = Planner(terrain, with_pitch(robot, 0.02), "geometric").plan(*down, weight=2, refinable=True, polish=0)
    run = found.drive(ramp)
    assert run.success, run.cause
    assert run.slip.max() < 0.02


def test_a_missing_step_is_told():
    found = plan("momaro", (2.5, 1.25, 0.0), 0.2)
    run = found.drive(HeightMap.flat((160, 100)))
    assert run.ending is Ending.FOOT_MISSED
    assert "foot found no ground" in run.cause


def test_a_slope_steeper_than_friction_slides():
    """The robot stands on a ramp: below the angle of friction it stays, above it slides."""
    robot = Robot.load("go2w")
    moved = []
    for friction in (1.0, 0.2):
        chosen = replace(robot, physics=replace(robot.physics, friction=friction))
        ramp = Scene((Ramp(2.0, 0.0, 0.0, 4.0, 3.0, 4.0 * math.tan(0.35)),))
        heights = np.tile((0.0125 + 0.025 * np.arange(160)) * math.tan(0.35), (120, 1)).T.astype(np.float32)
        terrain = HeightMap(heights, origin=(0.0, -1.5))
        found = Planner(terrain, chosen, "geometric").plan((2.0, 0.0, 0.0), (2.0, 0.0, 0.0))
        motion = found.refine()
        sim = SimulatedRobot(chosen, ramp)
        sim.place(motion.base[0] + (0, 0, 0.005, 0, 0, 0), motion.feet[0] + (0, 0, 0.005))
        follower = Follower(sim, Reference(motion, sim.size.radius), np.random.default_rng(0))
        for _ in range(500):
            follower.control(0.004, hold=True)
            sim.step()
            sim.step()
        moved.append(float(np.linalg.norm((sim.feet() - motion.feet[0])[:, :2], axis=1).mean()))
    assert moved[0] < 0.04 < 0.2 < moved[1]


@pytest.mark.parametrize("robot", PRESETS)
def test_the_model_has_the_masses_of_the_file(robot):
    loaded = Robot.load(robot)
    model = mujoco.MjModel.from_xml_string(robot_mjcf(loaded))
    data = mujoco.MjData(model)
    names = {model.joint(k).name for k in range(model.njnt)}
    assert {"front_left_x", "rear_right_wheel_joint"} <= names
    assert ("front_left_steering" in names) == loaded.drive.sideways
    height = loaded.stance.base_height
    for foot in ("front_left", "rear_left", "rear_right", "front_right"):
        data.qpos[model.joint(f"{foot}_z").qposadr] = Dimensions.of(loaded).radius - height
    mujoco.mj_forward(model, data)
    assert model.body_subtreemass[1] == pytest.approx(loaded.physics.mass, rel=1e-6)
    center = data.subtree_com[1] - data.qpos[:3]
    assert center == pytest.approx([loaded.stance.mass_x, 0.0, loaded.stance.mass_z], abs=1e-6)


def test_a_robot_file_without_physics_gets_values_from_its_size():
    values = Robot.load("momaro").to_dict()
    del values["physics"]
    size = Dimensions.of(Robot.load(values))
    assert 20 < size.mass < 200 and size.radius == values["feet"]["clearance"]
    assert size.leg_force > size.weight / 4 and size.wheel_torque > 0


@settings(max_examples=40)
@given(st.data())
def test_forces_hold_the_wrench_within_friction(data):
    number = st.floats(-1, 1)
    feet = np.array([(0.3, 0.2, 0), (-0.3, 0.2, 0), (-0.3, -0.2, 0), (0.3, -0.2, 0)], float)
    feet[:, 2] = [0.2 * data.draw(number) for _ in range(4)]
    center = np.array([0.1 * data.draw(number), 0.05 * data.draw(number), 0.7])
    wrench = np.array([20 * data.draw(number), 20 * data.draw(number), 500.0, *(5 * data.draw(number) for _ in "xyz")])
    load = np.ones(4)
    forces = ContactForces(0.8, 700.0, 0.3)(feet, center, wrench, load)
    assert (forces[:, 2] >= -1e-6).all() and (np.linalg.norm(forces[:, :2], axis=1) <= 0.8 * forces[:, 2] + 1e-6).all()
    held = np.concatenate([forces.sum(axis=0), np.cross(feet - center, forces).sum(axis=0)])
    assert held == pytest.approx(wrench, abs=2.0)
    load[0] = 0
    assert (ContactForces(0.8, 700.0, 0.3)(feet, center, wrench, load)[0] == 0).all()


@settings(max_examples=60)
@given(st.lists(st.lists(st.sampled_from([0.0, 0.1, 0.2, np.nan]), min_size=5, max_size=5), min_size=1, max_size=8))
def test_rectangles_cover_each_known_cell_once(rows):
    heights = np.array(rows)
    covered = np.full(heights.shape, np.nan)
    for piece in rectangles(heights):
        assert np.isnan(covered[piece.x0 : piece.x1, piece.y0 : piece.y1]).all()
        covered[piece.x0 : piece.x1, piece.y0 : piece.y1] = piece.height
    np.testing.assert_allclose(covered, heights, atol=1e-4)
    assert rectangles(heights, most=0) is None or np.isnan(heights).all()


def test_natural_ground_becomes_a_height_field():
    random = np.random.default_rng(0)
    terrain = HeightMap(random.normal(0, 0.002, (160, 100)).astype(np.float32))
    sim = SimulatedRobot(Robot.load("momaro"), terrain)
    assert sim.model.nhfield == 1 and SimulatedRobot(Robot.load("momaro"), block(0.2)).model.nhfield == 0
    found = Planner(HeightMap.flat((160, 100)), "momaro", "geometric").plan(START, (1.5, 1.25, 0.0))
    run = found.drive(terrain)
    assert run.success, run.cause


def test_a_drive_is_recorded_and_drawn(tmp_path):
    from PIL import Image

    from hdsp.planning.driving.drive_film import save_film

    run = plan("momaro", (1.5, 1.25, 0.0)).drive()
    assert run.save(tmp_path / "run.csv").read_text().count("\n") > 50 * run.duration
    assert run.save(tmp_path / "run.mcap", rate=5).stat().st_size > 10_000
    for look in ({"speed": "2"}, {"width": 200.5}, {"height": "high"}, {"speed": 1e-6}):
        with pytest.raises(InputError, match=r"need"):
            save_film(run, tmp_path / "run.gif", **look)
    try:
        save_film(run, tmp_path / "run.gif", speed=1.0, fps=1.0, width=160, height=120)
    except InputError as error:
        pytest.skip(str(error))
    with Image.open(tmp_path / "run.gif") as film:
        assert film.n_frames >= 3
        shown = np.asarray(film.convert("RGB"), float)
    assert shown.std() > 10  # a picture of something


def test_the_command_drives(tmp_path, capsys):
    HeightMap.flat((120, 80)).save(tmp_path / "flat.npz")
    holes = np.zeros((120, 80), np.float32)
    holes[68:] = 1.0
    HeightMap(holes).save(tmp_path / "wall.npz")
    query = ["drive", str(tmp_path / "flat.npz"), "--start", "1", "1", "0", "--goal", "1.5", "1", "0", "--heuristic"]
    query += ["geometric", "--quiet"]
    assert main([*query, "--record", str(tmp_path / "run.json")]) == 0
    assert "arrived" in capsys.readouterr().out and (tmp_path / "run.json").is_file()
    assert main([*query, "--truth", str(tmp_path / "wall.npz"), "--json"]) == FAILED
    found = json.loads(capsys.readouterr().out)
    assert found["run"]["success"] is False and found["solved"] is True and found["run"]["cause"]
    for option, value in (("--seed", "-1"), ("--video", "x.avi"), ("--record", "x.mp4")):
        assert main([*query, option, value]) == 1
        assert value in capsys.readouterr().err
