"""The parts of the viewer that need no browser: meshes, colours, poses of a robot's parts, timelines, pages."""

import socket
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
import viser
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import ndimage
from websockets.exceptions import InvalidStatus
from websockets.sync import client

from hdsp import HeightMap, InputError, Robot
from hdsp.detailed.actions.action import Action, ActionKind
from hdsp.robot.robot import FEET
from hdsp.viz.failure_marks import Failure, Mark
from hdsp.viz.viewer import open_server, save_page
from hdsp.viz.viewer.ground_mesh import STEP, ground_mesh, rectangles, surface_of
from hdsp.viz.viewer.local_server import HOST, close_server, free_port
from hdsp.viz.viewer.plan_scene import PlanScene
from hdsp.viz.viewer.pose_handle import PoseHandle
from hdsp.viz.viewer.robot_pose import link_length, parts, standing, trunk, wheel_radius
from hdsp.viz.viewer.textures import height_colors, unknown_colors, value_colors
from hdsp.viz.viewer.timeline import timeline_of_states

MAPS = arrays(np.float32, st.tuples(st.integers(1, 7), st.integers(1, 7)), elements=st.sampled_from([0.0, 0.1, 0.3]))


def areas(mesh):
    """Area vectors of the faces, m^2, [n, 3]."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]].astype(float) for k in range(3))
    return np.cross(b - a, c - a) / 2


@given(MAPS)
@settings(max_examples=40)
def test_a_mesh_of_blocks_closes_exactly_their_volume(heights):
    terrain = HeightMap(heights, origin=(1.0, -2.0))
    mesh = ground_mesh(terrain)
    corners = mesh.vertices[mesh.faces].astype(float) - [1.0, -2.0, float(heights.min())]
    # All faces look outward, else the volumes below them do not add up.
    volume = np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume == pytest.approx((heights - heights.min()).astype(float).sum() * 0.025**2, abs=1e-7)
    up = areas(mesh)[:, 2]
    assert up[up > 1e-12].sum() == pytest.approx(heights.size * 0.025**2, rel=1e-4)
    assert not (up < -1e-9).any()


@given(arrays(float, st.tuples(st.integers(1, 6), st.integers(1, 6)), elements=st.sampled_from([0.0, 1.0, np.nan])))
def test_rectangles_cover_each_cell_once(heights):
    covered, found = np.zeros(heights.shape, int), np.full(heights.shape, np.nan)
    for first_x, first_y, end_x, end_y, height in rectangles(heights):
        covered[first_x:end_x, first_y:end_y] += 1
        found[first_x:end_x, first_y:end_y] = height
    assert np.array_equal(covered, np.isfinite(heights))
    assert np.array_equal(found, heights, equal_nan=True)


def test_edges_are_vertical_and_slopes_are_not():
    block = np.zeros((8, 8), np.float32)
    block[3:5, 3:6] = 0.2
    upright = abs(areas(ground_mesh(HeightMap(block)))[:, 2]) < 1e-12
    sides = np.linalg.norm(areas(ground_mesh(HeightMap(block)))[upright], axis=1).sum()
    assert sides == pytest.approx(2 * (2 + 3) * 0.025 * 0.2, rel=1e-5)
    assert len(ground_mesh(HeightMap(block)).faces) < 60  # level cells are merged

    slope = HeightMap(np.repeat(np.arange(9, dtype=np.float32)[:, None] * 0.4 * STEP, 5, axis=1))
    inner = ground_mesh(slope)
    x = inner.vertices[inner.faces].mean(axis=1)[:, 0]
    across = abs(areas(inner)[:, 0]) > 1e-6
    assert not (across & (abs(areas(inner)[:, 2]) < 1e-12) & (x > 0.001) & (x < 0.224)).any()
    assert np.ptp(inner.vertices[:, 2]) == pytest.approx(8 * 0.4 * STEP, abs=1e-6)


def test_unknown_cells_are_holes_in_the_ground_and_hatched():
    heights = np.zeros((12, 12), np.float32)
    heights[4:8, 4:8] = np.nan
    terrain = HeightMap(heights)
    known = areas(ground_mesh(terrain))[:, 2].sum()
    hatched = areas(ground_mesh(terrain, np.isnan(heights), walls=False))[:, 2].sum()
    assert (known, hatched) == pytest.approx((128 * 0.025**2, 16 * 0.025**2), rel=1e-5)
    assert np.array_equal(height_colors(terrain)[..., 3] == 0, np.isnan(heights))
    hatching = unknown_colors(terrain)
    assert np.array_equal(hatching[..., 3] > 0, np.isnan(heights))
    assert len(np.unique(hatching[4:8, 4:8, :3].reshape(-1, 3), axis=0)) == 2
    assert len(ground_mesh(HeightMap(np.full((3, 3), np.nan))).faces) == 0


def test_values_rise_from_dark_to_light_and_missing_ones_are_transparent():
    colors = value_colors(np.array([[0.0, 1.0], [2.0, np.nan]]), low=0.0, high=2.0)
    assert (np.diff(colors[..., :3].astype(int).sum(axis=-1).ravel()[:3]) > 0).all()
    assert (colors[..., 3] > 0).tolist() == [[True, True], [True, False]]


@pytest.mark.parametrize("name", Robot.presets())
def test_a_robot_stands_on_its_wheels(name):
    robot = Robot.load(name)
    state = [1.5, 1.5, 0.7, 0.05, 0.0, -0.05, 0.1]
    base, feet = standing(HeightMap.flat((120, 120)), robot, np.array(state))
    assert base[0] == pytest.approx([1.5, 1.5, robot.stance.base_height, 0, 0, 0.7])
    placed = parts(robot, base[0], feet[0])
    radius, length = wheel_radius(robot), link_length(robot)
    assert placed.wheels[:, 2] == pytest.approx(radius)
    cos, sin = np.cos(0.7), np.sin(0.7)
    hips = robot.hips() @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) + base[0, :3]
    for foot in range(4):
        middles = placed.links[foot, :, :3]
        # Both middles lie half a link from their ends, so the knee is where they meet.
        knee = 2 * middles[0] - hips[foot]
        assert np.linalg.norm(knee - hips[foot]) == pytest.approx(length, rel=1e-6)
        assert 2 * middles[1] - knee == pytest.approx(placed.wheels[foot, :3])
    assert min(box.center[2] - box.size[2] / 2 for box in trunk(robot)) + base[0, 2] == pytest.approx(
        max(box.above for box in robot.body.boxes)
    )


@pytest.mark.parametrize("level", [0.0, 500.0])
def test_robots_pins_and_paths_stay_at_the_ground_where_it_is_unknown(level):
    heights = np.full((80, 80), level, np.float32)
    heights[:30, :30] = np.nan
    terrain, robot, scene = HeightMap(heights), Robot.load("momaro"), RecordedScene()
    states = np.array([(0.3, 0.3, 0, 0, 0, 0, 0), (0.9, 0.5, 0, 0, 0, 0, 0), (-3.0, 0.5, 0, 0, 0, 0, 0)])
    base, feet = standing(terrain, robot, states)
    assert feet[..., 2] == pytest.approx(level) and base[:, 2] == pytest.approx(level + robot.stance.base_height)
    server = SimpleNamespace(scene=scene, initial_camera=SimpleNamespace(), atomic=nullcontext)
    page = PlanScene(server, terrain, robot)
    scene.nodes.clear()
    page.draw_path(states[:2], [Action(ActionKind.DRIVE)])
    marks = [Mark(place, "a cause", tuple(states[0])) for place in ((0.3, 0.3), (-3.0, 0.3))]
    page.draw_failure(Failure(marks, None, tuple(states[1])))
    places = [np.reshape(part, (-1, 3))[:, 2] for name, part in scene.numbers() if name.endswith("position")]
    ends = [part[..., 2].ravel() for _, part in scene.numbers() if np.ndim(part) == 3]
    near = np.concatenate([*ends, *(z for z in places if abs(z).max() > 2)]) - level
    assert len(ends) > 5 and (near > -0.1).all() and (near < 1.5).all()


def test_wheels_roll_as_far_as_the_robot_drives():
    robot = Robot.load("momaro")
    states = np.zeros((5, 7))
    states[:, 0], states[:, 1] = 0.6 + 0.25 * np.arange(5), 1.0
    line = timeline_of_states(HeightMap.flat((120, 80)), robot, states)
    assert line.rolled[-1] == pytest.approx(np.full(4, 1.0 / wheel_radius(robot)))
    base, feet, _ = line.at(line.duration / 2)
    assert base[0] == pytest.approx(1.1)
    assert (feet[:, 2] == 0).all()
    assert line.at(-1.0)[0] == pytest.approx(line.base[0])
    assert line.at(line.duration + 1)[0] == pytest.approx(line.base[-1])


def test_a_server_is_for_this_machine_alone_and_takes_the_next_free_port(capfd):
    with socket.socket() as busy:
        busy.bind((HOST, 0))
        busy.listen()
        taken = busy.getsockname()[1]
        server = open_server(taken)
        try:
            assert server.get_host() == HOST
            assert taken < server.get_port() <= taken + 20
            with socket.create_connection((HOST, server.get_port()), 1.0):
                pass
            # A server for all addresses would answer here, too.
            with pytest.raises(OSError):
                socket.create_connection(("127.0.0.2", server.get_port()), 1.0)
            assert server.request_share_url() is None
        finally:
            close_server(server)
    assert capfd.readouterr().out == ""
    for wrong in (-1, 70000):
        with pytest.raises(InputError, match="0 to 65535"):
            free_port(wrong)


def test_pages_of_other_places_reach_no_server():
    server = open_server(0)
    here = f"ws://{HOST}:{server.get_port()}"

    def connects(origin):
        try:
            client.connect(here, origin=origin, subprotocols=[f"viser-v{viser.__version__}"]).close()
        except InvalidStatus as refusal:
            assert refusal.response.status_code == 403
            return False
        return True

    try:
        for origin in (f"http://{HOST}:{server.get_port()}", "http://localhost:9000", None):
            assert connects(origin)
        for origin in ("http://example.com", f"http://localhost.example.com:{server.get_port()}", "null"):
            assert not connects(origin)
    finally:
        close_server(server)


def test_a_page_holds_everything_in_one_file(tmp_path):
    robot, states = Robot.load("momaro"), np.zeros((3, 7))
    states[:, 0], states[:, 1] = 0.6 + 0.1 * np.arange(3), 1.0
    heights = np.zeros((80, 80), np.float32)
    heights[:8] = np.nan
    page = save_page(tmp_path / "plan.html", HeightMap(heights), robot, states, (), ends=(states[0], states[-1]))
    text = page.read_text(encoding="utf-8")
    assert "window.__VISER_EMBED_DATA__=" in text
    assert not [line for line in text.splitlines() if 'src="http' in line or 'href="http' in line]
    assert 5e5 < page.stat().st_size < 3e6
    with pytest.raises(InputError, match=r"\.html"):
        save_page(tmp_path / "plan.png", HeightMap(heights), robot, states, ())


class Node(SimpleNamespace):
    """A node of a scene that remembers its arguments and its attributes."""

    def on_update(self, react):
        self.moved = react

    def remove(self):
        self.removed = True


class RecordedScene:
    def __init__(self):
        self.nodes = []

    def __getattr__(self, kind):
        def add(name, *values, **look):
            self.nodes.append(Node(name=name, values=values, **look))
            return self.nodes[-1]

        return add

    def numbers(self):
        """All numbers of all nodes by name, as viser sends them: points in single precision."""
        for node in self.nodes:
            for key, value in vars(node).items():
                for part in value if key == "values" else (value,):
                    if isinstance(part, bytes | np.ndarray | tuple | list) and len(part):
                        yield f"{node.name} {key}", part


def drawn(origin):
    """A scene with all that a page or a viewer draws, and the pose of a handle."""
    robot, scene, near = Robot.load("momaro"), RecordedScene(), np.array([*origin, 0, 0, 0, 0, 0.0])
    heights = np.random.default_rng(0).integers(0, 2, (80, 80)).astype(np.float32) / 50
    heights[:8] = np.nan
    server = SimpleNamespace(scene=scene, initial_camera=SimpleNamespace(), atomic=nullcontext)
    states = near + np.array([(0.6 + 0.1 * k, 1.0, 0.3, 0, 0.025 * k, 0, 0) for k in range(3)])
    actions = [Action(ActionKind.FOOT_MOVE, FEET[1], 0.025)] * 2
    page = PlanScene(server, HeightMap(heights, origin), robot)
    page.draw_path(states, actions)
    page.draw_layer("heights", np.full((80, 80, 4), 255, np.uint8))
    page.draw_lines("edges", states[None, :2, :3], np.zeros((1, 3), np.uint8))
    page.draw_failure(Failure((Mark(tuple(states[0, :2]), "a cause", tuple(states[1])),), None, tuple(states[2])))
    page.add_ghost("/start", states[0], "#000000", 0.4)
    line = timeline_of_states(page.terrain, robot, states)
    page.place_robot(*line.at(0.5 * line.duration))
    released = []
    handle = PoseHandle(scene, "/goal", "goal", "#000000", released.append)
    handle.place(page.terrain, robot, states[0])
    handle.control.moved(SimpleNamespace(phase="end"))
    return list(scene.numbers()), vars(server.initial_camera), np.array([handle.pose(), *released]) - near[:3]


def test_unknown_ground_is_filled_once_for_all_that_is_drawn(monkeypatch):
    filled, fill = [], ndimage.distance_transform_edt
    monkeypatch.setattr(
        ndimage, "distance_transform_edt", lambda *args, **more: filled.append(1) or fill(*args, **more)
    )
    drawn((412345.678, 5654321.123))
    assert len(filled) == 1


@given(MAPS, st.data())
@settings(max_examples=30)
def test_meshes_of_a_filled_map_are_those_of_the_map(heights, data):
    heights[data.draw(arrays(bool, heights.shape))] = np.nan
    terrain, known = HeightMap(heights), np.isfinite(heights)
    surface = surface_of(terrain)
    assert np.isfinite(surface.heights).all() and np.array_equal(surface.heights[known], heights[known])
    for one, other in (
        (ground_mesh(terrain), ground_mesh(surface, known)),
        (ground_mesh(terrain, ~known, walls=False), ground_mesh(surface, ~known, walls=False)),
        (ground_mesh(terrain, known | ~known), ground_mesh(surface)),
    ):
        assert all(map(np.array_equal, one, other))


def test_a_scene_on_a_projected_map_is_the_one_near_zero():
    far = (412345.678, 5654321.123)
    (near_nodes, near_camera, near_pose), (far_nodes, far_camera, far_pose) = drawn((0.0, 0.0)), drawn(far)
    assert [name for name, _ in near_nodes] == [name for name, _ in far_nodes] and len(near_nodes) > 100
    for (name, one), (_, other) in zip(near_nodes, far_nodes, strict=True):
        if isinstance(one, bytes):
            assert one == other, name
        else:
            np.testing.assert_allclose(np.float32(other), np.float32(one), atol=1e-6, err_msg=name)
    for key, value in near_camera.items():
        np.testing.assert_allclose(far_camera[key], value, atol=1e-6)
    np.testing.assert_allclose(near_pose, [(0.6, 1.0, 0.3)] * 2, atol=1e-9)
    np.testing.assert_allclose(far_pose, near_pose, atol=1e-8)
