"""Several processes that train one network (DDP): each takes a share of every batch.

Batches are the same as in one process, so results depend on the number of processes by rounding only.
"""

from collections.abc import Iterator
from typing import Any, TypeVar

import torch
import torch.distributed as dist
from lightning.pytorch.utilities import rank_zero_only
from torch import Tensor

#: A batch: tensors with one map in each row.
Part = TypeVar("Part", bound=Any)


def process_count() -> int:
    """Returns the number of processes of this training."""
    return dist.get_world_size() if dist.is_available() and dist.is_initialized() else 1


def process_number() -> int:
    """Returns this process's number, from 0."""
    return dist.get_rank() if process_count() > 1 else 0


def is_first_process() -> bool:
    """Whether this process writes the results, also before and after a training."""
    return int(getattr(rank_zero_only, "rank", None) or 0) == 0


def summed(values: Tensor) -> Tensor:
    """Returns the sum over all processes; every process has to call this."""
    if process_count() == 1:
        return values
    total = values.to(_meeting_place(values.device), copy=True)
    dist.all_reduce(total)
    return total.to(values.device)


def _meeting_place(device: torch.device) -> torch.device:
    """The device on which processes can add values; NCCL adds none on the CPU."""
    return torch.device("cuda") if dist.get_backend() == "nccl" else device


def own_part(batch: Part) -> Part:
    """Returns this process's share of a batch; empty if the batch has fewer maps than processes."""
    count = process_count()
    return batch if count == 1 else type(batch)(*(tensor[process_number() :: count] for tensor in batch))


def own_parts(batches: Any, *, full: bool) -> Iterator[Any]:
    """Yields this process's share of each batch.

    With ``full``, a batch with fewer maps than processes is left out everywhere, so that all processes take the same
    number of steps; otherwise only where the share is empty.
    """
    for batch in batches:
        if len(batch.heights) < process_count() and full:
            continue
        part = own_part(batch)
        if len(part.heights):
            yield part


class SharedBatches:
    """Validation batches of which each process takes its share."""

    def __init__(self, batches: Any):
        self.batches = batches

    def __len__(self) -> int:
        return len(self.batches)

    def __iter__(self) -> Iterator[Any]:
        yield from own_parts(self.batches, full=False)


def shares(feasible: Tensor) -> Tensor:
    """Returns factors for the losses of this process's tasks: over all tasks, and over feasible tasks.

    The mean over processes of a mean times its factor is the mean over all processes' tasks.
    """
    own = torch.stack([torch.tensor(float(feasible.numel()), device=feasible.device), feasible.sum().float()])
    return own * process_count() / summed(own).clamp_min(1)
