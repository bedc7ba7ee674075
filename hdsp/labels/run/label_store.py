"""Shards of a label set as a label run sees them: the valid ones, the missing ones, and their index."""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from hdsp.base.errors import InputError
from hdsp.base.storage import Folder, Place, inside, open_folder
from hdsp.labels.counts import LabelCounts, add_up, counts_by_category
from hdsp.labels.shard_index import (
    SHARDS,
    SHARDS_PER_FOLDER,
    ShardPlan,
    index_names,
    index_place,
    parsed,
    part_file,
    part_folder,
    set_place,
    write_index,
)
from hdsp.labels.shards import Shard, shard_of

#: Counts by terrain category.
Counts = dict[str, LabelCounts]


class LabelStore:
    """The shards of a label set in a split's folder.

    A folder of shards enters the index when all its shards are there. A later run takes indexed shards as valid if they
    have not been written since, and reads all others. Shards of other label sets are never touched.

    Args:
        split: folder or URL of the split.
        labels_hash: hash of everything the labels depend on.
        inputs: the hashed values.
        plans: all shards of the set, in order (`hdsp.labels.shard_index.planned_shards`).

    Attributes:
        shards: folder of the shards.
        index: place of the index.
    """

    def __init__(self, split: Place, labels_hash: str, inputs: Any, plans: Sequence[ShardPlan]):
        self.labels_hash, self._inputs = labels_hash, inputs
        self._parts = [plans[first : first + SHARDS_PER_FOLDER] for first in range(0, len(plans), SHARDS_PER_FOLDER)]
        self._maps = sum(len(plan.maps) for plan in plans)
        self._part_of = {plan.name: number for number, part in enumerate(self._parts) for plan in part}
        self._set = open_folder(set_place(split, labels_hash))
        self.index = index_place(split, labels_hash, self._maps)
        self.shards: Folder = open_folder(inside(set_place(split, labels_hash), SHARDS))
        self._index = open_folder(self.index)
        self._open: dict[int, dict[str, Counts]] = {number: {} for number in range(len(self._parts))}
        self._closed: dict[int, Counts] = {}

    def __repr__(self) -> str:
        return f"LabelStore({self.index}, {len(self._parts)} folders)"

    def missing(self, say: Callable[[str], None], verify: bool = False) -> list[ShardPlan]:
        """Finds the valid shards and returns the others, in order.

        Args:
            say: receives a line for each shard that is there, but not valid.
            verify: whether to read all shards, also those in the index.
        """
        self.shards.prepare()
        stamps = self.shards.stamps()
        if not verify:
            self._take_indexed(stamps)
        missing = []
        for number in list(self._open):
            for plan in self._parts[number]:
                counts = self._counts_of(plan, say) if plan.name in stamps else None
                if counts is None:
                    missing.append(plan)
                else:
                    self._add(number, plan, counts)
        return missing

    def add(self, plan: ShardPlan, counts: Counts) -> None:
        """Adds a shard that has been written."""
        self._add(self._part_of[plan.name], plan, counts)

    def complete(self) -> list[Counts]:
        """Completes the index after all shards are there; returns the counts of each folder, in order."""
        write_index(self._index, self.labels_hash, self._inputs, self._maps, len(self._parts))
        return [self._closed[number] for number in range(len(self._parts))]

    def _take_indexed(self, stamps: Mapping[str, str]) -> None:
        """Closes the parts that this index or one of another length describes as they are."""
        own = self.index_name
        names = [own, *(name for name in index_names(self._set) if name != own)]
        for folder in (open_folder(f"{self._set.place}/{name}") for name in names):
            wanted = {part_file(number): number for number in self._open}
            found = [name for name in folder.names() if name in wanted]
            for name, content in zip(found, folder.read_many(found), strict=True):
                self._take(wanted[name], content, stamps, known=folder.place == self._index.place)
            if not self._open:
                return

    @property
    def index_name(self) -> str:
        """Name of the index in its label set."""
        return str(self.index).rpartition("/")[2]

    def _take(self, number: int, content: bytes, stamps: Mapping[str, str], known: bool) -> None:
        try:
            part = parsed(self._index, part_file(number), content)
            shards = {shard["name"]: shard["stamp"] for shard in part["shards"]}
            counts = {category: LabelCounts.from_json(values) for category, values in part["counts"].items()}
        except (InputError, KeyError, TypeError, ValueError, IndexError):
            return  # a damaged part is written again
        names = [plan.name for plan in self._parts[number]]
        if list(shards) == names and all(stamps.get(name) == stamp for name, stamp in shards.items()):
            del self._open[number]
            self._closed[number] = counts
            if not known:
                self._index.write(part_file(number), content)

    def _add(self, number: int, plan: ShardPlan, counts: Counts) -> None:
        self._open[number][plan.name] = counts
        if len(self._open[number]) == len(self._parts[number]):
            self._close(number, self._open.pop(number))

    def _close(self, number: int, counts: Mapping[str, Counts]) -> None:
        """Writes the part of the index for a folder whose shards are all there."""
        plans = self._parts[number]
        folder = part_folder(number)
        stamps = open_folder(f"{self.shards.place}/{folder}").stamps()
        shards = [
            {
                "name": plan.name,
                "kept": sum(found.maps for found in counts[plan.name].values()),
                "stamp": stamps.get(plan.name.removeprefix(f"{folder}/")),
            }
            for plan in plans
        ]
        categories = sorted({category for found in counts.values() for category in found})
        self._closed[number] = add_up((counts[plan.name] for plan in plans), categories)
        plain = {category: found.to_json() for category, found in self._closed[number].items()}
        self._index.write(part_file(number), json.dumps({"shards": shards, "counts": plain}).encode())

    def _counts_of(self, plan: ShardPlan, say: Callable[[str], None]) -> Counts | None:
        try:
            shard = shard_of(self.shards.read(plan.name), plan.name)
        except InputError as error:
            say(f"labels {plan.name} again: {error}")
            return None
        if self._belongs(shard, plan):
            return counts_by_category(shard.tasks)
        say(f"labels {plan.name} again: its labels were made with other settings, code or number of maps")
        return None

    def _belongs(self, shard: Shard, plan: ShardPlan) -> bool:
        expected = {"labels_hash": self.labels_hash, "maps": len(plan.maps)}
        return all(shard.attributes.get(key) == value for key, value in expected.items())
