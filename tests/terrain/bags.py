"""ROS bags with grid maps, written by rosbags' writers or, in the old layout of ROS 2, by SQLite."""

import math
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from unittest import mock

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hdsp.terrain.map_formats import grid_map_bags
from hdsp.terrain.map_formats.bag_program import GRID_MAP, taken_out

KINDS = ["bag", "db3", "mcap"]

_INFO = "float64 resolution\nfloat64 length_x\nfloat64 length_y\ngeometry_msgs/Pose pose\n"
_LAYERS = (
    "string[] layers\nstring[] basic_layers\nstd_msgs/Float32MultiArray[] data\n"
    "uint16 outer_start_index\nuint16 inner_start_index\n"
)
_HEADER = "std_msgs/Header header\n"


@contextmanager
def reading_here() -> Iterator[None]:
    """Reads bags in this process during a block: many files without the start of a process for each."""

    def here(program, content, memory, seconds, options):
        path, topic, index, _ = options
        return np.frombuffer(taken_out(Path(path), topic, int(index)), np.uint8)

    with mock.patch.object(grid_map_bags, "array_from_process", here):
        yield


@cache
def types(version):
    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    info, whole = (_HEADER, "") if version == 1 else ("", _HEADER)
    store.register(get_types_from_msg(info + _INFO, "grid_map_msgs/msg/GridMapInfo"))
    store.register(get_types_from_msg(f"{whole}grid_map_msgs/GridMapInfo info\n{_LAYERS}", GRID_MAP))
    return store


def message(version, layers, *, resolution=0.1, center=(0.0, 0.0, 0.0), yaw=0.0, start=(0, 0), frame="odom", **more):
    """A GridMap; ``layers`` are functions of world positions, or buffers [rows, columns].

    The cells follow the formula of grid_map: index (i, j) without its start index is at the middle of the map plus
    half its length minus (i + 0.5, j + 0.5) cells.
    """
    kinds = types(version).types
    shape = more.get("shape", (6, 4))
    buffers = {}
    for name, layer in layers.items():
        if callable(layer):
            buffer = np.empty(shape, np.float32)
            for row in range(shape[0]):
                for column in range(shape[1]):
                    i, j = (row - start[0]) % shape[0], (column - start[1]) % shape[1]
                    x, y = (
                        half * resolution / 2 - (k + 0.5) * resolution for half, k in zip(shape, (i, j), strict=True)
                    )
                    c, s = math.cos(yaw), math.sin(yaw)
                    buffer[row, column] = layer(center[0] + c * x - s * y, center[1] + s * x + c * y)
            layer = buffer
        buffers[name] = layer
    header = kinds["std_msgs/msg/Header"](
        **({"seq": 0} if version == 1 else {}), stamp=kinds["builtin_interfaces/msg/Time"](1, 2), frame_id=frame
    )
    turn = kinds["geometry_msgs/msg/Quaternion"]
    pose = kinds["geometry_msgs/msg/Pose"](
        kinds["geometry_msgs/msg/Point"](*(float(value) for value in center)),
        more.get("orientation") or turn(0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)),
    )
    lengths = [count * resolution for count in shape]
    info = kinds["grid_map_msgs/msg/GridMapInfo"](
        **({"header": header} if version == 1 else {}), resolution=resolution, length_x=lengths[0], length_y=lengths[1],
        pose=pose,
    )  # fmt: skip
    return kinds[GRID_MAP](
        **({} if version == 1 else {"header": header}), info=info, layers=list(buffers), basic_layers=[],
        data=[_matrix(kinds, buffer, more.get("row_major", False)) for buffer in buffers.values()],
        outer_start_index=start[0], inner_start_index=start[1],
    )  # fmt: skip


def _matrix(kinds, buffer, row_major):
    rows, columns = buffer.shape
    sides = [("row_index", rows), ("column_index", columns)]
    (first, outer), (second, inner) = sides if row_major else sides[::-1]
    side = kinds["std_msgs/msg/MultiArrayDimension"]
    layout = kinds["std_msgs/msg/MultiArrayLayout"]([side(first, outer, rows * columns), side(second, inner, inner)], 0)
    flat = buffer.ravel() if row_major else buffer.T.ravel()
    return kinds["std_msgs/msg/Float32MultiArray"](layout, np.ascontiguousarray(flat, np.float32))


def write_bag(path, kind, topics, compression=CompressionMode.NONE):
    """Writes a bag of a kind: ``topics`` has the messages (or raw strings) of each topic; returns what to read."""
    if kind == "bag":
        with Writer1(path.with_suffix(".bag")) as writer:
            fill(writer, topics, 1)
        return path.with_suffix(".bag")
    if kind == "old":
        return _old_bag(path.with_suffix(".db3"), topics)
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    writer = Writer2(path, version=9, storage_plugin=plugin)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        fill(writer, topics, 2)
    return path


def fill(writer, topics, version):
    store = types(version)
    for topic, messages in topics.items():
        kind = GRID_MAP if messages and not isinstance(messages[0], str) else "std_msgs/msg/String"
        connection = writer.add_connection(topic, kind, typestore=store)
        for k, item in enumerate(messages):
            item = store.types[kind](item) if isinstance(item, str) else item
            raw = store.serialize_ros1(item, kind) if version == 1 else store.serialize_cdr(item, kind)
            writer.write(connection, (k + 1) * 10**9, raw)


def _old_bag(path, topics):
    """The .db3 file of ROS 2 Foxy, without message definitions."""
    with sqlite3.connect(path) as base:
        base.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
        base.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
        for number, (topic, messages) in enumerate(topics.items()):
            base.execute("INSERT INTO topics VALUES(?, ?, ?, 'cdr')", (number, topic, GRID_MAP))
            for k, item in enumerate(messages):
                raw = bytes(types(2).serialize_cdr(item, GRID_MAP))
                base.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", (number, k + 1, raw))
    base.close()
    return path
