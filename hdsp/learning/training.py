"""Training from labelled tasks to a saved abstraction; resumes after every epoch and every few minutes within one."""

import hashlib
import json
import logging
import math
import time
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lightning.pytorch as pl
import torch
from lightning.pytorch.callbacks import EarlyStopping, ModelCheckpoint
from lightning.pytorch.loggers import Logger
from lightning.pytorch.utilities.exceptions import MisconfigurationException
from torch.nn import functional

from hdsp.base.errors import InputError
from hdsp.base.messages import one_line
from hdsp.base.settings import load_settings
from hdsp.base.short_repr import short_repr
from hdsp.learning.abstraction import LearnedAbstraction
from hdsp.learning.callbacks import (
    LOSS_WEIGHT_RULES,
    AveragedWeights,
    CheckpointsWithinEpoch,
    EpochPosition,
    StepRecord,
)
from hdsp.learning.checkpoints import WholeCheckpoints, checkpoint_to_resume, read_checkpoint
from hdsp.learning.footprint_geometry import GOAL_FEATURES
from hdsp.learning.hardware import channels_last
from hdsp.learning.history import EpochHistory, OnEpoch
from hdsp.learning.learning_settings import (
    LATER,
    BatchSettings,
    ModelSettings,
    TrainerSettings,
    TrainingConfig,
)
from hdsp.learning.module import AbstractionModule
from hdsp.learning.networks import build_network
from hdsp.learning.networks.base import TaskNetwork
from hdsp.learning.processes import SharedBatches
from hdsp.learning.saved_abstraction import Provenance
from hdsp.learning.task_data import Targets, TaskDataset, generator_seed, task_loader
from hdsp.learning.task_stream import ResumableBatches, TaskStream
from hdsp.learning.training_parts import TrainingParts, named_profiler

if TYPE_CHECKING:
    from hdsp.base.storage import Place
    from hdsp.labels.tasks import TaskSet

#: Steps between values that callbacks log of steps, where nobody asks for them.
NEVER = 1_000_000
#: Validation batches; their size has no influence on results.
VALIDATION_BATCH = BatchSettings(by="map", size=64)


@dataclass(frozen=True)
class TrainResult:
    """Training result.

    Attributes:
        model_dir: saved abstraction from the best epoch (``LearnedAbstraction.from_pretrained``).
        best_epoch: counted from 0.
        metrics: flat metrics for the best epoch.
        history: flat metrics for every epoch.
        seconds: duration of this call; after a resume without the interrupted part.
        resumed_from: number of epochs that an earlier, interrupted call finished.
        maps: number of training maps.
    """

    model_dir: Path
    best_epoch: int
    metrics: dict[str, float]
    history: list[dict[str, float]]
    seconds: float
    resumed_from: int
    maps: int

    def __repr__(self) -> str:
        return short_repr(self)


def train(
    config: Mapping[str, Any] | TrainingConfig,
    train_tasks: "TaskSet | Sequence[Place]",
    val_sets: Mapping[str, "TaskSet"],
    out_dir: str | Path,
    logger: Logger | Iterable[Logger] | None = None,
    callbacks: Iterable[pl.Callback] = (),
    on_epoch: OnEpoch | None = None,
    provenance: Provenance | None = None,
    quiet: bool = False,
    *,
    parts: TrainingParts | None = None,
    on_step: OnEpoch | None = None,
    progress: bool = False,
) -> TrainResult:
    """Trains a network and saves the state with the best validation score.

    If ``out_dir/checkpoints`` holds the last state of the same training (same model, trainer settings and tasks),
    training continues from there, within an epoch at the next batch. A state from another training, or with another
    selection set, is replaced; other validation sets may come and go. If the last state is damaged, the best one takes
    its place. With several devices, each process runs this call; only the
    first one writes.

    Args:
        config: keys ``model``, ``trainer``, ``hardware``, ``lightning``, see ``TrainingConfig``.
        train_tasks: labelled maps; or folders or URLs with shards, which are read a few at a time.
        val_sets: labelled maps by name; all are evaluated after every epoch, ``trainer.selection.set`` decides.
        out_dir: receives ``model/``, ``history.csv``, ``history.json``, ``checkpoints/``.
        logger: Lightning logger(s), which receive the metrics once per epoch with the epoch as step.
        callbacks: further Lightning callbacks.
        on_epoch: called with (epoch, flat metrics) after every epoch.
        provenance: robot, cost model and data behind the labels, saved with the model.
        quiet: whether to omit the printed line per epoch.
        parts: own optimiser, schedule, loss, metrics, callbacks and loggers.
        on_step: called with (step, values) every ``lightning.log_every`` steps.
        progress: whether to show a progress bar within the epoch.

    Raises:
        InputError: a configuration key is unknown or a value wrong, a task set is empty or lacks the costs for planning
            that the network predicts, the selection set is missing, or a loss is no number.
    """
    config = load_settings(TrainingConfig, config)
    check_lightning(config)
    trainer_settings, out_dir = config.trainer, Path(out_dir)
    if trainer_settings.selection.set not in val_sets:
        names = ", ".join(val_sets) or "(none)"
        chosen = trainer_settings.selection.set
        raise InputError(f"trainer.selection.set: {chosen!r} is not one of the validation sets {names}")
    started = time.perf_counter()
    config.hardware.apply_threads()
    parts = parts or TrainingParts()
    module = _module(config, tuple(val_sets), parts)
    predicted: Targets = ("cost", "planning_cost") if module.network.predicts_planning_cost else ("cost",)
    source, maps = _training_batches(trainer_settings, train_tasks, predicted, config.hardware.readers)
    batches = ResumableBatches(source)
    val_loaders = {name: _validation_batches(tasks, predicted) for name, tasks in val_sets.items()}

    checkpoints = out_dir / "checkpoints"
    deciding = val_loaders[trainer_settings.selection.set].batches.dataset
    last = checkpoint_to_resume(checkpoints, _fingerprint(config, source, deciding))
    history = EpochHistory(out_dir, trainer_settings.selection.score, on_epoch, quiet)
    own = [history, EpochPosition(batches, trainer_settings.seed), *_own_callbacks(config, checkpoints, on_step)]
    # Loaders and dropout layers draw from the global generator; the fork leaves the caller's state unchanged.
    with _without_lightning_chatter(), torch.random.fork_rng():
        torch.manual_seed(generator_seed(trainer_settings.seed))
        trainer = pl.Trainer(
            **_trainer_options(config, parts, out_dir),
            callbacks=[*own, *parts.callbacks, *callbacks],
            logger=[*parts.loggers, *_as_list(logger)] or False,
            enable_progress_bar=progress,
        )
        trainer.fit(module, batches, list(val_loaders.values()), ckpt_path=last, weights_only=True if last else None)

    best_epoch = _take_best(module, checkpoints, history.rows, trainer_settings)
    # A training that is repeated saves the same abstraction to the byte, so without its time.
    metrics = {key: value for key, value in history.rows[best_epoch].items() if key not in ("epoch", "seconds")}
    abstraction = LearnedAbstraction(module.network, config.model, provenance or Provenance(), metrics)
    abstraction = abstraction.calibrated(val_sets[trainer_settings.selection.set])
    if trainer.is_global_zero:
        abstraction.save_pretrained(out_dir / "model", picture=False)
    seconds, resumed_from = time.perf_counter() - started, len(history.rows) - history.epochs_seen
    return TrainResult(out_dir / "model", best_epoch, metrics, history.rows, seconds, resumed_from, maps)


def _own_callbacks(config: TrainingConfig, checkpoints: Path, on_step: OnEpoch | None) -> list[pl.Callback]:
    """The callbacks that the settings ask for, first those that keep checkpoints."""
    settings, log_every = config.trainer, config.lightning.log_every
    within = timedelta(minutes=settings.checkpoint_minutes)
    result: list[pl.Callback] = [
        ModelCheckpoint(checkpoints, "best", monitor="score", enable_version_counter=False),
        ModelCheckpoint(checkpoints, "last", enable_version_counter=False),
        CheckpointsWithinEpoch(checkpoints, "last", train_time_interval=within, enable_version_counter=False),
    ]
    if settings.early_stopping:
        result.append(EarlyStopping("score", patience=settings.early_stopping, check_finite=False))
    if settings.ema:
        result.append(AveragedWeights(settings.ema))
    if settings.losses.rule != "constant":
        result.append(LOSS_WEIGHT_RULES[settings.losses.rule](settings.losses.factor, settings.losses.patience))
    if log_every is not None:
        result.append(StepRecord(log_every, on_step))
    return result


def _trainer_options(config: TrainingConfig, parts: TrainingParts, out_dir: Path) -> dict[str, Any]:
    """Lightning's options that follow from the settings."""
    settings, lightning, hardware = config.trainer, config.lightning, config.hardware
    return {
        "accelerator": hardware.device().type,
        "devices": lightning.devices,
        "num_nodes": lightning.nodes,
        "strategy": parts.strategy or lightning.strategy,
        "precision": lightning.precision or ("bf16-mixed" if hardware.precision == "bf16" else "32-true"),
        "profiler": parts.profiler or named_profiler(lightning.profiler, out_dir),
        "max_epochs": settings.epochs,
        "accumulate_grad_batches": settings.accumulate,
        "limit_train_batches": settings.limits.train,
        "limit_val_batches": settings.limits.val,
        "gradient_clip_val": settings.gradient_clip,
        "sync_batchnorm": hardware.device().type == "cuda",
        "use_distributed_sampler": False,
        "plugins": [WholeCheckpoints()],
        "enable_model_summary": False,
        "num_sanity_val_steps": 0,
        "log_every_n_steps": lightning.log_every or NEVER,
    }


def check_lightning(config: TrainingConfig) -> None:
    """Checks the names that settings give to Lightning, and whether this machine has what they need, before any work.

    Raises:
        InputError: Lightning refuses strategy, precision or devices.
    """
    options = _trainer_options(config, TrainingParts(), Path())
    names = ("accelerator", "devices", "num_nodes", "strategy", "precision")
    given = {name: options[name] for name in names if isinstance(options[name], str | int)}
    try:
        with _without_lightning_chatter():
            pl.Trainer(**given, logger=False, enable_checkpointing=False)
    except (ValueError, TypeError, ImportError, MisconfigurationException) as error:
        chosen = f"strategy {given.get('strategy', 'auto')}, precision {given['precision']}, devices {given['devices']}"
        raise InputError(f"lightning: {chosen}: {one_line(str(error))}") from error


def _take_best(
    module: AbstractionModule, checkpoints: Path, rows: Sequence[Mapping[str, float]], settings: TrainerSettings
) -> int:
    """Loads the weights with the best score, the last ones if no score is finite; returns their epoch."""
    scored = math.isfinite(min(row["score"] for row in rows))
    if not scored:
        print(_without_score(rows, settings), flush=True)
    state = read_checkpoint(checkpoints / ("best.ckpt" if scored else "last.ckpt"))
    module.load_state_dict(state["state_dict"])
    return min(int(state["epoch"]), len(rows) - 1)


def _without_score(rows: Sequence[Mapping[str, float]], settings: TrainerSettings) -> str:
    """Words for a training in which no epoch has a finite score."""
    return (
        f"the network judges no feasible task of {settings.selection.set!r} feasible after {len(rows)} epochs; the "
        "last epoch is kept. More of trainer.epochs, more maps or another learning rate may help"
    )


def _module(config: TrainingConfig, val_sets: tuple[str, ...], parts: TrainingParts) -> AbstractionModule:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(generator_seed(config.trainer.seed))
        network = channels_last(build_network(config.model))
    trainer, compiled = config.trainer, config.lightning.compile
    if trainer.initial is not None:
        _begin_with(network, trainer.initial, config.model)
    if compiled:
        network.compile(**(compiled if isinstance(compiled, dict) else {}))
    return AbstractionModule(network, trainer.optimizer, trainer.schedule, trainer.losses, val_sets, parts)


def _begin_with(network: TaskNetwork, folder: str | Path, model: ModelSettings) -> None:
    """Copies the weights from a saved abstraction.

    A footprint network with foot ways may begin as one without them, or without manoeuvres: the weights of what it sees
    more then have no effect yet.
    """
    saved = LearnedAbstraction.from_pretrained(folder)
    weights = saved.network.state_dict()
    if complete_settings(saved.model) != complete_settings(model):
        options = complete_settings(model)["options"]
        ways = options.get("foot_ways") or {}
        less = [{**options, "foot_ways": None}, {**options, "foot_ways": {**ways, "manoeuvres": False}}]
        if model.architecture != "footprint" or complete_settings(saved.model) not in (
            {**complete_settings(model), "options": each} for each in less
        ):
            raise InputError(
                f"trainer.initial: {folder} holds a {saved.model.architecture}, {saved.model.to_dict()}; "
                f"training is of {model.architecture}, {model.to_dict()}"
            )
        _add_ways(weights, network.state_dict())
    network.load_state_dict(weights)


def complete_settings(model: ModelSettings) -> dict[str, Any]:
    """A model's settings, with those of the foot ways that an older file lacks."""
    values = model.to_dict()
    if ways := values.get("options", {}).get("foot_ways"):
        values = {**values, "options": {**values["options"], "foot_ways": {"manoeuvres": False, **ways}}}
    return values


def _add_ways(weights: dict[str, Any], own: Mapping[str, Any]) -> None:
    """Adds the layers of foot ways or the inputs of manoeuvres, as in ``own`` but without an effect."""
    first = "steps.0.weight"
    if first not in weights:
        weights |= {name: value for name, value in own.items() if name.startswith("steps.")}
        missing = own["heads.weight"].shape[1] - weights["heads.weight"].shape[1]
        weights["heads.weight"] = functional.pad(weights["heads.weight"], (0, missing))
        return
    missing = own[first].shape[1] - weights[first].shape[1]
    before, goals = weights[first][:, :-GOAL_FEATURES], weights[first][:, -GOAL_FEATURES:]
    weights[first] = torch.cat([functional.pad(before, (0, missing)), goals], dim=1)


def _as_list(logger: Logger | Iterable[Logger] | None) -> list[Logger]:
    return [logger] if isinstance(logger, Logger) else list(logger or ())


def _training_batches(
    settings: TrainerSettings, tasks: "TaskSet | Sequence[Place]", targets: Targets, readers: int
) -> tuple[Any, int]:
    """An epoch's batches, and their map count."""
    from hdsp.labels.tasks import TaskSet

    order: dict[str, Any] = {"shuffle": True, "mirror": settings.mirror, "seed": settings.seed, "targets": targets}
    if isinstance(tasks, TaskSet):
        return task_loader(tasks, settings.batch, **order), len(tasks)
    stream = TaskStream(tasks, settings.batch, **order, shards_in_memory=settings.stream_shards, readers=readers)
    if not len(stream):
        raise InputError(f"{', '.join(map(str, tasks))}: the shards hold no maps")
    return stream, sum(stream.maps)


def _validation_batches(tasks: "TaskSet", predicted: Targets) -> SharedBatches:
    known: Targets = predicted if tasks.planning_cost is not None else ("cost",)
    return SharedBatches(task_loader(tasks, VALIDATION_BATCH, targets=known))


def _fingerprint(config: TrainingConfig, batches: Any, deciding: TaskDataset) -> str:
    """Hash over everything that decides whether a checkpoint belongs to this training; ``deciding``: selection set."""
    trainer = config.trainer
    values = asdict(trainer)
    decisive = {entry.name: values[entry.name] for entry in fields(trainer) if entry.repr}
    parts: list[Any] = [config.model.to_dict(), decisive]
    later = {name: (getattr(trainer, name), default) for name, default in LATER.items()}
    parts += [f"{name} {value}" for name, (value, default) in later.items() if value != default]
    digest = hashlib.sha256(json.dumps(parts, sort_keys=True).encode())
    _add_tasks(digest, deciding)
    if isinstance(batches, TaskStream):  # the path of a shard holds its label hash
        order = [batches.shards_in_memory, *map(str, batches.paths), *batches.maps]
        digest.update(json.dumps(order).encode())
        return digest.hexdigest()
    _add_tasks(digest, batches.dataset)
    return digest.hexdigest()


def _add_tasks(digest: Any, data: TaskDataset) -> None:
    planning = [data.planning_cost] if data.planning_cost is not None else []
    for tensor in (data.heights, data.goals, data.feasible, data.cost, *planning):
        array: Any = tensor.numpy()
        digest.update(memoryview(array).cast("B"))


@contextmanager
def _without_lightning_chatter() -> Iterator[None]:
    """Suppresses Lightning's notes on hardware, tips and data loaders."""
    names = ("lightning.pytorch", "lightning.pytorch.utilities.rank_zero", "lightning.fabric.utilities.rank_zero")
    loggers = [logging.getLogger(name) for name in names]
    levels = [logger.level for logger in loggers]
    try:
        for logger in loggers:
            logger.setLevel(logging.ERROR)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", module="lightning.*")
            warnings.filterwarnings("ignore", message=".*does not have many workers.*")
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
