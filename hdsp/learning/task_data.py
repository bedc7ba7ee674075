"""Labelled tasks as tensor batches, from memory by index."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from hdsp.base.errors import InputError
from hdsp.learning.learning_settings import BatchSettings

if TYPE_CHECKING:
    from hdsp.labels.tasks import TaskSet

#: Names of the costs in a batch: ``cost`` and ``planning_cost``.
Targets = Sequence[Literal["cost", "planning_cost"]]


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


class PlanningBatch(NamedTuple):
    """A ``Batch`` with a second target: ``planning_cost`` [B, G], cost for planning, 0 if infeasible."""

    heights: Tensor
    goals: Tensor
    feasible: Tensor
    cost: Tensor
    planning_cost: Tensor


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


class TaskArrays(NamedTuple):
    """The arrays of a ``TaskSet`` that batches consist of."""

    heights: np.ndarray
    goals: np.ndarray
    feasible: np.ndarray
    cost: np.ndarray
    planning_cost: np.ndarray | None = None


class TaskDataset(Dataset):
    """Tensors that share memory with a ``TaskSet``; indexed by ``BatchIndex``.

    ``targets`` names the costs in a batch: ``cost``, and ``planning_cost`` for ``PlanningBatch`` if the labels have it.
    """

    def __init__(self, tasks: "TaskSet | TaskArrays", targets: Targets = ("cost",)):
        if len(tasks.heights) == 0:
            raise InputError("task set: it holds no maps")
        self.heights = _shared(tasks.heights, np.float32)
        self.goals = _shared(tasks.goals, np.float32)
        self.feasible = _shared(tasks.feasible, np.bool_)
        self.cost = _shared(tasks.cost, np.float32)
        self.planning_cost = None
        if "planning_cost" in targets:
            if tasks.planning_cost is None:
                raise InputError("task set: its labels have no planning_cost; label with settings.planning_costs: true")
            self.planning_cost = _shared(tasks.planning_cost, np.float32)

    def __len__(self) -> int:
        return len(self.heights)

    def __getitem__(self, index: BatchIndex) -> Batch | PlanningBatch:
        maps, tasks, mirrored = index
        heights = self.heights[maps][:, None]
        goals, feasible, cost = (_chosen(part, maps, tasks) for part in (self.goals, self.feasible, self.cost))
        if mirrored is not None:
            heights = torch.where(mirrored[:, None, None, None], mirror_heights(heights), heights)
            goals = torch.where(mirrored[:, None, None], mirror_goals(goals), goals)
        if self.planning_cost is None:
            return Batch(heights, goals, feasible, cost)
        return PlanningBatch(heights, goals, feasible, cost, _chosen(self.planning_cost, maps, tasks))


class BatchSampler(Sampler[BatchIndex]):
    """An epoch's batches, shuffled and mirrored as a function of (seed, epoch) alone.

    A resumed training sees the same batches as an uninterrupted one.

    Attributes:
        epoch: epoch of the next iteration.
        skip: number of batches before an interruption, which only the next iteration leaves out.
    """

    def __init__(
        self, maps: int, goals: int, settings: BatchSettings, shuffle: bool, mirror: bool = False, seed: int = 0
    ):
        self.maps, self.goals, self.settings = maps, goals, settings
        self.shuffle, self.mirror, self.seed, self.epoch = shuffle, mirror, seed, 0
        self.skip = 0

    def set_epoch(self, epoch: int) -> None:
        """Sets the next iteration's epoch; Lightning calls it before each epoch."""
        self.epoch = epoch

    def __len__(self) -> int:
        items = self.maps if self.settings.by == "map" else self.maps * self.goals
        return -(-items // self.settings.size)

    def __iter__(self) -> Iterator[BatchIndex]:
        single = self.settings.by == "task"
        items = self.maps * self.goals if single else self.maps
        generator = torch.Generator().manual_seed(generator_seed(self.seed, self.epoch))
        order = torch.randperm(items, generator=generator) if self.shuffle else torch.arange(items)
        skip, self.skip = self.skip, 0
        for number, chosen in enumerate(order.split(self.settings.size)):
            mirrored = torch.rand(len(chosen), generator=generator) < 0.5 if self.mirror else None
            if number < skip:
                continue
            if single:
                yield BatchIndex(chosen // self.goals, chosen % self.goals, mirrored)
            else:
                yield BatchIndex(chosen, None, mirrored)


def task_loader(
    tasks: "TaskSet",
    settings: BatchSettings,
    shuffle: bool = False,
    mirror: bool = False,
    seed: int = 0,
    targets: Targets = ("cost",),
) -> DataLoader:
    """Batches from a task set.

    Args:
        tasks: labelled maps.
        settings: batches by map or by single tasks.
        shuffle: new order every epoch.
        mirror: mirror each item on its x axis with probability one half; the robot and its costs are symmetric.
        seed: seed for order and mirroring.
        targets: costs in each batch, as in ``TaskDataset``.

    Raises:
        InputError: the task set is empty, or it lacks a target.
    """
    dataset = TaskDataset(tasks, targets)
    sampler = BatchSampler(len(dataset), dataset.goals.shape[1], settings, shuffle, mirror, seed)
    return DataLoader(dataset, batch_size=None, sampler=sampler, collate_fn=as_is)


def generator_seed(*numbers: int) -> int:
    """Returns a seed for a generator of torch, which takes 64 bits, from whole numbers of any size."""
    seed = 0
    for number in numbers:
        seed = seed * 1_000_003 + number
    return seed % 2**63


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


def _chosen(part: Tensor, maps: Tensor, tasks: Tensor | None) -> Tensor:
    """Entries [B, G, ...] of an array [n, 22, ...]: all tasks of each map, or one."""
    return part[maps] if tasks is None else part[maps, tasks][:, None]


def _shared(array: np.ndarray, dtype) -> Tensor:
    array = np.asarray(array, dtype)
    if not array.flags.writeable or not array.flags.c_contiguous:
        array = np.array(array)  # torch cannot share read-only memory
    return torch.from_numpy(array)


def as_is(batch: Any) -> Any:
    return batch
