"""Labelled tasks as tensor batches from shards, a few in memory at a time, and batches that resume within an epoch."""

import os
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import torch
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from hdsp.base.errors import InputError
from hdsp.learning.learning_settings import BatchSettings
from hdsp.learning.task_data import Batch, BatchSampler, PlanningBatch, Targets, TaskDataset
from hdsp.robot.lattice import N_ABSTRACT_ACTIONS

if TYPE_CHECKING:
    from hdsp.base.storage import Place


class TaskStream(IterableDataset):
    """Batches from labelled splits that need not fit into memory; reads a few shards at a time.

    An epoch holds each map once, as with `task_loader`. Shards come in a new order every epoch, and maps are shuffled
    among the shards in memory. Remaining maps fill the first batch from the next shards, so all batches but the last
    are full. The order is a function of (seed, epoch) alone.

    Args:
        places: one or several folders or URLs with shards.
        settings: batches by map or by single tasks.
        shuffle, mirror, seed, targets: as for `task_loader`.
        shards_in_memory: number of shards read at a time.

    Attributes:
        epoch, skip: as in `BatchSampler`; skipped batches are still read.

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
    ):
        from hdsp.labels.shards import shard_paths

        self.paths = []
        for place in [places] if isinstance(places, str | os.PathLike) else places:
            found = shard_paths(place)
            if not found:
                raise InputError(f"folder {place} holds no shard")
            self.paths += found
        self.settings, self.shuffle, self.mirror = settings, shuffle, mirror
        self.seed, self.shards_in_memory = seed, shards_in_memory
        self.targets = targets
        self.epoch = self.skip = 0

    def __repr__(self) -> str:
        return f"TaskStream({len(self.paths)} shards, batches of {self.settings.size} {self.settings.by}s)"

    @cached_property
    def maps(self) -> list[int]:
        """Maps in each shard; the first access reads all shards."""
        from hdsp.labels.shards import read_shard

        return [len(read_shard(path).tasks) for path in self.paths]

    def __len__(self) -> int:
        """Batches per epoch, for a single reading process."""
        items = sum(self.maps) * (1 if self.settings.by == "map" else N_ABSTRACT_ACTIONS)
        return -(-items // self.settings.size)

    def set_epoch(self, epoch: int) -> None:
        """Sets the next iteration's epoch; Lightning calls it before each epoch."""
        self.epoch = epoch

    def __iter__(self) -> Iterator[Batch | PlanningBatch]:
        skip, self.skip = self.skip, 0
        rest: Batch | PlanningBatch | None = None
        for dataset, sampler in self._parts():
            sampler.first = self.settings.size - len(rest.heights) if rest is not None else 0
            for index in sampler:
                batch = dataset[index]
                if rest is not None:
                    batch, rest = type(batch)(*(torch.cat(pair) for pair in zip(rest, batch, strict=True))), None
                if len(batch.heights) < self.settings.size:
                    rest = batch
                elif skip:
                    skip -= 1
                else:
                    yield batch
        if rest is not None and not skip:
            yield rest

    def _parts(self) -> Iterator[tuple[TaskDataset, BatchSampler]]:
        """Yields the maps that are in memory together, with their sampler."""
        from hdsp.labels.shards import read_shard
        from hdsp.labels.tasks import TaskSet

        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + self.epoch)
        count = len(self.paths)
        order = torch.randperm(count, generator=generator) if self.shuffle else torch.arange(count)
        groups = list(enumerate(order.split(self.shards_in_memory)))
        if (worker := get_worker_info()) is not None:
            groups = groups[worker.id :: worker.num_workers]  # each process of a loader reads shards of its own
        for number, chosen in groups:
            tasks = TaskSet.concatenate([read_shard(self.paths[k]).tasks for k in chosen.tolist()])
            if not len(tasks):
                continue
            seed = self.seed * 10_007 + number
            sampler = BatchSampler(len(tasks), N_ABSTRACT_ACTIONS, self.settings, self.shuffle, self.mirror, seed)
            sampler.set_epoch(self.epoch)
            yield TaskDataset(tasks, self.targets), sampler


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
        for batch in self.batches:
            self.given += 1
            yield batch

    def state_dict(self) -> dict[str, Any]:
        """Returns the number of batches given in this epoch."""
        return {"given": self.given}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.start = state["given"] % len(self)  # after the last one the next epoch begins
