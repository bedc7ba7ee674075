"""Shards: labelled tasks in HDF5 files that are whole or absent, and that name what their labels depend on.

The file is plain HDF5 (heights: chunk = one map, LZF). Its user block, the first 512 bytes, which HDF5 leaves to
applications, holds a magic word, the schema version and the SHA-256 of the rest, so that any damage is found before
HDF5 parses the file.
"""

import hashlib
import io
import os
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hdsp.errors import InputError
from hdsp.files import existing_file, replacing
from hdsp.tasks import FIELDS, TaskSet

__all__ = ["SCHEMA_VERSION", "SUFFIX", "Shard", "TaskSet", "read_shard", "read_tasks", "write_shard"]

#: Raised when the layout of the file changes.
SCHEMA_VERSION = 1
SUFFIX = ".h5"

_MAGIC = "hdsp task shard"
_USER_BLOCK = 512
_MAPS_PER_CHUNK = 256  # of the arrays that are small for one map
_CATEGORY_NAMES = "category_names"
_OWN_ATTRIBUTES = ("schema_version", _CATEGORY_NAMES)

Attributes = Mapping[str, str | int | float]


class Shard(NamedTuple):
    """What a shard holds: its tasks, and the attributes it was written with (`labels_hash` among them)."""

    tasks: TaskSet
    attributes: dict[str, str | int | float]


def write_shard(path: str | os.PathLike, tasks: TaskSet, attributes: Attributes) -> Path:
    """Writes a shard; the same tasks and attributes give the same bytes.

    Args:
        path: the file; a shard that is there is replaced.
        tasks: what it holds; may be empty.
        attributes: texts and numbers by name; `labels_hash`, a hash of all that the labels depend on, has to be there.

    Raises:
        InputError: if `labels_hash` is missing, an attribute is of another type, or the file cannot be written.
    """
    import h5py

    if "labels_hash" not in attributes:
        raise InputError(f"shard {path}: attribute labels_hash is missing")
    for name, value in attributes.items():
        if name in _OWN_ATTRIBUTES or not isinstance(value, str | int | float):
            raise InputError(f"shard {path}: attribute {name} = {value!r}; need a text or number, and a free name")
    names = sorted(set(tasks.category.tolist()))
    if len(names) > 256:
        raise InputError(f"shard {path}: {len(names)} categories; at most 256 fit")
    arrays = {name: tasks.arrays()[name] for name in FIELDS}
    arrays["category"] = np.searchsorted(names, tasks.category).astype(np.uint8)
    # Through memory: a full disk is then an ordinary OSError, which HDF5 reports in ways of its own.
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", userblock_size=_USER_BLOCK, libver=("v110", "v110")) as file:
        for name, array in sorted(arrays.items()):
            maps = min(1 if name == "heights" else _MAPS_PER_CHUNK, len(array))
            layout = {"chunks": (maps, *array.shape[1:]), "compression": "lzf"} if maps else {}
            file.create_dataset(name, data=array, track_times=False, **layout)
        file.attrs["schema_version"] = SCHEMA_VERSION
        file.attrs[_CATEGORY_NAMES] = np.array(names, dtype=h5py.string_dtype())
        for name, value in attributes.items():
            file.attrs[name] = value
    body = buffer.getvalue()[_USER_BLOCK:]
    with replacing(path) as temporary:
        temporary.write_bytes(_header(SCHEMA_VERSION, body) + body)
    return Path(path)


def read_shard(path: str | os.PathLike) -> Shard:
    """Reads and verifies a shard.

    Raises:
        InputError: names the file and what is wrong: missing, no shard, other schema version, cut off, or damaged.
    """
    import h5py

    path = existing_file(path, "shard")
    _verify(path)
    try:
        with h5py.File(path) as file:
            arrays = {name: file[name][()] for name in (*FIELDS, "category")}
            names = np.array([*file.attrs[_CATEGORY_NAMES], ""], dtype=np.str_)
            attributes = {name: _plain(value) for name, value in file.attrs.items() if name not in _OWN_ATTRIBUTES}
        return Shard(TaskSet(**{**arrays, "category": names[arrays["category"]]}), attributes)
    except (OSError, KeyError, IndexError, ValueError, TypeError) as error:
        raise InputError(f"shard {path}: {' '.join(str(error).split())}") from error


def read_tasks(path: str | os.PathLike) -> TaskSet:
    """The tasks of a shard, or of all shards of a folder in the order of their names.

    Raises:
        InputError: if there is no such file or folder, the folder holds no shard, or a shard is damaged.
    """
    path = Path(path)
    if not path.is_dir():
        return read_shard(path).tasks
    shards = shard_paths(path)
    if not shards:
        raise InputError(f"folder {path} holds no shard (*{SUFFIX})")
    return TaskSet.concatenate([read_shard(shard).tasks for shard in shards])


def shard_paths(folder: str | os.PathLike) -> list[Path]:
    """The shards of a folder by name; temporary files of a writer at work, or of one that was killed, are none."""
    return sorted(path for path in Path(folder).glob(f"*{SUFFIX}") if not path.name.startswith("."))


def _header(version: int, body: bytes) -> bytes:
    text = f"{_MAGIC}\nschema {version}\nsha256 {hashlib.sha256(body).hexdigest()}\n"
    return text.encode("ascii").ljust(_USER_BLOCK, b"\0")


def _verify(path: Path) -> None:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"shard {path} cannot be read: {error.strerror}") from error
    if not content.startswith(_MAGIC.encode()):
        raise InputError(f"shard {path} is damaged or no shard: it does not begin with {_MAGIC!r}")
    header, body = content[:_USER_BLOCK], content[_USER_BLOCK:]
    if header == _header(SCHEMA_VERSION, body):
        return
    line = header.split(b"\n")[1].decode("ascii", "replace") if header.count(b"\n") > 1 else ""
    if line.startswith("schema ") and line[7:].isdigit() and header == _header(int(line[7:]), body):
        raise InputError(f"shard {path} has schema version {line[7:]}; need {SCHEMA_VERSION}: make it again")
    raise InputError(f"shard {path} is damaged: its contents do not fit their checksum (cut off, or changed)")


def _plain(value):
    return value.item() if isinstance(value, np.generic) else value
