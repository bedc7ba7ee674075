"""Label sets: labels of a split made with the same settings and code, side by side with those of others.

A split's folder, or URL, has a subfolder for each label set, named by the beginning of its hash::

    SPLIT/3fa9c2d41b7e/shards/00000/000000000-90.h5   maps 0 to 89
    SPLIT/3fa9c2d41b7e/1620-maps/index.json           the first 1620 maps, before some are dropped
    SPLIT/3fa9c2d41b7e/1620-maps/00000.json           shards of the first folder, and counts of their labels

Sets of different length share their shards. An index is complete once it has ``index.json``; readers take the shards
from it and list no folders.
"""

import hashlib
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from hdsp.base.errors import InputError
from hdsp.base.storage import Folder, Place, inside, is_url, open_folder

INDEX, SHARDS = "index.json", "shards"
#: Shards in a folder; also the largest number of shards that an interrupted run has to read when it continues.
SHARDS_PER_FOLDER = 256

_VERSION = 1
_SET_NAME = re.compile(r"[0-9a-f]{12}")
_INDEX_NAME = re.compile(r"(\d+)-maps")


class ShardPlan(NamedTuple):
    """A planned shard: its name in the folder of shards, and its map numbers."""

    name: str
    maps: range


@dataclass(frozen=True)
class ShardIndex:
    """Shards with the first maps of a split.

    Attributes:
        labels_hash: hash of everything the labels depend on.
        inputs: the hashed values.
        maps: number of maps before some are dropped.
        places: places of the shards, in order.
        kept: number of maps in each shard.
    """

    labels_hash: str
    inputs: Any
    maps: int
    places: tuple[Place, ...]
    kept: tuple[int, ...]

    @property
    def digest(self) -> str:
        """Hash of the maps and of everything their labels depend on; equal labels made twice have the same."""
        return hashlib.sha256(f"{self.labels_hash} {self.maps}".encode()).hexdigest()

    def __repr__(self) -> str:
        return f"ShardIndex({self.labels_hash[:12]}: {len(self.places)} shards, {sum(self.kept)} of {self.maps} maps)"


def set_place(split: Place, labels_hash: str) -> Place:
    """Returns the folder of a label set."""
    return inside(split, labels_hash[:12])


def index_place(split: Place, labels_hash: str, maps: int) -> Place:
    """Returns the folder with the index of a label set's first maps; readers of shards take it for their folder."""
    return inside(set_place(split, labels_hash), f"{maps}-maps")


def planned_shards(maps: int, maps_per_shard: int) -> list[ShardPlan]:
    """Returns the shards of a label set, in order."""
    firsts = range(0, maps, maps_per_shard)
    ranges = (range(first, min(first + maps_per_shard, maps)) for first in firsts)
    return [
        ShardPlan(f"{part_folder(k // SHARDS_PER_FOLDER)}/{of.start:09d}-{len(of)}.h5", of)
        for k, of in enumerate(ranges)
    ]


def part_folder(part: int) -> str:
    """Returns the name of folder number ``part`` with shards."""
    return f"{part:05d}"


def part_file(part: int) -> str:
    """Returns the name of the file in an index that describes one folder with shards."""
    return f"{part_folder(part)}.json"


def write_index(index: Folder, labels_hash: str, inputs: Any, maps: int, parts: int) -> None:
    """Completes an index, all of whose parts are written."""
    head = {"version": _VERSION, "labels_hash": labels_hash, "maps": maps, "parts": parts, "inputs": inputs}
    index.write(INDEX, json.dumps(head, indent=1).encode())


def read_index(place: Place) -> ShardIndex | None:
    """Reads an index; None if there is none, or none complete.

    Raises:
        InputError: the index is damaged, or of another version.
    """
    folder = open_folder(place)
    if not folder.has(INDEX):
        return None
    head = parsed(folder, INDEX, folder.read(INDEX))
    try:
        if head["version"] != _VERSION:
            raise InputError(f"{folder.place}/{INDEX}: version {head['version']}; need {_VERSION}")
        names = [part_file(part) for part in range(head["parts"])]
        parts = zip(names, folder.read_many(names), strict=True)
        shards = [shard for name, content in parts for shard in parsed(folder, name, content)["shards"]]
        pool = inside(str(place).rstrip("/").rpartition("/")[0] if is_url(place) else Path(place).parent, SHARDS)
        places = tuple(inside(pool, shard["name"]) for shard in shards)
        kept = tuple(int(shard["kept"]) for shard in shards)
        return ShardIndex(head["labels_hash"], head["inputs"], head["maps"], places, kept)
    except (KeyError, TypeError) as error:
        raise InputError(f"{folder.place}: damaged index of labels ({error}); label the split again") from error


def parsed(folder: Folder, name: str, content: bytes) -> dict[str, Any]:
    """Returns the contents of a file in an index.

    Raises:
        InputError: the file is damaged.
    """
    try:
        found = json.loads(content)
        if isinstance(found, dict):
            return found
    except ValueError:
        pass
    raise InputError(f"{folder.place}/{name}: damaged index of labels; label the split again")


def index_names(label_set: Folder) -> dict[str, int]:
    """Returns the indices in the folder of a label set: names, and map counts before some are dropped."""
    found = ((name, _INDEX_NAME.fullmatch(name)) for name in label_set.folders())
    return {name: int(match[1]) for name, match in found if match}


def label_sets(split: Place) -> list[Place]:
    """Returns the folders of all label sets of a split, in name order."""
    return [inside(split, name) for name in open_folder(split).folders() if _SET_NAME.fullmatch(name)]


def is_label_set(place: Place) -> bool:
    """Whether a folder is one label set, finished or not."""
    name = str(place).rstrip("/").rpartition("/")[2] if is_url(place) else Path(place).resolve().name
    return _SET_NAME.fullmatch(name) is not None or bool(index_names(open_folder(place)))


def complete_indices(place: Place) -> list[Place]:
    """Returns the longest complete index of each label set in the folder of a split, or of one label set."""
    folder = open_folder(place)
    sets = [place] if index_names(folder) else label_sets(place)
    return [index for each in sets if (index := _longest_index(each)) is not None]


def _longest_index(label_set: Place) -> Place | None:
    names = index_names(open_folder(label_set))
    indices = (inside(label_set, name) for name in sorted(names, key=names.__getitem__, reverse=True))
    return next((index for index in indices if open_folder(index).has(INDEX)), None)
