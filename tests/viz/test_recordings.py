"""Recordings hold the states of the motion: each format read back by another library."""

import csv
import json
import math
import sys
from xml.etree import ElementTree

import numpy as np
import pandas
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from hdsp import HeightMap, InputError, Planner
from hdsp.detailed.motion.motion import Motion
from hdsp.detailed.motion.phases import PHASES
from hdsp.robot import FEET, Robot, robot_urdf
from hdsp.robot.urdf import leg_joints, wheel_frame, wheel_radius
from hdsp.terrain.map_frame import MapFrame
from hdsp.viz.recordings.track import Track
from hdsp.viz.viewer.robot_pose import parts

NEAR = 1e-3  # m and s
TO_SOURCE = np.eye(4)
TO_SOURCE[:3, :3] = Rotation.from_euler("ZYX", [0.4, 0.05, -0.03]).as_matrix()
TO_SOURCE[:3, 3] = 10.0, -3.0, 1.5


@pytest.fixture(scope="module")
def motion():
    """Over a bar, on a map that was levelled."""
    heights = np.zeros((88, 60), np.float32)
    heights[38:42] = 0.2
    heights[70:80, 50:] = np.nan
    terrain = HeightMap(heights, frame=MapFrame("odom", "EPSG:25832", TO_SOURCE, ("levelled",)))
    plan = Planner(terrain, heuristic="manual", conditioning=False).plan(
        (0.5, 0.75, 0.0), (1.6, 0.75, 0.3), weight=2, refinable=True
    )
    assert plan.solved and plan.steps == 4
    return plan.refine()


@pytest.fixture(scope="module")
def folder(motion, tmp_path_factory):
    folder = tmp_path_factory.mktemp("recordings")
    for name in ("run.csv", "run.json", "run.npz", "run.mcap", "bag"):
        motion.save(folder / name, rate=20.0)
    assert {path.name for path in folder.iterdir()} == {"run.csv", "run.json", "run.npz", "run.mcap", "bag"}
    return folder


def in_source(points):
    return points @ TO_SOURCE[:3, :3].T + TO_SOURCE[:3, 3]


def rotations(base):
    return Rotation.from_euler("ZYX", base[:, [5, 4, 3]])


def assert_times(times, motion, rate=20.0):
    """Regular times from the start to the end."""
    assert times[0] == 0 and abs(times[-1] - motion.duration) < NEAR
    np.testing.assert_allclose(np.diff(times)[:-1], 1 / rate, atol=NEAR)


def test_pandas_reads_the_table(motion, folder):
    table = pandas.read_csv(folder / "run.csv")
    times = table["time"].to_numpy()
    assert_times(times, motion)
    state = motion.at(np.minimum(times, motion.duration))
    base = table[["x", "y", "z", "roll", "pitch", "heading"]].to_numpy()
    np.testing.assert_allclose(base, state.base, atol=NEAR)
    feet = table[[f"{foot}_{axis}" for foot in FEET for axis in "xyz"]].to_numpy()
    np.testing.assert_allclose(feet.reshape(-1, 4, 3), state.feet, atol=NEAR)
    np.testing.assert_allclose(table["margin"], state.margin, atol=NEAR)
    np.testing.assert_allclose(table[["v_x", "v_heading"]], state.base_velocity[:, [0, 5]], atol=NEAR)
    assert (table[[f"{foot}_contact" for foot in FEET]].to_numpy() == state.carries).all()
    assert (table["phase"] == [PHASES[p] for p in state.phase]).all() and (table["action"] == state.action).all()
    source = table[["source_x", "source_y", "source_z"]].to_numpy()
    np.testing.assert_allclose(source, in_source(state.base[:, :3]), atol=NEAR)
    turned = Rotation.from_quat(table[[f"source_q{axis}" for axis in "xyzw"]].to_numpy())
    expected = Rotation.from_matrix(TO_SOURCE[:3, :3]) * rotations(state.base)
    assert (turned.inv() * expected).magnitude().max() < NEAR
    assert set(table["frame"]) == {"map"} and set(table["source_frame"]) == {"odom"}


def test_json_holds_states_and_frames(motion, folder):
    document = json.loads((folder / "run.json").read_text())
    states = document["states"]
    assert_times(np.array(states["time"]), motion)
    state = motion.at(np.minimum(states["time"], motion.duration))
    for name in ("base", "feet", "margin", "base_velocity", "feet_velocity"):
        np.testing.assert_allclose(states[name], getattr(state, name), atol=NEAR)
    assert states["carries"] == state.carries.tolist()
    assert document["feet"] == list(FEET) and document["robot"] == "momaro"
    frame = document["frame"]
    assert (frame["name"], frame["source"], frame["crs"], frame["notes"]) == ("map", "odom", "EPSG:25832", ["levelled"])
    np.testing.assert_allclose(frame["to_source"], TO_SOURCE)


@pytest.mark.parametrize("name", ["run.npz", "run.json"])
def test_a_motion_comes_back_from_its_file(motion, folder, name):
    back = Motion.load(folder / name, motion.terrain if name.endswith("json") else None)
    for field in ("base", "feet", "carries", "action", "phase"):
        np.testing.assert_array_equal(getattr(back, field), getattr(motion, field))
        assert getattr(back, field).dtype == getattr(motion, field).dtype
    assert back.duration == motion.duration and back.robot == motion.robot and back.check() == []
    np.testing.assert_array_equal(back.terrain.heights, motion.terrain.heights)
    np.testing.assert_array_equal(back.terrain.frame.to_source, TO_SOURCE)


def decoded(path):
    """All messages of an MCAP file by topic, as (time in s, message)."""
    found = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message in reader.iter_messages():
            value = json.loads(message.data) if channel.message_encoding == "json" else None
            if value is None:
                value = DecoderFactory().decoder_for("protobuf", schema)(message.data)
            found.setdefault(channel.topic, []).append((message.log_time / 1e9, value))
        metadata = {entry.name: entry.metadata for entry in reader.iter_metadata()}
        attached = [entry for entry in reader.iter_attachments()]
    return found, metadata, attached


def moved(transform):
    place, turn = transform.translation, transform.rotation
    return np.array([place.x, place.y, place.z]), Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])


def test_the_mcap_reader_reads_the_recording(motion, folder):
    topics, metadata, attached = decoded(folder / "run.mcap")
    assert set(topics) == {"/terrain", "/terrain_grid", "/path", "/robot", "/tf", "/state"}
    states = [value for _, value in topics["/state"]]
    times = np.array([state["time"] for state in states])
    assert_times(times, motion)
    np.testing.assert_allclose([moment for moment, _ in topics["/tf"]], times, atol=NEAR)
    state = motion.at(times)
    np.testing.assert_allclose([s["base"] for s in states], state.base, atol=NEAR)
    np.testing.assert_allclose(np.reshape([s["feet"] for s in states], (-1, 4, 3)), state.feet, atol=NEAR)
    assert [list(s["contacts"].values()) for s in states] == state.carries.tolist()
    for k in range(0, len(times), 37):
        frames = {t.child_frame_id: t for t in topics["/tf"][k][1].transforms}
        place, turn = moved(frames["base_link"])
        np.testing.assert_allclose(place, state.base[k, :3], atol=NEAR)
        assert (turn.inv() * rotations(state.base[k : k + 1])[0]).magnitude() < NEAR
        for i, foot in enumerate(FEET):
            down = turn.apply([0, 0, -wheel_radius(motion.robot)])
            np.testing.assert_allclose(moved(frames[wheel_frame(foot)])[0] + down, state.feet[k, i], atol=NEAR)
        place, turn = moved(frames["map"])
        assert frames["map"].parent_frame_id == "odom"
        np.testing.assert_allclose(place, TO_SOURCE[:3, 3], atol=1e-9)
        np.testing.assert_allclose(turn.as_matrix(), TO_SOURCE[:3, :3], atol=1e-9)
    grid = topics["/terrain_grid"][0][1]
    heights = np.frombuffer(grid.data, "<f4").reshape(-1, grid.column_count).T
    np.testing.assert_array_equal(heights, motion.terrain.heights)
    assert (grid.cell_size.x, grid.pose.position.x) == (motion.terrain.resolution, motion.terrain.origin[0])
    path = topics["/path"][0][1]
    np.testing.assert_allclose([[p.position.x, p.position.z] for p in path.poses], state.base[:, [0, 2]], atol=NEAR)
    assert json.loads(metadata["hdsp"]["frame"])["source"] == "odom"
    assert attached[0].name == "momaro.urdf" and attached[0].data.decode() == robot_urdf(motion.robot)


def test_all_shapes_of_the_recording_have_a_frame(motion, folder):
    topics, _, _ = decoded(folder / "run.mcap")
    frames = {t.child_frame_id for t in topics["/tf"][0][1].transforms} | {"odom"}
    ground, robot = (topics[name][0][1].entities for name in ("/terrain", "/robot"))
    assert {entity.frame_id for entity in [*ground, *robot]} <= frames and len(robot) == 1 + 3 * 4
    known, unknown = ground[0].triangles
    for mesh in (known, unknown):
        assert len(mesh.indices) % 3 == 0 and max(mesh.indices) < len(mesh.points)
    assert max(point.z for point in known.points) == pytest.approx(0.2) and len(known.colors) == len(known.points)


def test_rosbags_reads_the_bag(motion, folder):
    found = {}
    with AnyReader([folder / "bag"]) as reader:
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
        for connection, moment, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((moment / 1e9, message))
    assert kinds["/path"] == "nav_msgs/msg/Path"
    assert kinds["/base_trajectory"] == "trajectory_msgs/msg/MultiDOFJointTrajectory"
    assert kinds["/legs_trajectory"] == "trajectory_msgs/msg/JointTrajectory"
    points = found["/base_trajectory"][0][1].points
    times = np.array([p.time_from_start.sec + p.time_from_start.nanosec / 1e9 for p in points])
    assert_times(times, motion)
    state = motion.at(np.minimum(times, motion.duration))
    poses = [moved(point.transforms[0]) for point in points]
    np.testing.assert_allclose([place for place, _ in poses], state.base[:, :3], atol=NEAR)
    turns = Rotation.concatenate([turn for _, turn in poses])
    assert (turns.inv() * rotations(state.base)).magnitude().max() < NEAR
    linear = [[getattr(point.velocities[0].linear, axis) for axis in "xyz"] for point in points]
    np.testing.assert_allclose(linear, state.base_velocity[:, :3], atol=NEAR)
    legs = found["/legs_trajectory"][0][1]
    assert legs.joint_names == [joint for foot in FEET for joint in leg_joints(foot)]
    joints = np.reshape([point.positions for point in legs.points], (-1, 4, 3))
    centers = state.base[:, None, :3] + np.einsum(
        "nij,nfj->nfi", rotations(state.base).as_matrix(), joints + motion.robot.hips()
    )
    wheels = centers - wheel_radius(motion.robot) * rotations(state.base).as_matrix()[:, None, :, 2]
    np.testing.assert_allclose(wheels, state.feet, atol=NEAR)
    np.testing.assert_allclose([moment for moment, _ in found["/tf"]], times, atol=NEAR)
    (static,) = found["/tf_static"][0][1].transforms
    assert (static.header.frame_id, static.child_frame_id) == ("odom", "map")
    np.testing.assert_allclose(moved(static.transform)[1].as_matrix(), TO_SOURCE[:3, :3], atol=1e-9)
    words = [json.loads(message.data) for _, message in found["/contacts"]]
    assert [list(word["contacts"].values()) for word in words] == state.carries.tolist()
    assert found["/robot_description"][0][1].data == robot_urdf(motion.robot)
    assert len(found["/path"][0][1].poses) == len(found["/joint_states"]) == len(times)


def test_parts_are_where_the_viewer_draws_them(motion):
    track = Track(motion, rate=5.0)
    for k in range(0, len(track), 17):
        drawn = parts(motion.robot, track.state.base[k], track.state.feet[k], track.rolled[k])
        for own, other in ((track.legs[k], drawn.links), (track.wheels[k], drawn.wheels)):
            np.testing.assert_allclose(own[..., :3], other[..., :3], atol=1e-9)
            turns = [Rotation.from_quat(q.reshape(-1, 4)) for q in (own[..., 3:], np.roll(other[..., 3:], -1, axis=-1))]
            assert (turns[0].inv() * turns[1]).magnitude().max() < 1e-6


def test_angular_velocities_are_those_of_the_rotation(motion, folder):
    from hdsp.viz.recordings.ros_bag import angular_velocity

    base, rates, step = np.array([0, 0, 0, 0.1, 0.2, 0.7]), np.array([0, 0, 0, 0.3, -0.2, 0.5]), 1e-6
    first, second = rotations(np.stack([base, base + step * rates]))
    np.testing.assert_allclose(angular_velocity(base, rates), (second * first.inv()).as_rotvec() / step, atol=1e-4)


@pytest.mark.parametrize("name", Robot.presets())
def test_mujoco_reads_the_urdf(name):
    import mujoco

    robot = Robot.load(name)
    text = robot_urdf(robot)
    frames = ElementTree.fromstring(text).findall("link")
    assert len(frames) == 1 + 4 * 4
    model = mujoco.MjModel.from_xml_string(
        text.replace("<robot ", "<robot ", 1).replace(
            "</robot>", '<mujoco><compiler fusestatic="false" boundmass="1" boundinertia="1"/></mujoco></robot>'
        )
    )
    data = mujoco.MjData(model)
    positions = np.random.default_rng(0).uniform(-0.1, 0.1, (4, 3))
    for foot, values in zip(FEET, positions, strict=True):
        for joint, value in zip(leg_joints(foot), values, strict=True):
            data.joint(joint).qpos[0] = value
    mujoco.mj_forward(model, data)
    wheels = np.stack([data.body(wheel_frame(foot)).xpos for foot in FEET])
    np.testing.assert_allclose(wheels, robot.hips() + positions, atol=1e-9)


def test_a_map_in_its_source_frame_needs_no_transform(motion, tmp_path):
    own = Motion(**{**vars_of(motion), "terrain": HeightMap(motion.terrain.heights, frame=MapFrame("odom"))})
    own.save(tmp_path / "run.csv", rate=2)
    own.save(tmp_path / "run.mcap", rate=2)
    with (tmp_path / "run.csv").open() as file:
        names = next(csv.reader(file))
    assert not any(name.startswith("source_x") for name in names)
    topics, _, _ = decoded(tmp_path / "run.mcap")
    assert {t.parent_frame_id for t in topics["/tf"][0][1].transforms} == {"odom"}


def vars_of(motion):
    return {name: getattr(motion, name) for name in Motion.__dataclass_fields__}


def test_wrong_files_are_refused_in_one_line(motion, folder, tmp_path):
    (tmp_path / "other.npz").write_bytes(b"no archive")
    (tmp_path / "other.json").write_text('{"format": "something"}')
    for act, words in (
        (lambda: motion.save(tmp_path / "run.avi"), "suffix '.avi'"),
        (lambda: motion.save(tmp_path / "run.csv", rate=0), "rate is 0"),
        (lambda: motion.save(tmp_path / "run.csv", rate=math.nan), "rate is nan"),
        (lambda: motion.save(folder / "bag"), "exists already"),
        (lambda: Motion.load(tmp_path / "nothing.npz"), "no such file"),
        (lambda: Motion.load(tmp_path / "other.npz"), "no motion of hdsp"),
        (lambda: Motion.load(tmp_path / "other.json", motion.terrain), "format 'something'"),
        (lambda: Motion.load(folder / "run.json"), "need the argument terrain"),
        (lambda: Motion.load(folder / "run.csv"), "need .npz or .json"),
        (lambda: Motion.load(folder / "run.json", motion.terrain.heights), "terrain is an array; need a HeightMap"),
        (lambda: Motion.load(folder / "run.json", 3), "terrain is a int"),
        (lambda: Motion.load(folder / "run.json", tmp_path / "no.npz"), "no such file"),
        (lambda: Motion.load(folder / "run.json", HeightMap.flat((20, 20))), "outside the map, which spans x 0 to 0.5"),
    ):
        with pytest.raises(InputError) as error:
            act()
        assert words in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(("name", "package"), [("run.mcap", "foxglove"), ("new_bag", "rosbags.rosbag2")])
def test_a_missing_extra_is_named(motion, tmp_path, monkeypatch, name, package):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(InputError, match=r"pip install 'hdsp\[record\]'"):
        motion.save(tmp_path / name)
    assert list(tmp_path.iterdir()) == []
