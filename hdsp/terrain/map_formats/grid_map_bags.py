"""Messages of the type grid_map_msgs/GridMap in ROS bags by rosbags, without ROS.

ROS 1 (.bag) and ROS 2 (a folder with metadata.yaml, or its .db3 or .mcap file). The message definitions are here, as
many ROS 2 bags have none. A separate process takes the messages out (`bag_program`).

A layer is a matrix with a ring buffer: row and column 0 are at the start indices. Its rows run against x, its columns
against y, and the pose in the message is the middle of the map. Heights are positions in the frame of the message;
grid_map itself ignores the pose's z.
"""

from __future__ import annotations

import json
import math
import os
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.separate_process import array_from_process
from hdsp.terrain.map_formats.bag_program import EACH, GRID_MAP, MOST, ONLY, only_file
from hdsp.terrain.map_formats.fields import MAX_CELLS, MapFields, MissingOption, ReadOptions
from hdsp.terrain.map_frame import MapFrame

_DEFAULT_LAYER = "elevation"
_PROGRAM = Path(__file__).with_name("bag_program.py")
#: Bytes of a chunk, a message or a whole file, unpacked: for each cell that a map may have, and beside them.
_PER_CELL, _LEAST = 20, 1 << 26
#: Bytes of the separate process for Python, libraries and a bag's index.
_MEMORY = 1 << 29
#: CPU seconds of the separate process: for its start, and bytes of the bag in each further second.
_SECONDS, _BYTES_IN_A_SECOND = 20, 5_000_000

_INFO = """
float64 resolution
float64 length_x
float64 length_y
geometry_msgs/Pose pose
"""
_MAP = """
grid_map_msgs/GridMapInfo info
string[] layers
string[] basic_layers
std_msgs/Float32MultiArray[] data
uint16 outer_start_index
uint16 inner_start_index
"""
_HEADER = "std_msgs/Header header\n"


def is_bag_folder(path: Path) -> bool:
    """Whether a folder is a ROS 2 bag."""
    return os.path.isdir(path) and (os.path.isfile(path / "metadata.yaml") or only_file(path) is not None)


def read_grid_map(path: Path, options: ReadOptions) -> MapFields:
    """Reads one layer of one message."""
    index = -1 if options.message is None else options.message
    topics, messages = _taken_out(path, options.topic or ONLY, index, options.max_cells or MAX_CELLS)
    topic, count = _topic(topics, options.topic)
    if topic not in messages and index == -1:
        raise InputError(f"topic {topic} has no message")
    if topic not in messages:
        raise InputError(f"option message is {index}; need an index from {-count} to {count - 1}")
    place = "last message" if index == -1 else f"message {index}"
    return _fields(_decoded(messages[topic], path), options, f"topic {topic}, {place}")


def bag_contents(path: Path) -> str:
    """Topics of a bag; of each topic with grid maps the layers in its last message."""
    topics, messages = _taken_out(path, EACH, -1, MAX_CELLS)
    parts = []
    for name in sorted({topic.name for topic in topics})[:MOST]:
        own = [topic for topic in topics if topic.name == name]
        text = f"topic {name} ({own[0].kind}, {sum(topic.messages for topic in own)} messages)"
        if name in messages:
            text += f" with layers {', '.join(_decoded(messages[name], path).layers)}"
        parts.append(text)
    return "; ".join(parts) or "no topics"


class _Topic(NamedTuple):
    name: str
    kind: str
    messages: int


def _taken_out(path: Path, topic: str, index: int, cells: int) -> tuple[list[_Topic], dict[str, bytes]]:
    """All topics in a bag, and the raw message at an index in some topics (`bag_program.taken_out`)."""
    files = [path] if path.is_file() else [entry for entry in path.iterdir() if entry.is_file()]
    size = _PER_CELL * cells + _LEAST
    seconds = _SECONDS + sum(file.stat().st_size for file in files) // _BYTES_IN_A_SECOND
    options = (str(path.resolve()), topic, str(index), str(size))
    content = array_from_process(_PROGRAM, b"", _MEMORY + size, seconds, options).tobytes()
    line, _, rest = content.partition(b"\n")
    told, messages = json.loads(line), {}
    for name, length in told["messages"]:
        messages[name], rest = rest[:length], rest[length:]
    return [_Topic(*values) for values in told["topics"]], messages


def _topic(found: list[_Topic], wanted: str | None) -> tuple[str, int]:
    """The wanted topic's name, and its number of messages."""
    kinds = {topic.name: topic.kind for topic in found}
    topics = sorted(topic for topic, kind in kinds.items() if kind == GRID_MAP)
    if not topics:
        others = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(kinds.items())[:12]) or "none"
        raise InputError(f"no topic has messages of {GRID_MAP}; its topics: {others}")
    if wanted is None and len(topics) > 1:
        raise MissingOption(
            f"it has {len(topics)} topics with grid maps: {', '.join(topics)}; name one with the option topic"
        )
    names = {topic.strip("/"): topic for topic in topics}
    if wanted is not None and str(wanted).strip("/") not in names:
        raise InputError(f"option topic is {wanted!r}; need one of {', '.join(topics)}")
    topic = topics[0] if wanted is None else names[str(wanted).strip("/")]
    return topic, sum(one.messages for one in found if one.name == topic)


def _decoded(raw: bytes, path: Path) -> Any:
    # Definitions in a bag are text from strangers of which rosbags makes code, so the known definitions are used.
    if path.suffix.lower() == ".bag" and path.is_file():
        return _types(1).deserialize_ros1(raw, GRID_MAP)
    return _types(2).deserialize_cdr(raw, GRID_MAP)


@cache
def _types(version: int) -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    info, whole = (_HEADER + _INFO, _MAP) if version == 1 else (_INFO, _HEADER + _MAP)
    store.register({
        **get_types_from_msg(info, "grid_map_msgs/msg/GridMapInfo"),
        **get_types_from_msg(whole, GRID_MAP),
    })  # fmt: skip
    return store


def _fields(message: Any, options: ReadOptions, place: str) -> MapFields:
    header = message.header if hasattr(message, "header") else message.info.header
    info = message.info
    name = _layer(list(message.layers), options.layer)
    if len(message.data) != len(message.layers):
        raise InputError(f"the message has {len(message.layers)} layers, but {len(message.data)} matrices")
    resolution, lengths = float(info.resolution), (float(info.length_x), float(info.length_y))
    if not (math.isfinite(resolution) and resolution > 0 and all(math.isfinite(v) and v > 0 for v in lengths)):
        raise InputError(f"the message claims {lengths[0]} x {lengths[1]} m with cells of {resolution} m")
    matrix = _matrix(message.data[list(message.layers).index(name)], options)
    expected = tuple(round(min(length / resolution, 1e9)) for length in lengths)
    if matrix.shape != expected:
        raise InputError(f"layer {name} has {matrix.shape} cells, but the message claims {expected}")
    matrix = np.roll(matrix, (-int(message.outer_start_index), -int(message.inner_start_index)), axis=(0, 1))
    notes = [f"layer {name} of {place}"]
    center, yaw = _pose(info.pose, notes)
    half = np.array(matrix.shape) * resolution / 2
    frame = MapFrame(name=str(header.frame_id), notes=tuple(notes))
    if yaw == 0.0:
        corner = center - half
        return MapFields(matrix[::-1, ::-1], (float(corner[0]), float(corner[1])), resolution, frame)
    motion = np.eye(4)
    motion[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    motion[:2, 3] = center
    turned = MapFrame(frame.name, frame.crs, motion, (*notes, f"axes rotated by {math.degrees(yaw):.2f} degrees"))
    return MapFields(matrix[::-1, ::-1], (-float(half[0]), -float(half[1])), resolution, turned)


def _layer(layers: list[str], wanted: str | int | None) -> str:
    if wanted is not None and str(wanted) in layers:
        return str(wanted)
    if wanted is None and _DEFAULT_LAYER in layers:
        return _DEFAULT_LAYER
    if wanted is None and len(layers) == 1:
        return layers[0]
    listed = ", ".join(layers[:30]) or "none"
    if wanted is None:
        raise MissingOption(f"its layers are {listed}; name one with the option layer")
    raise InputError(f"option layer is {wanted!r}; need one of {listed}")


def _matrix(array: Any, options: ReadOptions) -> np.ndarray:
    """Matrix [rows, columns] of a layer."""
    dimensions = [(str(dimension.label), int(dimension.size)) for dimension in array.layout.dim]
    if len(dimensions) != 2:
        raise InputError(f"a layer has {len(dimensions)} axes; need column_index and row_index")
    (first, outer), (second, inner) = dimensions
    options.check_cells(outer, inner)
    values = np.asarray(array.data, np.float32)[int(array.layout.data_offset) :]
    if values.size != outer * inner:
        raise InputError(f"a layer has {values.size} values for {outer} x {inner} cells")
    matrix = values.reshape(outer, inner)
    if (first, second) == ("column_index", "row_index"):
        return matrix.T
    if (first, second) == ("row_index", "column_index"):
        return matrix
    raise InputError(f"a layer has the axes {first!r} and {second!r}; need column_index and row_index")


def _pose(pose: Any, notes: list[str]) -> tuple[np.ndarray, float]:
    """Middle (x, y) in m and yaw in rad; the pose's z is noted."""
    position, turn = pose.position, pose.orientation
    x, y, z, w = (float(value) for value in (turn.x, turn.y, turn.z, turn.w))
    center = np.array((position.x, position.y), float)
    norm = math.hypot(x, y, z, w)
    if not (np.isfinite(center).all() and math.isfinite(norm)):
        raise InputError("the pose of the map is not finite")
    if position.z:
        notes.append(f"z of the map's pose, {position.z:g} m, ignored as in grid_map")
    if norm < 1e-6:  # an orientation that was never set
        return center, 0.0
    if math.hypot(x, y) > 1e-3 * norm:
        raise InputError("the pose of the map is tilted; need a rotation about z only")
    yaw = 2 * math.atan2(z, w)
    yaw = math.remainder(yaw, 2 * math.pi)
    return center, 0.0 if abs(yaw) < 1e-6 else yaw
