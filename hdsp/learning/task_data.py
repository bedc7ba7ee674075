"""Labelled tasks as batches of tensors: everything in memory once, batches are picked by index (`task_loader`); or read
shard by shard, where that is too much (`TaskStream`)."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, IterableDataset, Sampler, get_worker_info

from hdsp.base.errors import InputError
from hdsp.robot.lattice import N_ABSTRACT_ACTIONS

if TYPE_CHECKING:
    from hdsp.base.storage import Place
    from hdsp.labels.tasks import TaskSet


@dataclass(frozen=True)
class BatchSettings:
    """How tasks are put into batches.

    Attributes:
        by: ``map``: all 22 goals of ``size`` maps (the trunk is evaluated once per map). ``task``: ``size`` single
            tasks, each its own evaluation; size 1 is the paper's training.
        size: maps or tasks per batch.
    """

    by: Literal["map", "task"] = "map"
    size: int = 32

    def __post_init__(self):
        if self.size < 1:
            raise InputError(f"trainer.batch.size: {self.size} is below 1")


class Batch(NamedTuple):
    """Tasks of one step: heights [B, 1, 72, 72], goals [B, G, 3], feasible bool [B, G], cost [B, G] (0 if
    infeasible)."""

    heights: Tensor
    goals: Tensor
    feasible: Tensor
    cost: Tensor


class BatchIndex(NamedTuple):
    """What a batch consists of: maps int64 [B]; tasks int64 [B] for single tasks, else None; mirrored bool [B] or
    None."""

    maps: Tensor
    tasks: Tensor | None
    mirrored: Tensor | None


class TaskDataset(Dataset):
    """The tensors of a ``TaskSet``, shared with it and never copied; indexed by ``BatchIndex``."""

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
    """Batches of an epoch, shuffled and mirrored as a function of (seed, epoch) alone, so that a resumed training sees
    the batches an undisturbed one would have seen.

    Attributes:
        epoch: which one the next iteration is.
        skip: batches that the next iteration, and it alone, leaves out: those before an interruption.
        first: size of the first batch where it is not that of all; 0 = it is.
    """

    def __init__(
        self, maps: int, goals: int, settings: BatchSettings, shuffle: bool, mirror: bool = False, seed: int = 0
    ):
        self.maps, self.goals, self.settings = maps, goals, settings
        self.shuffle, self.mirror, self.seed, self.epoch = shuffle, mirror, seed, 0
        self.skip = self.first = 0

    def set_epoch(self, epoch: int) -> None:
        """Called by Lightning before each epoch."""
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
    """Batches of a task set.

    Args:
        tasks: labelled maps.
        settings: batches by map or single tasks.
        shuffle: new order every epoch.
        mirror: mirror each item on its x axis with probability one half; the robot and its costs are symmetric.
        seed: of order and mirroring.

    Raises:
        InputError: if the task set is empty.
    """
    dataset = TaskDataset(tasks)
    sampler = BatchSampler(len(dataset), dataset.goals.shape[1], settings, shuffle, mirror, seed)
    return DataLoader(dataset, batch_size=None, sampler=sampler, collate_fn=_as_is)


class TaskStream(IterableDataset):
    """Batches of labelled splits that need not fit into memory: their shards are read a few at a time.

    The same maps as those of `task_loader`, each once an epoch. Shards come in an order that is new every epoch, and
    maps are shuffled among the shards that are in memory together; what is left of these fills the first batch of the
    next, so that all batches but the last are full. All is a function of (seed, epoch) alone.

    Args:
        places: folder or URL of shards, or several.
        settings: batches by map or single tasks.
        shuffle, mirror, seed: as for `task_loader`.
        shards_in_memory: how many are read at a time.

    Attributes:
        epoch, skip: as of `BatchSampler`; batches that are skipped are read all the same.

    Raises:
        InputError: if there is no shard in a place, or, when it is met, one is damaged.
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
        for place in [places] if isinstance(places, str | Path) else places:
            found = shard_paths(place)
            if not found:
                raise InputError(f"folder {place} holds no shard")
            self.paths += found
        self.settings, self.shuffle, self.mirror = settings, shuffle, mirror
        self.seed, self.shards_in_memory = seed, shards_in_memory
        self.epoch = self.skip = 0

    @cached_property
    def maps(self) -> list[int]:
        """Maps in each shard; all are read for it, once."""
        from hdsp.labels.shards import read_shard

        return [len(read_shard(path).tasks) for path in self.paths]

    def __len__(self) -> int:
        """Batches of an epoch, where one process reads them."""
        items = sum(self.maps) * (1 if self.settings.by == "map" else N_ABSTRACT_ACTIONS)
        return -(-items // self.settings.size)

    def set_epoch(self, epoch: int) -> None:
        """Which epoch the next iteration is; called by Lightning before each epoch."""
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
        """The maps that are in memory together, and how they come."""
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
    """The batches of a training, which goes on within an epoch where a checkpoint was written.

    Lightning sets the epoch of `sampler`; `hdsp.learning.callbacks.EpochPosition` puts the position into checkpoints.

    Args:
        batches: what `task_loader` returns, or a stream.
    """

    def __init__(self, batches: "DataLoader | TaskStream"):
        self.batches = batches
        self.sampler = batches if isinstance(batches, TaskStream) else batches.sampler
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
        """How many batches of the epoch were given."""
        return {"given": self.given}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.start = state["given"] % len(self)  # after the last one the next epoch begins


def mirror_heights(heights: Tensor) -> Tensor:
    """Patches [..., nx, ny] mirrored on the x axis of the robot.

    Convention: the base stands at the centre of cell ny // 2, so cell j goes to ny - j; cell 0 has no counterpart in
    the patch and takes the height of its neighbour.
    """
    flipped = heights.flip(-1).roll(1, -1)
    flipped[..., 0] = flipped[..., 1]
    return flipped


def mirror_goals(goals: Tensor) -> Tensor:
    """Goals [..., 3] mirrored on the x axis of the robot: (dx, -dy, -dtheta)."""
    return goals * goals.new_tensor([1.0, -1.0, -1.0])


def _shared(array: np.ndarray, dtype) -> Tensor:
    array = np.asarray(array, dtype)
    if not array.flags.writeable or not array.flags.c_contiguous:
        array = np.array(array)  # torch cannot share read-only memory
    return torch.from_numpy(array)


def _as_is(batch: Batch) -> Batch:
    return batch
