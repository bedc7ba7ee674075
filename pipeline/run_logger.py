"""MLflow as a logger of Lightning: everything that a training or its callbacks log goes to the training's run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lightning.pytorch.loggers.logger import Logger, rank_zero_experiment
from lightning.pytorch.utilities import rank_zero_only


class RunLogger(Logger):
    """Logger of the active run, which exists in the first process alone.

    Args:
        mlflow: the module, inside a run; None in further processes.
    """

    def __init__(self, mlflow: Any):
        super().__init__()
        self.mlflow = mlflow

    @property
    def name(self) -> str:
        return "mlflow"

    @property
    def version(self) -> str:
        return self.mlflow.active_run().info.run_id if self.mlflow is not None else ""

    @property
    @rank_zero_experiment
    def experiment(self) -> Any:
        """The module, for callbacks that log pictures or files."""
        return self.mlflow

    @rank_zero_only
    def log_metrics(self, metrics: Mapping[str, float], step: int | None = None) -> None:
        # The page of a run shows the last step of a metric; `seconds` is that of the whole training.
        own = {"seconds": "epoch_seconds"}
        values = {own.get(name, name): float(value) for name, value in metrics.items() if name != "epoch"}
        self.mlflow.log_metrics(values, step=step)

    @rank_zero_only
    def log_hyperparams(self, params: Any, *args: Any, **kwargs: Any) -> None:
        """Logs nothing; the run has its parameters already."""
