"""Parts of a training that the configuration names by `_target_`, made by Hydra."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from hydra.utils import get_object, instantiate

from hdsp.base.errors import InputError
from hdsp.base.settings import TARGET

from .config import plain

if TYPE_CHECKING:
    from hdsp.learning.learning_settings import LightningSettings, TrainerSettings
    from hdsp.learning.training_parts import OwnMetric, TrainingParts

#: Value of an argument of a schedule that stands for the number of steps.
STEPS = "steps"


def check_targets(values: Any, key: str) -> None:
    """Imports every `_target_` in nested settings, so that a wrong one is named before any work.

    Raises:
        InputError: an import fails.
    """
    if isinstance(values, Mapping):
        if isinstance(place := values.get(TARGET), str):
            try:
                get_object(place)
            except Exception as error:  # an import runs any code
                words = " ".join(str(error).split())
                raise InputError(f"{key}.{TARGET} is {place!r}: {words}") from error
        for name, value in values.items():
            check_targets(value, f"{key}.{name}")


def training_parts(trainer: TrainerSettings, lightning: LightningSettings) -> TrainingParts:
    """Makes all parts of a training.

    Raises:
        InputError: a part cannot be made.
    """
    from hdsp.learning.training_parts import TrainingParts

    check_targets(plain(trainer), "trainer")
    check_targets(plain(lightning), "runtime.lightning")
    schedule = trainer.schedule
    return TrainingParts(
        optimizer=_made("trainer.optimizer", trainer.optimizer, _partial_=True)
        if isinstance(trainer.optimizer, dict)
        else None,
        schedule=(lambda optimizer, steps: _scheduled(schedule, steps)(optimizer))
        if isinstance(schedule, dict)
        else None,
        loss=_made("trainer.loss", trainer.loss),
        metrics={name: _metric_maker(f"trainer.metrics.{name}", values) for name, values in trainer.metrics.items()},
        callbacks=[_made(f"trainer.callbacks.{n}", values) for n, values in trainer.callbacks.items() if values],
        loggers=[_made(f"runtime.lightning.loggers.{n}", values) for n, values in lightning.loggers.items() if values],
        strategy=_made("runtime.lightning.strategy", lightning.strategy),
        profiler=_made("runtime.lightning.profiler", lightning.profiler),
    )


def _scheduled(settings: Mapping[str, Any], steps: int) -> Any:
    values = {key: steps if value == STEPS else value for key, value in settings.items()}
    return _made("trainer.schedule", values, _partial_=True)


def _metric_maker(key: str, values: Mapping[str, Any]) -> Callable[[], OwnMetric]:
    """Function that makes a metric: the object behind a `_target_`, or the mean of a function's values over tasks."""
    from hdsp.learning.training_parts import OwnMetric, TaskMean

    def make() -> OwnMetric:
        made = _made(key, values)
        return made if isinstance(made, OwnMetric) else TaskMean(made)

    if not (isinstance(made := _made(key, values), OwnMetric) or callable(made)):
        raise InputError(f"{key}: {values[TARGET]} makes {made!r}; need an object with reset, update and compute")
    return make


def _made(key: str, values: Any, **more: Any) -> Any:
    """Object behind a `_target_`; None for other values."""
    if not isinstance(values, Mapping):
        return None
    try:
        return instantiate({**plain(values), **more})
    except Exception as error:  # a constructor raises what it likes
        cause = error.__cause__ or error
        words = " ".join(str(cause).split()) or type(cause).__name__
        raise InputError(f"{key}: {values[TARGET]} cannot be made: {words}") from error
