"""Callbacks: loss weight rules (the paper's and the published script's), records of steps, weight averaging.

Both rules compare unweighted epoch losses. Loss weights are part of the module's state and a rule's history is part of
its callback's state, so both survive a resume from a checkpoint.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, Protocol, runtime_checkable

import lightning.pytorch as pl
import torch
from lightning.pytorch.callbacks import ModelCheckpoint, WeightAveraging
from torch.optim.swa_utils import get_ema_multi_avg_fn

from hdsp.learning.learning_settings import LossSettings
from hdsp.learning.task_data import generator_seed
from hdsp.learning.task_stream import ResumableBatches

#: Losses, in the order in which rules treat them.
LOSSES = ("feasibility", "cost")


@runtime_checkable
class HasLossWeights(Protocol):
    """A module whose loss weights a rule can change, as `hdsp.learning.module.AbstractionModule`."""

    def epoch_losses(self) -> dict[str, float]: ...

    def scale_loss_weight(self, name: str, factor: float) -> None: ...


class LossWeightRule(pl.Callback, ABC):
    """Divides the weights of the losses from ``losses_to_cut`` by ``factor`` after each training epoch."""

    def __init__(self, factor: float = 5.0, patience: int = 3):
        settings = LossSettings(factor=factor, patience=patience)
        self.factor, self.patience = settings.factor, settings.patience

    def __repr__(self) -> str:
        return f"{type(self).__name__}(factor={self.factor:g}, patience={self.patience})"

    @abstractmethod
    def losses_to_cut(self, losses: Mapping[str, float]) -> list[str]:
        """Returns the names of the losses to cut, given the losses of the epoch that just ended."""

    def on_train_epoch_end(self, trainer: pl.Trainer, module: pl.LightningModule) -> None:
        assert isinstance(module, HasLossWeights)
        for name in self.losses_to_cut(module.epoch_losses()):
            module.scale_loss_weight(name, 1 / self.factor)


class PlateauLossWeights(LossWeightRule):
    """The paper's rule (Sec. VI, network training).

    When a loss stays at or above its lowest value for ``patience`` successive epochs (3), its weight is divided by
    ``factor`` (5) and its count restarts. Each loss has its own count.
    """

    def __init__(self, factor: float = 5.0, patience: int = 3):
        super().__init__(factor, patience)
        self.best = dict.fromkeys(LOSSES, float("inf"))
        self.waited = dict.fromkeys(LOSSES, 0)

    def losses_to_cut(self, losses: Mapping[str, float]) -> list[str]:
        cut = []
        for name in LOSSES:
            if losses[name] < self.best[name]:
                self.best[name], self.waited[name] = losses[name], 0
                continue
            self.waited[name] += 1
            if self.waited[name] >= self.patience:
                self.waited[name] = 0
                cut.append(name)
        return cut

    def state_dict(self) -> dict[str, Any]:
        return {"best": dict(self.best), "waited": dict(self.waited)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.best, self.waited = dict(state["best"]), dict(state["waited"])


class PublishedLossWeights(LossWeightRule):
    """The rule in the authors' published script.

    When a loss rises ``patience`` times in a row (2), its weight is divided by ``factor`` (5) and its history is reset.
    A cut of the feasibility weight also resets the cost loss history.
    """

    def __init__(self, factor: float = 5.0, patience: int = 2):
        super().__init__(factor, patience)
        self.last: dict[str, float | None] = dict.fromkeys(LOSSES)
        self.rises = dict.fromkeys(LOSSES, 0)

    def losses_to_cut(self, losses: Mapping[str, float]) -> list[str]:
        cut = []
        for name in LOSSES:
            last = self.last[name]
            self.rises[name] = self.rises[name] + 1 if last is not None and losses[name] > last else 0
            self.last[name] = losses[name]
            if self.rises[name] >= self.patience:
                cut.append(name)
        for name in LOSSES if "feasibility" in cut else cut:
            self.last[name], self.rises[name] = None, 0
        return cut

    def state_dict(self) -> dict[str, Any]:
        return {"last": dict(self.last), "rises": dict(self.rises)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.last, self.rises = dict(state["last"]), dict(state["rises"])


#: Rule names in the configuration; ``constant`` has no callback.
LOSS_WEIGHT_RULES: dict[str, type[LossWeightRule]] = {"plateau": PlateauLossWeights, "published": PublishedLossWeights}


class EpochPosition(pl.Callback):
    """Restores a training's position from a checkpoint: the batch within an epoch, and whether training has stopped.

    Lightning restores a loader's state only if no code has asked for the number of steps before. Learning rate
    schedules ask for it, so this callback restores the position. Lightning forgets a stop, and would go on by an epoch.

    Random numbers of dropout layers and losses are a function of (seed, epoch, batch) alone, as batches are.
    """

    def __init__(self, batches: ResumableBatches, seed: int = 0):
        self.batches, self.seed = batches, seed
        self.ended = False

    def on_train_batch_start(self, trainer: pl.Trainer, module: pl.LightningModule, batch: Any, index: int) -> None:
        self.ended = False
        torch.manual_seed(generator_seed(self.seed, trainer.current_epoch, index))

    def on_train_epoch_end(self, trainer: pl.Trainer, module: pl.LightningModule) -> None:
        self.ended = True
        self.batches.end_epoch()

    def on_save_checkpoint(self, trainer: pl.Trainer, module: pl.LightningModule, checkpoint: dict[str, Any]) -> None:
        checkpoint["stopped"] = self.ended and bool(trainer.should_stop)

    def on_load_checkpoint(self, trainer: pl.Trainer, module: pl.LightningModule, checkpoint: dict[str, Any]) -> None:
        trainer.should_stop = trainer.should_stop or checkpoint.get("stopped", False)

    def state_dict(self) -> dict[str, Any]:
        return self.batches.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.batches.load_state_dict(state)


class CheckpointsWithinEpoch(ModelCheckpoint):
    """Keeps the last state every few minutes within an epoch, where a training can go on.

    Within a window of accumulated batches, their gradients are in no checkpoint. After the last batch, a training that
    goes on would take the epoch for finished, without its validation.
    """

    def on_train_batch_end(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        done = batch_idx + 1
        if done % trainer.accumulate_grad_batches == 0 and done < trainer.num_training_batches:
            super().on_train_batch_end(trainer, pl_module, outputs, batch, batch_idx)


class StepRecord(pl.Callback):
    """Passes losses, learning rate and gradient norm (before clipping) of every nth step to loggers and a function."""

    def __init__(self, every: int, on_step: Callable[[int, dict[str, float]], None] | None = None):
        self.every, self.on_step = every, on_step

    def on_before_optimizer_step(
        self, trainer: pl.Trainer, module: pl.LightningModule, optimizer: torch.optim.Optimizer
    ) -> None:
        step = trainer.global_step
        if step % self.every or not trainer.is_global_zero:
            return
        norms = [p.grad.detach().norm() for p in module.parameters() if p.grad is not None]
        losses: Any = module.step_losses
        values = {f"step/{name}": float(loss) for name, loss in zip(LOSSES, losses, strict=True)}
        values |= {
            "step/learning_rate": float(optimizer.param_groups[0]["lr"]),
            "step/gradient_norm": float(torch.stack(norms).norm()) if norms else 0.0,
        }
        for logger in trainer.loggers:
            logger.log_metrics(values, step=step)
        if self.on_step is not None:
            self.on_step(step, values)


class AveragedWeights(WeightAveraging):
    """Keeps an exponential moving average of the weights, for validation and for checkpoints.

    The average forgets faster in the first steps (after n steps its decay is at most (1 + n) / (10 + n)), so the random
    initial weights fade quickly.
    """

    def __init__(self, decay: float):
        def average(averaged, current, count):
            steps = int(count)
            get_ema_multi_avg_fn(min(decay, (1 + steps) / (10 + steps)))(averaged, current, count)

        super().__init__(multi_avg_fn=torch.no_grad()(average))
