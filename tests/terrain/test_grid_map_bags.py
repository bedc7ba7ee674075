import math
import shutil

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionMode

from hdsp.base.errors import InputError
from hdsp.terrain.height_map import HeightMap
from tests.terrain.bags import KINDS, message, reading_here, types, write_bag


@pytest.fixture(autouse=True)
def here():
    """Reads in this process; a process of their own reads bags in tests/terrain/test_hostile_bags.py."""
    with reading_here():
        yield


def slanted(x, y):
    """Heights that differ in all cells, and with every flip, turn or shift."""
    return 0.5 * x - 0.125 * y + 0.01 * x * x


def cells(terrain):
    """Positions of cell centres in the source frame, and heights."""
    ix, iy = np.indices(terrain.shape)
    local = [low + (index + 0.5) * terrain.resolution for low, index in zip(terrain.origin, (ix, iy), strict=True)]
    points = terrain.frame.points_to_source(np.stack([*local, np.zeros_like(local[0])], axis=-1))
    return points[..., 0], points[..., 1], terrain.heights


def version_of(kind):
    return 1 if kind == "bag" else 2


@pytest.mark.parametrize("kind", [*KINDS, "old"])
@pytest.mark.parametrize(
    "placed", [{}, {"start": (2, 3)}, {"start": (5, 1), "row_major": True, "yaw": 0.4}, {"yaw": math.pi / 2}]
)
def test_m7_each_cell_of_a_grid_map_is_at_its_position(tmp_path, kind, placed):
    layers = {"variance": lambda x, y: 1.0, "elevation": slanted}
    item = message(version_of(kind), layers, center=(3.0, -2.0, 0.0), **placed)
    terrain = HeightMap.load(write_bag(tmp_path / "run", kind, {"/map": [item]}))
    x, y, heights = cells(terrain)
    np.testing.assert_allclose(heights, slanted(x, y), atol=1e-5)
    assert terrain.shape == (6, 4) and terrain.resolution == 0.1 and terrain.frame.name == "odom"
    assert terrain.frame.is_source == ("yaw" not in placed)
    assert terrain.frame.notes[0] == "layer elevation of topic /map, last message"


@pytest.mark.parametrize("kind", KINDS)
def test_m7_topic_layer_and_message_are_chosen(tmp_path, kind):
    version = version_of(kind)
    messages = [
        message(version, {"elevation": lambda x, y, k=k: k, "up": lambda x, y, k=k: -k}) for k in (1.0, 2.0, 3.0)
    ]
    path = write_bag(tmp_path / "run", kind, {"/talk": ["hello"], "/one": messages, "/two": messages[:1]})
    for options, height in (
        ({"topic": "/one"}, 3),
        ({"topic": "one", "message": 0}, 1),
        ({"topic": "/one", "message": -2}, 2),
        ({"topic": "/two", "layer": "up"}, -1),
    ):
        assert (HeightMap.load(path, **options).heights == height).all()
    for options, words in (
        ({}, "it has 2 topics with grid maps: /one, /two; name one with the option topic"),
        ({"topic": "/talk"}, "need one of /one, /two"),
        ({"topic": "/one", "message": 3}, "option message is 3; need an index from -3 to 2"),
        ({"topic": "/one", "layer": "x"}, "option layer is 'x'; need one of elevation, up"),
        ({"topic": "/one", "resolution": 0.1}, "option resolution does not apply to ROS bag"),
    ):
        with pytest.raises(InputError, match=words):
            HeightMap.load(path, **options)


def test_m7_bags_of_other_messages_or_without_elevation_tell_what_they_hold(tmp_path):
    path = write_bag(tmp_path / "talk", "mcap", {"/talk": ["hello"]})
    with pytest.raises(InputError, match=r"its topics: /talk \(std_msgs/msg/String\)"):
        HeightMap.load(path)
    item = message(2, {"up": slanted, "down": slanted})
    with pytest.raises(InputError, match="its layers are up, down; name one with the option layer"):
        HeightMap.load(write_bag(tmp_path / "layers", "db3", {"/map": [item]}))
    only = message(2, {"up": slanted})
    assert HeightMap.load(write_bag(tmp_path / "only", "db3", {"/map": [only]})).shape == (6, 4)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="empty"):
        HeightMap.load(tmp_path / "empty")


@pytest.mark.parametrize("kind", ["db3", "mcap"])
def test_m7_m19_the_file_of_a_ros_2_bag_is_enough_in_any_folder_and_spelling(tmp_path, kind):
    folder = write_bag(tmp_path / "run", kind, {"/map": [message(2, {"elevation": slanted})]})
    expected = HeightMap.load(folder).heights
    odd = tmp_path / "100% real? #1"
    odd.mkdir()
    shutil.copy(next(folder.glob(f"*.{kind}")), odd / f"MAP.{kind.upper()}")
    np.testing.assert_array_equal(HeightMap.load(odd / f"MAP.{kind.upper()}").heights, expected)
    (folder / "metadata.yaml").unlink()
    np.testing.assert_array_equal(HeightMap.load(folder).heights, expected)


@pytest.mark.parametrize("kind", ["db3", "mcap"])
@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_m7_packed_bags_are_read(tmp_path, kind, mode):
    item = message(2, {"elevation": slanted})
    path = write_bag(tmp_path / "run", kind, {"/map": [item]}, compression=mode)
    x, y, heights = cells(HeightMap.load(path))
    np.testing.assert_allclose(heights, slanted(x, y), atol=1e-5)


def test_m7_unknown_cells_and_poses_that_were_never_set(tmp_path):
    buffer = np.arange(24, dtype=np.float32).reshape(6, 4)
    buffer[0, 0], buffer[1, 1] = math.nan, -math.inf
    unset = types(1).types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 0.0)
    item = message(1, {"elevation": buffer}, orientation=unset, center=(0.0, 0.0, 1.5))
    terrain = HeightMap.load(write_bag(tmp_path / "run", "bag", {"/map": [item]}))
    assert (
        np.isnan(terrain.heights[5, 3]) and np.isnan(terrain.heights[4, 2]) and np.isfinite(terrain.heights).sum() == 22
    )
    assert terrain.heights[5, 2] == 1 and terrain.heights[4, 3] == 4
    assert "no-data value -inf of 1 cell" in " ".join(terrain.frame.notes)
    assert "z of the map's pose, 1.5 m, ignored as in grid_map" in terrain.frame.notes
    tilted = types(1).types["geometry_msgs/msg/Quaternion"](0.3, 0.0, 0.0, 0.95)
    item = message(1, {"elevation": buffer}, orientation=tilted)
    with pytest.raises(InputError, match="tilted"):
        HeightMap.load(write_bag(tmp_path / "tilted", "bag", {"/map": [item]}))


@pytest.mark.parametrize("damage", ["size", "labels", "layers", "length", "index"])
def test_messages_that_contradict_themselves_are_refused(tmp_path, damage):
    item = message(2, {"elevation": slanted})
    if damage == "size":
        item.data[0].layout.dim[0].size = 2**31
    elif damage == "labels":
        item.data[0].layout.dim[0].label = "x"
    elif damage == "layers":
        item.layers.append("more")
    elif damage == "length":
        item.info.length_x = 1e300
    else:
        item.info.resolution = math.nan
    with pytest.raises(InputError, match="run"):
        HeightMap.load(write_bag(tmp_path / "run", "mcap", {"/map": [item]}))
