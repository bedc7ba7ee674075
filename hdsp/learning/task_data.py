"""Labelled tasks as tensor batches, from memory by index (`task_loader`) or shard by shard (`TaskStream`)."""

import os
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, IterableDataset, Sampler, get_worker_info

from hdsp.base.errors import InputError
from hdsp.learning.learning_settings import BatchSettings
from hdsp.robot.lattice import N_ABSTRACT_ACTIONS

if TYPE_CHECKING:
    from hdsp.base.storage import Place
    from hdsp.labels.tasks import TaskSet


class Batch(NamedTuple):
    """Tasks for one step.

    Attributes:
        heights: [B, 1, 72, 72].
        goals: [B, G, 3].
        feasible: bool [B, G].
        cost: [B, G], 0 if infeasible.
    """

    heights: Tensor
    goals: Tensor
    feasible: Tensor
    cost: Tensor


class BatchIndex(NamedTuple):
    """Batch contents.

    Attributes:
        maps: int64 [B].
        tasks: int64 [B] for single tasks, otherwise None.
        mirrored: bool [B] or None.
    """

    maps: Tensor
    tasks: Tensor | None
    mirrored: Tensor | None


class TaskDataset(Dataset):
    """Tensors that share memory with a ``TaskSet``; indexed by ``BatchIndex``."""

    def __init__(self, tasks: "TaskSet"):
        if len(tasks.heights) == 0:
            raise InputError("task set: it holds no maps")
        self.heights = _shared(tasks.heights, np.float32)
        self.goals = _shared(tasks.goals, np.float32)
        self.feasible = _shared(tasks.feasible, np.bool_)
        self.cost = _shared(tasks.cost, np.float32)

    def __len__(self) -> int:
        return len(self.heights)

    def __getitem__(self, index: BatchIndex) -> Batch:
        maps, tasks, mirrored = index
        heights = self.heights[maps][:, None]
        if tasks is None:
            goals, feasible, cost = self.goals[maps], self.feasible[maps], self.cost[maps]
        else:
            goals, feasible, cost = (part[maps, tasks][:, None] for part in (self.goals, self.feasible, self.cost))
        if mirrored is not None:
            heights = torch.where(mirrored[:, None, None, None], mirror_heights(heights), heights)
            goals = torch.where(mirrored[:, None, None], mirror_goals(goals), goals)
        return Batch(heights, goals, feasible, cost)


class BatchSampler(Sampler[BatchIndex]):
    """An epoch's batches, shuffled and mirrored as a function of (seed, epoch) alone.

    A resumed training sees the same batches as an uninterrupted one.

    Attributes:
        epoch: epoch of the next iteration.
        skip: number of batches before an interruption, which only the next iteration leaves out.
        first: size of the first batch if it differs; 0 = it does not.
    """

    def __init__(
        self, maps: int, goals: int, settings: BatchSettings, shuffle: bool, mirror: bool = False, seed: int = 0
    ):
        self.maps, self.goals, self.settings = maps, goals, settings
        self.shuffle, self.mirror, self.seed, self.epoch = shuffle, mirror, seed, 0
        self.skip = self.first = 0

    def set_epoch(self, epoch: int) -> None:
        """Sets the next iteration's epoch; Lightning calls it before each epoch."""
        self.epoch = epoch

    def __len__(self) -> int:
        items = self.maps if self.settings.by == "map" else self.maps * self.goals
        return -(-items // self.settings.size)

    def __iter__(self) -> Iterator[BatchIndex]:
        single = self.settings.by == "task"
        items = self.maps * self.goals if single else self.maps
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + self.epoch)
        order = torch.randperm(items, generator=generator) if self.shuffle else torch.arange(items)
        skip, self.skip = self.skip, 0
        parts = [order[: self.first]] * bool(self.first) + list(order[self.first :].split(self.settings.size))
        for number, chosen in enumerate(part for part in parts if len(part)):
            mirrored = torch.rand(len(chosen), generator=generator) < 0.5 if self.mirror else None
            if number < skip:
                continue
            if single:
                yield BatchIndex(chosen // self.goals, chosen % self.goals, mirrored)
            else:
                yield BatchIndex(chosen, None, mirrored)


def task_loader(
    tasks: "TaskSet", settings: BatchSettings, shuffle: bool = False, mirror: bool = False, seed: int = 0
) -> DataLoader:
    """Batches from a task set.

    Args:
        tasks: labelled maps.
        settings: batches by map or by single tasks.
        shuffle: new order every epoch.
        mirror: mirror each item on its x axis with probability one half; the robot and its costs are symmetric.
        seed: seed for order and mirroring.

    Raises:
        InputError: the task set is empty.
    """
    dataset = TaskDataset(tasks)
    sampler = BatchSampler(len(dataset), dataset.goals.shape[1], settings, shuffle, mirror, seed)
    return DataLoader(dataset, batch_size=None, sampler=sampler, collate_fn=_as_is)


class TaskStream(IterableDataset):
    """Batches from labelled splits that need not fit into memory; reads a few shards at a time.

    An epoch holds each map once, as with `task_loader`. Shards come in a new order every epoch, and maps are shuffled
    among the shards in memory. Remaining maps fill the first batch from the next shards, so all batches but the last
    are full. The order is a function of (seed, epoch) alone.

    Args:
        places: one or several folders or URLs with shards.
        settings: batches by map or by single tasks.
        shuffle, mirror, seed: as for `task_loader`.
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
        self.epoch = self.skip = 0

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

    def __iter__(self) -> Iterator[Batch]:
        skip, self.skip = self.skip, 0
        rest: Batch | None = None
        for dataset, sampler in self._parts():
            sampler.first = self.settings.size - len(rest.heights) if rest is not None else 0
            for index in sampler:
                batch = dataset[index]
                if rest is not None:
                    batch, rest = Batch(*(torch.cat(pair) for pair in zip(rest, batch, strict=True))), None
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
            yield TaskDataset(tasks), sampler


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

    def __iter__(self) -> Iterator[Batch]:
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


def mirror_heights(heights: Tensor) -> Tensor:
    """Mirrors patches [..., nx, ny] on the robot's x axis.

    Convention: the base stands at the centre of cell ny // 2, so cell j maps to ny - j. Cell 0 has no counterpart in
    the patch and takes its neighbour's height.
    """
    flipped = heights.flip(-1).roll(1, -1)
    flipped[..., 0] = flipped[..., 1]
    return flipped


def mirror_goals(goals: Tensor) -> Tensor:
    """Mirrors goals [..., 3] on the robot's x axis: (dx, -dy, -dtheta)."""
    return goals * goals.new_tensor([1.0, -1.0, -1.0])


def _shared(array: np.ndarray, dtype) -> Tensor:
    array = np.asarray(array, dtype)
    if not array.flags.writeable or not array.flags.c_contiguous:
        array = np.array(array)  # torch cannot share read-only memory
    return torch.from_numpy(array)


def _as_is(batch: Any) -> Any:
    return batch
