"""Program for messages in a ROS bag: python bag_program.py OUT MEMORY SECONDS PATH TOPIC INDEX BYTES.

It runs in a separate process (`hdsp.base.separate_process`), because a bag's packed chunks may unpack to any size.
OUT is a uint8 array: a line in JSON, then raw GridMap messages.
"""

from __future__ import annotations

import json
import resource
import sys
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

GRID_MAP = "grid_map_msgs/msg/GridMap"
#: Topic in place of a name: the only one with grid maps; the last message of each.
ONLY, EACH = "", "*"
#: Topics that are described at most.
MOST = 20
#: Words of libraries that get no memory, or no room on the disk.
_NO_ROOM = ("memory", "resize buffer", "file too large")
_FILES = ("*.db3", "*.mcap")
#: Nanoseconds at the end of a bag in which its last message is looked for first.
_END = 5_000_000_000


def taken_out(path: Path, topic: str, index: int) -> bytes:
    """Returns a line in JSON with all topics and message sizes, then the messages.

    The line has ``topics``: name, type and message count for each connection; ``messages``: topic and size for each
    message. A missing message, an unknown topic and one among several are left out.

    Args:
        path: a bag.
        topic: a topic's name with or without the slash at its start; ``ONLY`` or ``EACH``.
        index: the message's place in its topic; negative from the end.
    """
    with _opened(path) as reader:
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
        maps = sorted(name for name, kind in kinds.items() if kind == GRID_MAP)
        if topic == EACH:
            wanted = [name for name in sorted(kinds)[:MOST] if name in maps]
        elif topic == ONLY:
            wanted = maps if len(maps) == 1 else []
        else:
            wanted = [name for name in maps if name.strip("/") == topic.strip("/")][-1:]
        topics = [[one.topic, one.msgtype, one.msgcount] for one in reader.connections]
        found = [(name, raw) for name in wanted if (raw := _message(reader, name, index)) is not None]
    line = json.dumps({"topics": topics, "messages": [[name, len(raw)] for name, raw in found]})
    return b"\n".join([line.encode(), b"".join(bytes(raw) for _, raw in found)])


def only_file(folder: Path) -> Path | None:
    """The ROS 2 bag file in a folder without metadata.yaml; None if there is none or more than one."""
    found = [path for pattern in _FILES for path in folder.glob(pattern)] if folder.is_dir() else []
    return found[0] if len(found) == 1 else None


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    if path.suffix.lower() == ".bag" and path.is_file():
        from rosbags.rosbag1 import Reader as Reader1

        with Reader1(path) as reader:
            yield reader
        return
    from rosbags.rosbag2 import Reader as Reader2

    # The link has a suffix that rosbags knows, and no character with a meaning in SQLite's addresses.
    with TemporaryDirectory() as folder:
        source = path.resolve()
        if path.is_dir() and not (path / "metadata.yaml").is_file():
            source = only_file(source) or source
        link = Path(folder) / f"bag{source.suffix.lower() if source.is_file() else ''}"
        link.symlink_to(source)
        try:
            with Reader2(link) as reader:
                yield reader
        except MemoryError:
            raise ValueError("it needs more memory than it may have") from None
        except Exception as error:  # the message names the link
            raise ValueError(str(error).replace(str(link), path.name)) from error


def _message(reader: Any, topic: str, index: int) -> bytes | None:
    connections = [connection for connection in reader.connections if connection.topic == topic]
    if index == -1:
        for start in (reader.end_time - _END, None):
            last = deque(reader.messages(connections, start=start), maxlen=1)
            if last:
                return last[0][2]
        return None
    messages = reader.messages(connections)
    if index >= 0:
        found = next(islice(messages, index, None), None)
        return None if found is None else found[2]
    ending = deque(messages, maxlen=-index)
    return ending[0][2] if len(ending) == -index else None


def _main() -> None:
    out, memory, seconds, size = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), int(sys.argv[7])
    limits = {
        resource.RLIMIT_AS: memory, resource.RLIMIT_CPU: seconds, resource.RLIMIT_FSIZE: size, resource.RLIMIT_CORE: 0,
    }  # fmt: skip
    for kind, value in limits.items():
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (value if hard == resource.RLIM_INFINITY else min(value, hard), hard))
    try:
        import numpy as np

        np.save(out, np.frombuffer(taken_out(Path(sys.argv[4]), sys.argv[5], int(sys.argv[6])), np.uint8))
    except Exception as error:
        words = " ".join(str(error).split()) or type(error).__name__
        if isinstance(error, MemoryError) or any(part in words.lower() for part in _NO_ROOM):
            words = f"it unpacks to more than {size:,} bytes, or claims to (max_cells)"
        raise SystemExit(words) from None


if __name__ == "__main__":
    _main()
