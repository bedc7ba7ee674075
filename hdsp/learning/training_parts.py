"""Parts of a training that come from outside: optimiser, schedule, loss, metrics, callbacks, loggers."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import lightning.pytorch as pl
from lightning.pytorch.loggers import Logger
from torch import Tensor

#: (predicted costs, feasibility logits, feasible, labelled costs) -> (feasibility loss, cost loss); all arguments have
#: one shape [B, G], and costs count only where a task is feasible.
Loss = Callable[[Tensor, Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]


class OwnMetric(Protocol):
    """A metric over the tasks of a validation set."""

    def reset(self) -> None:
        """Forgets all tasks."""

    def update(self, cost: Tensor, logits: Tensor, feasible: Tensor, labelled_cost: Tensor) -> None:
        """Adds tasks; all arguments have one shape."""

    def compute(self) -> float:
        """Returns the metric for all tasks since ``reset``."""


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
