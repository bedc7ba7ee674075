"""All label sets in the folder of a split: a list for people, and their removal."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hdsp.base.errors import InputError
from hdsp.base.storage import Folder, Place, open_folder
from hdsp.labels.shard_index import INDEX, index_names, label_sets, parsed
from hdsp.labels.shards import SUFFIX, shard_names


@dataclass(frozen=True)
class StoredSet:
    """A label set in a split's folder.

    Attributes:
        place: its folder.
        maps: map counts of its complete indices, before some are dropped.
        shards: number of its shards.
        size: bytes of all files.
        leftovers: names of files that killed runs have left unfinished.
        inputs: everything its labels depend on; None if no index is complete, or the index is damaged.
    """

    place: Place
    maps: tuple[int, ...]
    shards: int
    size: int
    leftovers: tuple[str, ...]
    inputs: Any

    def differs_in(self, inputs: Mapping[str, Any]) -> list[str]:
        """Returns the names of values, with dots, that differ from other inputs."""
        if self.inputs is None:
            return []
        mine, others = _flat(self.inputs), _flat(inputs)
        return sorted(name for name in {*mine, *others} if mine.get(name) != others.get(name))

    def remove(self) -> None:
        """Removes the set with all its shards."""
        open_folder(self.place).remove_all()

    def remove_leftovers(self) -> None:
        """Removes unfinished files; a run that still writes to the set would fail."""
        for name in self.leftovers:
            open_folder(self.place).remove(name)


def stored_sets(split: Place) -> list[StoredSet]:
    """Returns the label sets in a split's folder, in name order."""
    return [_described(place) for place in label_sets(split)]


def _described(place: Place) -> StoredSet:
    folder = open_folder(place)
    files = folder.stamps()
    complete = {name: maps for name, maps in index_names(folder).items() if f"{name}/{INDEX}" in files}
    inputs = _inputs(folder, f"{min(complete)}/{INDEX}") if complete else None
    leftovers = tuple(name for name in files if name.endswith(f".tmp{SUFFIX}"))
    size = sum(int(stamp.split()[0]) for stamp in files.values())
    return StoredSet(place, tuple(sorted(complete.values())), len(shard_names(list(files))), size, leftovers, inputs)


def _inputs(folder: Folder, index: str) -> dict[str, Any] | None:
    """Inputs in an index; None if it is damaged, which must not keep the set from being listed and removed."""
    try:
        found = parsed(folder, index, folder.read(index)).get("inputs")
    except InputError:
        return None
    return found if isinstance(found, dict) else None


def _flat(values: Any, before: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in values.items():
        found |= _flat(value, f"{before}{name}.") if isinstance(value, dict) else {f"{before}{name}": value}
    return found
