"""Parts of a training that come from outside: optimiser, schedule, loss, metrics, callbacks, loggers."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import lightning.pytorch as pl
import torch
from lightning.pytorch.loggers import Logger
from lightning.pytorch.profilers import AdvancedProfiler, Profiler, PyTorchProfiler, SimpleProfiler
from torch import Tensor

from hdsp.learning.processes import summed

#: (predicted costs, feasibility logits, feasible, labelled costs) -> (feasibility loss, cost loss); all arguments have
#: one shape [B, G], and costs count only where a task is feasible.
Loss = Callable[[Tensor, Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]


@runtime_checkable
class OwnMetric(Protocol):
    """A metric over the tasks of a validation set."""

    def reset(self) -> None:
        """Forgets all tasks."""

    def update(self, cost: Tensor, logits: Tensor, feasible: Tensor, labelled_cost: Tensor) -> None:
        """Adds tasks; all arguments have one shape."""

    def compute(self) -> float:
        """Returns the metric for all tasks since ``reset``.

        With several processes, each has its share of the tasks, and all call this at once to join their sums
        (`hdsp.learning.processes.summed`).
        """


class TaskMean:
    """Metric from a function: the mean of its values over all tasks since ``reset``; NaN without tasks.

    Args:
        function: takes the arguments of ``update``, and returns a value for each task, a number or a bool.
    """

    def __init__(self, function: Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]):
        self.function = function
        self.reset()

    def reset(self) -> None:
        self._sum, self._tasks = 0.0, 0

    def update(self, cost: Tensor, logits: Tensor, feasible: Tensor, labelled_cost: Tensor) -> None:
        values = self.function(cost, logits, feasible, labelled_cost)
        self._sum += float(values.sum())
        self._tasks += values.numel()

    def compute(self) -> float:
        total, tasks = summed(torch.tensor([self._sum, self._tasks], dtype=torch.float64)).tolist()
        return total / tasks if tasks else float("nan")


def named_profiler(name: Any, folder: Path) -> Profiler | None:
    """Returns Lightning's profiler of this name, which writes its table to a file in a folder; None without a name."""
    kinds: dict[str, Any] = {"simple": SimpleProfiler, "advanced": AdvancedProfiler, "pytorch": PyTorchProfiler}
    return kinds[name](folder, "profile") if isinstance(name, str) else None


@dataclass(frozen=True)
class TrainingParts:
    """Parts for a training; None = as the settings say.

    Attributes:
        optimizer: parameter groups -> optimiser.
        schedule: optimiser, number of steps -> learning rate schedule, stepped after each batch.
        loss: replaces the losses of the paper. Under several processes it has to be a mean over tasks and a mean over
            feasible tasks, because these shares weight it.
        metrics: by name, a function that makes a metric; each validation set has its own.
        callbacks, loggers: further ones for Lightning.
        strategy, profiler: Lightning's.
    """

    optimizer: Callable[[list[dict[str, Any]]], Any] | None = None
    schedule: Callable[[Any, int], Any] | None = None
    loss: Loss | None = None
    metrics: Mapping[str, Callable[[], OwnMetric]] = field(default_factory=dict)
    callbacks: Sequence[pl.Callback] = ()
    loggers: Sequence[Logger] = ()
    strategy: Any = None
    profiler: Any = None
