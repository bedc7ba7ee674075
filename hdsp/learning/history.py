"""Epoch metrics: collected, written, printed, passed to loggers."""

import csv
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lightning.pytorch as pl

from hdsp.base.errors import InputError
from hdsp.base.files import replacing
from hdsp.learning.callbacks import LOSSES
from hdsp.learning.module import AbstractionModule

OnEpoch = Callable[[int, dict[str, float]], None]


class EpochHistory(pl.Callback):
    """Collects the module's metrics after each epoch, with ``learning_rate``, ``seconds`` and ``score``.

    The rows are part of the checkpoint, so a resumed training has the whole history. After each epoch ``history.csv``
    and ``history.json`` are rewritten, one line is printed, and loggers and ``on_epoch`` receive the metrics.
    """

    def __init__(self, folder: Path, score: Callable[[dict[str, float]], float], on_epoch: OnEpoch | None, quiet: bool):
        self.folder, self.score, self.on_epoch, self.quiet = folder, score, on_epoch, quiet
        self.rows: list[dict[str, Any]] = []
        self.started = 0.0
        self.epochs_seen = 0

    def on_train_start(self, trainer: pl.Trainer, module: pl.LightningModule) -> None:
        self.started = time.perf_counter()  # a resumed epoch has no start event

    def on_train_epoch_start(self, trainer: pl.Trainer, module: pl.LightningModule) -> None:
        self.started = time.perf_counter()

    def on_train_epoch_end(self, trainer: pl.Trainer, module: pl.LightningModule) -> None:
        assert isinstance(module, AbstractionModule)
        metrics = module.epoch_metrics()
        metrics["score"] = self.score(metrics)
        metrics["learning_rate"] = float(trainer.optimizers[0].param_groups[0]["lr"])
        metrics["seconds"] = time.perf_counter() - self.started
        epoch = trainer.current_epoch
        _check_losses(epoch, metrics)
        self.rows.append({"epoch": epoch, **metrics})
        self.epochs_seen += 1
        module.log("score", metrics["score"], logger=False)
        if not trainer.is_global_zero:
            return
        for logger in trainer.loggers:
            logger.log_metrics(metrics, step=epoch)
        write_history(self.folder, self.rows)
        if not self.quiet:
            print(epoch_line(epoch, trainer.max_epochs, metrics), flush=True)
        if self.on_epoch is not None:
            self.on_epoch(epoch, dict(metrics))

    def state_dict(self) -> dict[str, Any]:
        return {"rows": list(self.rows)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.rows = list(state["rows"])


def _check_losses(epoch: int, metrics: dict[str, float]) -> None:
    if not all(math.isfinite(metrics[f"loss/{name}"]) for name in LOSSES):
        raise InputError(
            f"training diverged: in epoch {epoch + 1} its loss is no number, try a smaller trainer.optimizer.lr than "
            f"{metrics['learning_rate']:g}"
        )


def epoch_line(epoch: int, epochs: int | None, metrics: dict[str, float]) -> str:
    """Formats an epoch's metrics as one line."""
    sets = sorted(name.removeprefix("cost_error/") for name in metrics if name.startswith("cost_error/"))
    quality = "  ".join(
        f"{name} {100 * metrics[f'feasibility_accuracy/{name}']:.2f} % / {metrics[f'cost_error/{name}']:.4f}"
        for name in sets
    )
    losses = f"losses {metrics['loss/feasibility']:.4f} {metrics['loss/cost']:.4f}"
    return f"epoch {epoch + 1:>3}/{epochs}  {losses}  {quality}  {metrics['seconds']:.1f} s"


def write_history(folder: Path, rows: list[dict[str, Any]]) -> None:
    """Writes ``history.csv`` and ``history.json`` (a list with one flat mapping per epoch)."""
    with replacing(folder / "history.json") as path:
        path.write_text(json.dumps(rows, indent=1) + "\n")
    write_columns(folder / "history.csv", rows)


def write_columns(path: Path, rows: list[dict[str, Any]]) -> None:
    """Writes the rows as a CSV file; a value is empty where an interrupted training had another set."""
    names = dict.fromkeys(name for row in rows for name in row)
    with replacing(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(names) or ["epoch"])
        writer.writeheader()
        writer.writerows(rows)
