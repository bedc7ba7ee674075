"""Shards: HDF5 files with labelled tasks. A shard is whole or absent, and names everything its labels depend on.

The file is plain HDF5 (heights: chunk = one map, LZF). HDF5 leaves the first 512 bytes, the user block, to
applications. Here the user block contains a magic word, the schema version and the SHA-256 of the rest, so any damage
is found before HDF5 parses the file.
"""

import hashlib
import io
import os
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.files import existing_file
from hdsp.base.short_repr import short_repr
from hdsp.base.storage import Place, inside, is_folder, is_url, open_folder, split_place
from hdsp.labels.shard_index import ShardIndex, complete_indices, is_label_set, label_sets, read_index
from hdsp.labels.tasks import FIELDS, OPTIONAL_FIELDS, TaskSet

__all__ = [
    "SCHEMA_VERSION",
    "SUFFIX",
    "Shard",
    "TaskSet",
    "index_of",
    "is_shard",
    "read_arrays",
    "read_attributes",
    "read_shard",
    "read_shards",
    "read_tasks",
    "shard_bytes",
    "shard_names",
    "shard_of",
    "shard_paths",
    "shard_sizes",
    "write_shard",
]

#: Increases when the layout of the file changes.
SCHEMA_VERSION = 1
SUFFIX = ".h5"

_MAGIC = "hdsp task shard"
_USER_BLOCK = 512
_MAPS_PER_CHUNK = 256  # for all arrays except heights
_CATEGORY_NAMES = "category_names"
_OWN_ATTRIBUTES = ("schema_version", _CATEGORY_NAMES)

Attributes = Mapping[str, str | int | float]


class Shard(NamedTuple):
    """Tasks in a shard, and its attributes (`labels_hash` among them)."""

    tasks: TaskSet
    attributes: dict[str, str | int | float]

    def __repr__(self) -> str:
        return short_repr(self)


def write_shard(path: Place, tasks: TaskSet, attributes: Attributes) -> Place:
    """Writes a shard.

    Args:
        path: path or URL; an existing shard is replaced.
        tasks, attributes: see `shard_bytes`.

    Raises:
        InputError: as `shard_bytes`, or if the file cannot be written.
    """
    folder, name = split_place(path)
    folder.write(name, shard_bytes(tasks, attributes, str(path)))
    return path if is_url(path) else Path(path)


def shard_bytes(tasks: TaskSet, attributes: Attributes, where: str = "") -> bytes:
    """Makes the file contents of a shard.

    Args:
        tasks: the tasks; may be empty.
        attributes: texts and numbers by name. `labels_hash`, a hash of everything the labels depend on, is required.
        where: name of the shard in error messages.

    Raises:
        InputError: if `labels_hash` is missing, or an attribute has another type.
    """
    import h5py

    if "labels_hash" not in attributes:
        raise InputError(f"shard {where}: attribute labels_hash is missing")
    for name, value in attributes.items():
        if name in _OWN_ATTRIBUTES or not isinstance(value, str | int | float):
            raise InputError(f"shard {where}: attribute {name} = {value!r}; need a text or number, and a free name")
    names = sorted(set(tasks.category.tolist()))
    if len(names) > 256:
        raise InputError(f"shard {where}: {len(names)} categories; at most 256 fit")
    arrays = tasks.arrays()
    arrays["category"] = np.searchsorted(names, tasks.category).astype(np.uint8)
    # The buffer turns a full disk into an ordinary OSError; HDF5 itself reports a full disk in several ways.
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
    return _header(SCHEMA_VERSION, body) + body


def read_shard(path: Place) -> Shard:
    """Reads and verifies a shard.

    Args:
        path: path or URL.

    Raises:
        InputError: if the file is missing, no shard, cut off or damaged, or has another schema version; the message
            names the file.
    """
    if not is_url(path):
        existing_file(path, "shard")
    folder, name = split_place(path)
    return shard_of(folder.read(name), str(path))


def shard_of(content: bytes, where: str = "") -> Shard:
    """Reads the shard in a file's contents; ``where`` names it in error messages.

    Raises:
        InputError: if the contents are no shard, cut off or damaged, or have another schema version.
    """
    with _opened(content, where) as file:
        optional = [name for name in OPTIONAL_FIELDS if name in file]
        arrays = {name: file[name][()] for name in (*FIELDS, *optional, "category")}
        names = np.array([*file.attrs[_CATEGORY_NAMES], ""], dtype=np.str_)
        return Shard(TaskSet(**{**arrays, "category": names[arrays["category"]]}), _attributes(file))


def read_arrays(path: Place, names: Collection[str]) -> dict[str, np.ndarray]:
    """Reads some arrays of a shard by name, without the others; optional ones that it lacks are left out.

    Raises:
        InputError: as `read_shard`.
    """
    folder, name = split_place(path)
    with _opened(folder.read(name), str(path)) as file:
        return {name: file[name][()] for name in names if name in file or name not in OPTIONAL_FIELDS}


def read_attributes(path: Place) -> dict[str, str | int | float]:
    """Reads the attributes of a shard, without its arrays.

    Raises:
        InputError: as `read_shard`.
    """
    folder, name = split_place(path)
    with _opened(folder.read(name), str(path)) as file:
        return _attributes(file)


def is_shard(path: str | os.PathLike) -> bool:
    """Whether a local file begins like a shard; it may still be damaged."""
    with existing_file(path, "shard").open("rb") as file:
        return file.read(len(_MAGIC)) == _MAGIC.encode()


def read_tasks(path: Place) -> TaskSet:
    """Reads the tasks in a shard, or in all shards of a folder in name order; path or URL.

    Raises:
        InputError: if the file or folder does not exist, the folder contains no shard, or a shard is damaged.
    """
    if not is_folder(path):
        return read_shard(path).tasks
    return TaskSet.concatenate([shard.tasks for shard in read_shards(path)])


def read_shards(folder: Place) -> Iterator[Shard]:
    """Yields the shards of a folder in order; at most one is in memory. The folder is as for `shard_paths`.

    Raises:
        InputError: if the folder contains no shard, or a shard is damaged; as `shard_paths`.
    """
    paths = shard_paths(folder)
    if not paths:
        raise InputError(f"folder {folder} holds no shard (*{SUFFIX})")
    return map(read_shard, paths)


def shard_paths(folder: Place) -> list[Place]:
    """Shards of a folder in order: paths, or URLs if the folder is a URL.

    Args:
        folder: an index of labels (`hdsp.labels.shard_index`), whose shards alone are returned; a split's folder with
            one label set, whose longest complete index counts; a folder with shards and subfolders, in name order; or a
            shard.

    Raises:
        InputError: if the folder holds several label sets, or an index is damaged.
    """
    if not is_folder(folder):
        files, name = split_place(folder)
        return [folder] if name and files.has(name) else []
    if (index := index_of(folder)) is not None:
        return list(index.places)
    if label_sets(folder) or is_label_set(folder):
        return []  # label sets, all unfinished
    return [inside(folder, name) for name in shard_names(sorted(open_folder(folder).stamps()))]


def shard_sizes(folder: Place) -> list[tuple[Place, int]]:
    """Shards as in `shard_paths`, each with its number of maps; reads no shard if the folder has an index.

    Raises:
        InputError: as `shard_paths`, or if a shard without an index is damaged.
    """
    if (index := index_of(folder)) is not None:
        return list(zip(index.places, index.kept, strict=True))
    return [(path, len(read_shard(path).tasks)) for path in shard_paths(folder)]


def shard_names(names: list[str]) -> list[str]:
    """Names of shards; temporary files from a running or killed writer are excluded."""
    return [name for name in names if name.endswith(SUFFIX) and not name.rpartition("/")[2].startswith(".")]


def index_of(folder: Place) -> ShardIndex | None:
    """Returns the index in a folder, or the only complete one below it; None for a folder without an index.

    Raises:
        InputError: if there are several, or other shards beside it.
    """
    if (index := read_index(folder)) is not None:
        return index
    indices = complete_indices(folder)
    loose = shard_names(open_folder(folder).names())
    if len(indices) > 1 or (indices and loose):
        beside = f", and {len(loose)} shards beside them" if loose else ""
        raise InputError(f"folder {folder} holds several label sets{beside}; name one: {', '.join(map(str, indices))}")
    return read_index(indices[0]) if indices else None


@contextmanager
def _opened(content: bytes, where: str) -> Iterator[Any]:
    """The HDF5 file in a shard's verified contents."""
    import h5py

    _verify(content, where)
    try:
        with h5py.File(io.BytesIO(content)) as file:
            yield file
    except (OSError, KeyError, IndexError, ValueError, TypeError) as error:
        raise InputError(f"shard {where}: {' '.join(str(error).split())}") from error


def _attributes(file: Any) -> dict[str, str | int | float]:
    return {name: _plain(value) for name, value in file.attrs.items() if name not in _OWN_ATTRIBUTES}


def _header(version: int, body: bytes) -> bytes:
    text = f"{_MAGIC}\nschema {version}\nsha256 {hashlib.sha256(body).hexdigest()}\n"
    return text.encode("ascii").ljust(_USER_BLOCK, b"\0")


def _verify(content: bytes, where: str) -> None:
    if not content.startswith(_MAGIC.encode()):
        raise InputError(f"shard {where} is damaged or no shard: it does not begin with {_MAGIC!r}")
    header, body = content[:_USER_BLOCK], content[_USER_BLOCK:]
    if header == _header(SCHEMA_VERSION, body):
        return
    line = header.split(b"\n")[1].decode("ascii", "replace") if header.count(b"\n") > 1 else ""
    if line.startswith("schema ") and line[7:].isdigit() and header == _header(int(line[7:]), body):
        raise InputError(f"shard {where} has schema version {line[7:]}; need {SCHEMA_VERSION}: make it again")
    raise InputError(
        f"shard {where} is damaged: its contents do not fit their checksum (cut off, or changed); python -m "
        "pipeline.label SPLIT --verify makes a labelled split whole again"
    )


def _plain(value):
    return value.item() if isinstance(value, np.generic) else value
