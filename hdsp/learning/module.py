"""Lightning module for task networks: losses, optimiser, schedule and metrics."""

from collections.abc import Mapping
from typing import Any

import lightning.pytorch as pl
import torch
from torch import Tensor

from hdsp.base.errors import InputError
from hdsp.learning.callbacks import LOSSES
from hdsp.learning.learning_settings import LossSettings, OptimizerSettings, ScheduleSettings
from hdsp.learning.metrics import TaskMetrics, cost_loss, task_losses
from hdsp.learning.networks import TaskNetwork
from hdsp.learning.processes import process_count, shares, summed
from hdsp.learning.task_data import Batch, PlanningBatch
from hdsp.learning.training_parts import OwnMetric, TrainingParts


class AbstractionModule(pl.LightningModule):
    """Trains a ``TaskNetwork``.

    The loss is w_f BCE(feasibility) + w_c L1(cost over feasible tasks). For a network that predicts costs for planning,
    and batches with them, their L1 is part of the cost loss. The weights are buffers and part of every checkpoint.

    Args:
        network: network to train.
        optimizer, schedule, losses: settings; mappings stand for those of ``parts``.
        val_sets: validation set names, in dataloader order.
        parts: own optimiser, schedule, loss and metrics.
    """

    loss_weights: Tensor

    def __init__(
        self,
        network: TaskNetwork,
        optimizer: OptimizerSettings | Mapping[str, Any],
        schedule: ScheduleSettings | Mapping[str, Any],
        losses: LossSettings,
        val_sets: tuple[str, ...] = (),
        parts: TrainingParts | None = None,
    ):
        super().__init__()
        self.network = network
        self.optimizer_settings, self.schedule_settings = optimizer, schedule
        self.val_sets, self.parts = val_sets, parts or TrainingParts()
        self.register_buffer("loss_weights", torch.tensor([losses.feasibility, losses.cost]))
        self.loss_sums = torch.zeros(3, dtype=torch.float64)  # no buffer: each process has its own
        self.metrics = {name: TaskMetrics() for name in val_sets}
        self.own_metrics: dict[str, dict[str, OwnMetric]] = {
            name: {metric: make() for metric, make in self.parts.metrics.items()} for name in val_sets
        }
        self.step_losses = torch.zeros(2)

    def epoch_losses(self) -> dict[str, float]:
        """Returns the epoch's mean unweighted losses so far: feasibility over all tasks, cost over feasible tasks."""
        sums = summed(self.loss_sums).tolist()
        return {name: sums[i] / max(sums[2], 1.0) for i, name in enumerate(LOSSES)}

    def epoch_metrics(self) -> dict[str, float]:
        """Returns flat metrics for the epoch that just ended.

        Keys are ``loss/*`` and ``loss_weight/*`` (as used in the epoch) for ``feasibility`` and ``cost``, and
        ``feasibility_accuracy/{set}`` and ``cost_error/{set}`` for each validation set; ``planning_cost_error/{set}``
        for a network that predicts costs for planning.
        """
        values = {f"loss/{name}": value for name, value in self.epoch_losses().items()}
        values |= {f"loss_weight/{name}": self.loss_weight(name) for name in LOSSES}
        for set_name, metrics in self.metrics.items():
            computed = metrics.compute()
            shown = ("feasibility_accuracy", "cost_error", "planning_cost_error")
            values |= {f"{metric}/{set_name}": computed[metric] for metric in shown if metric in computed}
            values |= {f"{name}/{set_name}": float(own.compute()) for name, own in self.own_metrics[set_name].items()}
        return values

    def loss_weight(self, name: str) -> float:
        """Returns the current weight for loss ``feasibility`` or ``cost``."""
        return float(self.loss_weights[LOSSES.index(name)])

    def scale_loss_weight(self, name: str, factor: float) -> None:
        """Multiplies a loss weight by a factor."""
        self.loss_weights[LOSSES.index(name)] *= factor

    def on_train_epoch_start(self) -> None:
        self.loss_sums.zero_()

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        checkpoint["loss_sums"] = self.loss_sums.tolist()

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        self.loss_sums[:] = torch.tensor(checkpoint.get("loss_sums", [0.0] * 3), dtype=torch.float64)

    def training_step(self, batch: Batch | PlanningBatch, index: int) -> Tensor:
        cost, logits, *planning = self.network(batch.heights, batch.goals)
        feasibility, error = (self.parts.loss or task_losses)(cost, logits, batch.feasible, batch.cost)
        if planning and isinstance(batch, PlanningBatch):
            error = error + cost_loss(planning[0], batch.planning_cost, batch.feasible)
        losses = torch.stack([feasibility, error])
        size: Tensor | float = len(batch.heights)
        if process_count() > 1:  # the mean over processes is the mean over the tasks of all
            losses = losses * shares(batch.feasible)
            size = summed(losses.new_tensor(float(size))) / process_count()
        self.loss_sums = self.loss_sums.to(losses.device)
        self.loss_sums[:2] += losses.detach() * size
        self.loss_sums[2] += size
        self.step_losses = losses.detach()
        return (self.loss_weights * losses).sum()

    def on_validation_epoch_start(self) -> None:
        for name, metrics in self.metrics.items():
            metrics.reset()
            for own in self.own_metrics[name].values():
                own.reset()

    def validation_step(self, batch: Batch | PlanningBatch, index: int, dataloader_idx: int = 0) -> None:
        cost, logits, *planning = self.network(batch.heights, batch.goals)
        known = (planning[0], batch.planning_cost) if planning and isinstance(batch, PlanningBatch) else None
        name = self.val_sets[dataloader_idx]
        self.metrics[name].update(cost, logits, batch.feasible, batch.cost, known)
        for own in self.own_metrics[name].values():
            own.update(cost, logits, batch.feasible, batch.cost)

    def configure_optimizers(self):
        optimizer, settings = self._optimizer(), self.schedule_settings
        if self.parts.schedule is None and isinstance(settings, ScheduleSettings) and settings.name == "constant":
            return optimizer
        steps = int(self.trainer.estimated_stepping_batches)
        if self.parts.schedule is not None:
            schedule = self.parts.schedule(optimizer, steps)
        else:
            assert isinstance(settings, ScheduleSettings)
            schedule = _schedule(settings, optimizer, steps)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

    def _optimizer(self) -> torch.optim.Optimizer:
        decayed = {"params": [p for p in self.network.parameters() if p.ndim > 1]}
        free = {"params": [p for p in self.network.parameters() if p.ndim <= 1], "weight_decay": 0.0}
        settings = self.optimizer_settings
        if self.parts.optimizer is not None:
            return self.parts.optimizer([decayed, free])
        if not isinstance(settings, OptimizerSettings):
            raise InputError(f"trainer.optimizer is {dict(settings)}; pass what it makes as TrainingParts.optimizer")
        groups = [{**decayed, "weight_decay": settings.weight_decay}, free]
        if settings.name == "sgd":
            return torch.optim.SGD(groups, lr=settings.lr, momentum=settings.momentum)
        return torch.optim.AdamW(groups, lr=settings.lr)


def _schedule(settings: ScheduleSettings, optimizer: torch.optim.Optimizer, steps: int) -> Any:
    if settings.name == "cosine":
        return torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    highest = [group["lr"] for group in optimizer.param_groups]
    warmup = settings.warmup
    if warmup * steps == 1:
        warmup *= 1 + 1e-9  # torch divides by the number of warmup steps after the first one
    return torch.optim.lr_scheduler.OneCycleLR(
        optimizer, max_lr=highest, total_steps=steps, pct_start=warmup, cycle_momentum=False
    )
