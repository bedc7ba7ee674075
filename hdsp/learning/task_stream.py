"""Labelled tasks as tensor batches from shards, a few in memory at a time, and batches that resume within an epoch."""

import os
from collections.abc import Iterator, Sequence
from itertools import accumulate
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, IterableDataset

from hdsp.base.errors import InputError
from hdsp.learning.learning_settings import BatchSettings
from hdsp.learning.processes import own_parts
from hdsp.learning.task_data import (
    Batch,
    BatchIndex,
    BatchSampler,
    PlanningBatch,
    Targets,
    TaskArrays,
    TaskDataset,
    as_is,
    generator_seed,
)
from hdsp.robot.lattice import N_ABSTRACT_ACTIONS

if TYPE_CHECKING:
    from hdsp.base.storage import Place

#: Groups of shards that each reading process reads ahead.
PREFETCH = 1


class TaskStream(IterableDataset):
    """Batches from labelled splits that need not fit into memory; reads a few shards at a time.

    An epoch holds each map once, as with `task_loader`. Shards come in a new order every epoch, in groups, and a
    group's maps are shuffled. All batches but the last are full; a batch may hold maps of two groups. Order and
    mirroring are a function of (seed, epoch) alone, whatever the number of readers and processes.

    Args:
        places: one or several folders or URLs with shards.
        settings: batches by map or by single tasks.
        shuffle, mirror, seed, targets: as for `task_loader`.
        shards_in_memory: shards in a group. A larger group mixes maps better.
        readers: processes that read groups ahead; 0 = this process reads them when they are needed. Memory holds about
            2 (readers + 1) groups; a group of 8 shards with 90 maps takes 15 MB.

    Attributes:
        epoch, skip: as in `BatchSampler`; shards with skipped batches alone are not read.
        rank, ranks: number of this process in a training of several ones, which take the batches in turn. All get
            equally many; up to ranks - 1 batches are left out.

    Raises:
        InputError: a place holds no shard, or a shard is damaged (raised when it is read).
    """

    def __init__(
        self,
        places: "Place | Sequence[Place]",
        settings: BatchSettings,
        shuffle: bool = False,
        mirror: bool = False,
        seed: int = 0,
        shards_in_memory: int = 8,
        targets: Targets = ("cost",),
        readers: int = 0,
    ):
        from hdsp.labels.shards import shard_sizes

        self.paths: list[Place] = []
        self.maps: list[int] = []
        for place in [places] if isinstance(places, str | os.PathLike) else places:
            found = shard_sizes(place)
            if not found:
                raise InputError(f"folder {place} holds no shard")
            self.paths += [path for path, _ in found]
            self.maps += [maps for _, maps in found]
        self.settings, self.shuffle, self.mirror = settings, shuffle, mirror
        self.seed, self.shards_in_memory = seed, shards_in_memory
        self.targets, self.readers = targets, readers
        self.epoch = self.skip = self.rank = 0
        self.ranks = 1

    def __repr__(self) -> str:
        return f"TaskStream({len(self.paths)} shards, batches of {self.settings.size} {self.settings.by}s)"

    def __len__(self) -> int:
        """Batches per epoch for one process."""
        batches = -(-sum(self.maps) * self._per_map // self.settings.size)
        return batches // self.ranks

    def set_epoch(self, epoch: int) -> None:
        """Sets the next iteration's epoch; Lightning calls it before each epoch."""
        self.epoch = epoch

    def __iter__(self) -> Iterator[Batch | PlanningBatch]:
        size, last = self.settings.size, len(self) * self.ranks
        number, self.skip = self.skip * self.ranks, 0
        if number >= last:  # fewer batches than processes
            return
        first = number * size
        groups = [group for group in self._groups() if group.end > first]
        pieces: list[Batch | PlanningBatch] = []
        wanted = size
        for group, dataset in zip(groups, self._read(groups), strict=True):
            order = group.order
            for at in _cuts(max(first, group.start), group.end, size):
                part = slice(at.start - group.start, at.stop - group.start)
                if number % self.ranks == self.rank:
                    pieces.append(dataset[self._index(order.items[part], order.mirrored[part])])
                wanted -= len(at)
                if not wanted:
                    yield from _joined(pieces)
                    pieces, wanted, number = [], size, number + 1
                if number == last:
                    return
        yield from _joined(pieces)

    def _index(self, items: Tensor, mirrored: Tensor) -> BatchIndex:
        flipped = mirrored if self.mirror else None
        if self.settings.by == "map":
            return BatchIndex(items, None, flipped)
        return BatchIndex(items // N_ABSTRACT_ACTIONS, items % N_ABSTRACT_ACTIONS, flipped)

    @property
    def _per_map(self) -> int:
        return 1 if self.settings.by == "map" else N_ABSTRACT_ACTIONS

    def _groups(self) -> "list[_Group]":
        """The epoch's groups that hold maps, in order."""
        generator = torch.Generator().manual_seed(generator_seed(self.seed, self.epoch))
        count = len(self.paths)
        order = torch.randperm(count, generator=generator) if self.shuffle else torch.arange(count)
        chosen = [part.tolist() for part in order.split(self.shards_in_memory)]
        sizes = [sum(self.maps[k] for k in shards) * self._per_map for shards in chosen]
        starts = accumulate(sizes, initial=0)
        seeds = (generator_seed(self.seed * 10_007 + number, self.epoch) for number in range(len(chosen)))
        return [
            _Group(tuple(shards), start, start + items, seed if self.shuffle or self.mirror else None, self.shuffle)
            for shards, start, items, seed in zip(chosen, starts, sizes, seeds, strict=False)
            if items
        ]

    def _read(self, groups: "Sequence[_Group]") -> Iterator[TaskDataset]:
        reader = _GroupReader([[self.paths[k] for k in group.shards] for group in groups], self.targets)
        if not self.readers or len(groups) < 2:
            found: Any = (reader[k] for k in range(len(groups)))
        else:
            found = DataLoader(
                reader,
                batch_size=None,
                num_workers=min(self.readers, len(groups)),
                prefetch_factor=PREFETCH,
                collate_fn=as_is,
            )
        for arrays in found:
            if isinstance(arrays, InputError):
                raise arrays
            yield TaskDataset(arrays, self.targets)


class _Order(NamedTuple):
    """Items of a group in their order, int64 [n], and whether each is mirrored, bool [n]."""

    items: Tensor
    mirrored: Tensor


class _Group(NamedTuple):
    """Shards that are in memory together: their numbers, and the range of their items in the epoch."""

    shards: tuple[int, ...]
    start: int
    end: int
    seed: int | None
    shuffle: bool

    @property
    def order(self) -> _Order:
        count = self.end - self.start
        if self.seed is None:
            return _Order(torch.arange(count), torch.zeros(count, dtype=torch.bool))
        generator = torch.Generator().manual_seed(self.seed)
        items = torch.randperm(count, generator=generator) if self.shuffle else torch.arange(count)
        return _Order(items, torch.rand(count, generator=generator) < 0.5)


class _GroupReader(Dataset):
    """Reads groups of shards; an `InputError` is returned, because processes cannot raise it in one line."""

    def __init__(self, groups: "list[list[Place]]", targets: Targets):
        self.groups, self.names = groups, {"heights", "goals", "feasible", *targets, "cost"}

    def __len__(self) -> int:
        return len(self.groups)

    def __getitem__(self, number: int) -> TaskArrays | InputError:
        import numpy as np

        from hdsp.labels.shards import read_arrays

        try:
            parts = [read_arrays(path, self.names) for path in self.groups[number]]
        except InputError as error:
            return error
        parts = [part for part in parts if len(part["heights"])]  # a shard without maps lacks optional arrays
        shared = [name for name in TaskArrays._fields if all(name in part for part in parts)]
        return TaskArrays(**{name: np.concatenate([part[name] for part in parts]) for name in shared})


def _cuts(start: int, end: int, size: int) -> Iterator[range]:
    """Cuts a range where batches begin, at multiples of ``size``."""
    while start < end:
        stop = min(end, (start // size + 1) * size)
        yield range(start, stop)
        start = stop


def _joined(pieces: list[Batch | PlanningBatch]) -> Iterator[Batch | PlanningBatch]:
    if len(pieces) == 1:
        yield pieces[0]
    elif pieces:
        yield type(pieces[0])(*(torch.cat(parts) for parts in zip(*pieces, strict=True)))


class ResumableBatches:
    """Training batches that continue within an epoch from a checkpoint.

    Lightning sets the epoch on `sampler`; `hdsp.learning.callbacks.EpochPosition` stores the position in checkpoints.

    Args:
        batches: `task_loader` result or a stream.
    """

    def __init__(self, batches: "DataLoader | TaskStream"):
        self.batches = batches
        sampler = batches if isinstance(batches, TaskStream) else batches.sampler
        assert isinstance(sampler, TaskStream | BatchSampler)  # `task_loader` makes no others
        self.sampler = sampler
        self.given = self.start = 0

    def __len__(self) -> int:
        return len(self.batches)

    def __iter__(self) -> Iterator[Batch | PlanningBatch]:
        self.given, self.start = self.start, 0
        self.sampler.skip = self.given
        for batch in own_parts(self.batches, full=True):
            self.given += 1
            yield batch

    def end_epoch(self) -> None:
        """Sets the position to the next epoch's first batch; an epoch may end before all batches are given."""
        self.given = 0

    def state_dict(self) -> dict[str, Any]:
        """Returns the number of batches given in this epoch."""
        return {"given": self.given}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.start = state["given"] % len(self)  # after the last one the next epoch begins
