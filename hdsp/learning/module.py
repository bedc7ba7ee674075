"""Lightning module for task networks: losses, optimiser, schedule and metrics."""

from typing import Any

import lightning.pytorch as pl
import torch
from torch import Tensor

from hdsp.learning.callbacks import LOSSES
from hdsp.learning.learning_settings import LossSettings, OptimizerSettings, ScheduleSettings
from hdsp.learning.metrics import TaskMetrics, cost_loss, task_losses
from hdsp.learning.networks import TaskNetwork
from hdsp.learning.task_data import Batch, PlanningBatch


class AbstractionModule(pl.LightningModule):
    """Trains a ``TaskNetwork``.

    The loss is w_f BCE(feasibility) + w_c L1(cost over feasible tasks). For a network that predicts costs for planning,
    and batches with them, their L1 is part of the cost loss. The weights are buffers and part of every checkpoint.

    Args:
        network: network to train.
        optimizer, schedule, losses: settings.
        val_sets: validation set names, in dataloader order.
    """

    loss_weights: Tensor
    loss_sums: Tensor

    def __init__(
        self,
        network: TaskNetwork,
        optimizer: OptimizerSettings,
        schedule: ScheduleSettings,
        losses: LossSettings,
        val_sets: tuple[str, ...] = (),
    ):
        super().__init__()
        self.network = network
        self.optimizer_settings, self.schedule_settings = optimizer, schedule
        self.val_sets = val_sets
        self.register_buffer("loss_weights", torch.tensor([losses.feasibility, losses.cost]))
        self.register_buffer("loss_sums", torch.zeros(3, dtype=torch.float64), persistent=False)
        self.metrics = {name: TaskMetrics() for name in val_sets}

    def epoch_losses(self) -> dict[str, float]:
        """Returns the epoch's mean unweighted losses so far: feasibility over all tasks, cost over feasible tasks."""
        sums = self.loss_sums.tolist()
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
        feasibility, error = task_losses(cost, logits, batch.feasible, batch.cost)
        if planning and isinstance(batch, PlanningBatch):
            error = error + cost_loss(planning[0], batch.planning_cost, batch.feasible)
        losses = torch.stack([feasibility, error])
        size = len(batch.heights)
        self.loss_sums[:2] += losses.detach() * size
        self.loss_sums[2] += size
        return (self.loss_weights * losses).sum()

    def on_validation_epoch_start(self) -> None:
        for metrics in self.metrics.values():
            metrics.reset()

    def validation_step(self, batch: Batch | PlanningBatch, index: int, dataloader_idx: int = 0) -> None:
        cost, logits, *planning = self.network(batch.heights, batch.goals)
        known = (planning[0], batch.planning_cost) if planning and isinstance(batch, PlanningBatch) else None
        self.metrics[self.val_sets[dataloader_idx]].update(cost, logits, batch.feasible, batch.cost, known)

    def configure_optimizers(self):
        settings = self.optimizer_settings
        decayed = [p for p in self.network.parameters() if p.ndim > 1]
        free = [p for p in self.network.parameters() if p.ndim <= 1]
        groups = [{"params": decayed, "weight_decay": settings.weight_decay}, {"params": free, "weight_decay": 0.0}]
        if settings.name == "sgd":
            optimizer = torch.optim.SGD(groups, lr=settings.lr, momentum=settings.momentum)
        else:
            optimizer = torch.optim.AdamW(groups, lr=settings.lr)
        if self.schedule_settings.name == "constant":
            return optimizer
        steps = int(self.trainer.estimated_stepping_batches)
        if self.schedule_settings.name == "cosine":
            schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
        else:
            schedule = torch.optim.lr_scheduler.OneCycleLR(
                optimizer,
                max_lr=settings.lr,
                total_steps=steps,
                pct_start=self.schedule_settings.warmup,
                cycle_momentum=False,
            )
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}
