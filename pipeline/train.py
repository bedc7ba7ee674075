"""Stage `train`: tasks -> a learned abstraction, tracked by MLflow. `python -m pipeline.train -m model=a,b` sweeps."""

from __future__ import annotations

import hashlib
import math
import shutil
import sys
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from hdsp.base.errors import InputError
from hdsp.base.files import replace_folder
from hdsp.base.storage import Place, is_folder, is_url, open_folder, split_place

from . import served_model, tracking
from .config import flatten, plain
from .config_types import Config, is_place
from .folders import alone
from .label_places import shards_place
from .parts import training_parts
from .stage import Folders, read_json, run_stage, write_json
from .task_sets import read_evaluation_set, read_set, set_place

#: Ends of keys without influence on a comparison; `config.yaml` has them.
_NOISE = ("_partial_", "checkpoint_minutes", "stream_shards")

if TYPE_CHECKING:
    from hdsp.labels.tasks import TaskSet
    from hdsp.learning import TrainResult
    from hdsp.learning.learning_settings import TrainerSettings
    from hdsp.robot.robot import Robot


def train(config: Config, folders: Folders) -> float:
    """Trains the configured network; returns the score of its best epoch, lower is better."""
    from hdsp.learning import Provenance, TrainingConfig
    from hdsp.learning import train as train_network
    from hdsp.learning.processes import is_first_process
    from hdsp.learning.training import check_lightning

    from .run_logger import RunLogger

    config.model.checked_options()  # before the tasks are read
    trainer, lightning = config.trainer, config.runtime.lightning
    parts = training_parts(trainer, lightning)
    settings = TrainingConfig(config.model, trainer, config.runtime.hardware, lightning)
    check_lightning(settings)  # this too
    train_tasks, sets, splits = read_sets(config, folders)
    hashes = hashes_of(config, splits, sets)
    data_hash = _hash_of([hashes[name] for name in trainer.splits])
    first = is_first_process()  # others share its work, and write nothing
    tracked: AbstractContextManager[Any] = nullcontext()
    if first:
        tracked = tracking.run(record_of(config, folders, hashes))
    work = folders.write("models", "training")
    with alone(work, "lock") if first else nullcontext(), tracked as mlflow:
        datasets = log_datasets(mlflow, config, splits, hashes) if mlflow is not None else {}
        result = train_network(
            settings,
            train_tasks,
            sets,
            work,
            RunLogger(mlflow),
            provenance=Provenance.of(config.robot, data_hash, **notes(config, train_tasks)),
            quiet=not config.runtime.progress,
            parts=parts,
            progress=config.runtime.progress and sys.stderr.isatty(),
        )
        if mlflow is not None:
            write_results(config, folders, result, sets["val"], mlflow, datasets)
    if first:
        # The next training starts from scratch, perhaps after a code change; it must not resume a finished one.
        shutil.rmtree(work / "checkpoints", ignore_errors=True)
    return result.metrics["score"]


def read_sets(config: Config, folders: Folders) -> tuple[TaskSet | list[Place], dict[str, TaskSet], dict[str, Place]]:
    """Returns the training tasks (or their folders), the sets for validation, and the place of each split and set."""
    from hdsp.labels.label_robots import other_robot

    trainer = config.trainer
    names = (*trainer.splits, *trainer.val_splits)
    splits: dict[str, Place] = {name: shards_place(config, folders.inputs, name) for name in names}
    learnt, deciding = ([splits[name] for name in names] for names in (trainer.splits, trainer.val_splits))
    if trainer.limits.overfit is not None:
        few = part_of(learnt, trainer, config.robot)[: trainer.limits.overfit]
        return few, {"val": few}, splits
    if trainer.stream:
        for name in filter(is_place, trainer.splits):  # labels elsewhere; those of this configuration have its robot
            if reason := other_robot(splits[name], config.robot):
                raise InputError(f"cannot train: {reason}")
    train_tasks = learnt if trainer.stream else part_of(learnt, trainer, config.robot)
    sets = {"val": _required(deciding, config.robot)}
    for name in config.evaluation.watched:
        entry = config.evaluation.sets[name]
        tasks, reason = read_evaluation_set(name, entry, config, folders)
        if tasks is None:
            print(f"{name}: not watched, {reason}")
        else:
            sets[name], splits[name] = tasks, set_place(entry, config, folders)
    return train_tasks, sets, splits


def record_of(config: Config, folders: Folders, hashes: Mapping[str, str]) -> tracking.RunRecord:
    """Returns what MLflow records about a training before it begins."""
    whole = plain(config)
    matter = {name: whole[name] for name in ("model", "trainer", "profile")} | {"robot": config.robot.name}
    parameters = {
        key: value for key, value in flatten(matter).items() if value not in (None, [], {}) and not key.endswith(_NOISE)
    }
    given = dict(line.lstrip("+~").partition("=")[::2] for line in folders.overrides)
    known = (*parameters, "hydra", "runtime", *(key for key in given if _is_above(key, parameters)))
    parameters |= {key: value for key, value in given.items() if not key.startswith(known)}
    title = folders.title or config.profile
    texts = {"config.yaml": yaml.safe_dump(whole, sort_keys=False), "overrides.txt": "\n".join(folders.overrides)}
    tags = {f"data.{name}": value for name, value in hashes.items()}
    architecture = config.model.architecture
    name = title if architecture in title else f"{architecture} {title}"
    return tracking.RunRecord(name, parameters, tags, texts, config.runtime.system_metrics)


def _is_above(key: str, parameters: Mapping[str, Any]) -> bool:
    """Whether a key is a group (`model`, `trainer/schedule`) whose values are parameters."""
    return any(name.startswith(f"{key.replace('/', '.')}.") for name in parameters)


def log_datasets(mlflow: Any, config: Config, splits: Mapping[str, Place], hashes: Mapping[str, str]) -> dict[str, Any]:
    """Logs each split and set as an input of the run; returns them by name."""
    from mlflow.data.http_dataset_source import HTTPDatasetSource
    from mlflow.data.meta_dataset import MetaDataset

    datasets: dict[str, Any] = {}
    for name, place in splits.items():
        source = HTTPDatasetSource(str(place) if is_url(place) else Path(place).resolve().as_uri())
        make: Any = MetaDataset
        datasets[name] = make(source, name=name, digest=hashes[name][:32])
        uses = ["training"] * (name in config.trainer.splits) + ["validation"] * (name in config.trainer.val_splits)
        for use in uses or ["test"]:
            mlflow.log_input(datasets[name], context=use)
    return datasets


def write_results(
    config: Config, folders: Folders, result: TrainResult, tasks: TaskSet, mlflow: Any, datasets: Mapping[str, Any]
) -> None:
    """Copies the abstraction, writes reports, and completes the run in MLflow."""
    from hdsp.learning import LearnedAbstraction, count_parameters
    from hdsp.learning.history import write_columns
    from hdsp.viz import save_training_curves

    abstraction_dir = folders.write("models", "abstraction")
    replace_folder(abstraction_dir, {path.name: path.read_bytes() for path in sorted(result.model_dir.iterdir())})
    history = folders.write("reports", "training_history.csv")
    write_columns(history, result.history)
    curves = folders.write("reports", "figures", "training_curves.png")
    save_training_curves(result.history, curves)
    summary = {
        "model": config.model.architecture,
        "parameters": count_parameters(LearnedAbstraction.from_pretrained(abstraction_dir).network),
        "maps": result.maps,
        "epochs": len(result.history),
        "best_epoch": result.best_epoch,
        "seconds": result.seconds,
        "score": result.metrics["score"],
        **_nested(result.metrics),
    }
    write_json(folders.write("reports", "training.json"), summary)
    model_id = served_model.log(mlflow, abstraction_dir, tasks, config.runtime.register)
    mlflow.log_metrics({name: summary[name] for name in ("parameters", "maps", "best_epoch", "seconds")})
    for name, value in result.metrics.items():
        if name.startswith(("learning_rate", "seconds", "loss_weight")):
            continue  # no properties of the kept state
        # The selection set is one set of several splits.
        of = name.partition("/")[2]
        data = datasets.get(config.trainer.val_splits[0] if of == "val" else of)
        mlflow.log_metric(f"best/{name}", value, model_id=model_id, dataset=data)
    profiles = result.model_dir.parent.glob("*-profile*") if config.runtime.lightning.profiler else ()
    for file in (history, curves, *profiles):
        mlflow.log_artifact(str(file), "training")
    stored = read_json(abstraction_dir / "config.json")
    tracking.keep_run(folders, mlflow.active_run().info.run_id, model_id, stored["weights_sha256"])


def notes(config: Config, tasks: TaskSet | list[Place]) -> dict[str, Any]:
    """Returns data and recipe notes for the model card, saved with the model.

    `tasks` are the training tasks, or the folders that hold them.
    """
    from hdsp.labels.shards import shard_sizes

    streamed = [maps for place in tasks for _, maps in shard_sizes(place)] if isinstance(tasks, list) else None
    return {
        "profile": config.profile,
        "maps": len(tasks) if streamed is None else sum(streamed),
        "trainer": plain(config.trainer),
        **_notes_of_initial(config),
        **data_notes(config, config.trainer.splits),
    }


def _notes_of_initial(config: Config) -> dict[str, Any]:
    """Notes of the model whose weights start the training, with the options that it has otherwise."""
    from hdsp.learning import LearnedAbstraction
    from hdsp.learning.training import complete_settings

    if (folder := config.trainer.initial) is None:
        return {}
    saved = LearnedAbstraction.from_pretrained(folder)
    notes, own = dict(saved.provenance.notes), complete_settings(config.model)["options"]
    options = complete_settings(saved.model)["options"]
    other = {key: value for key, value in options.items() if own.get(key, value) != value}
    return {"initial": notes | ({"model": {"options": other}} if other else {})}


def data_notes(config: Config, splits: Sequence[str]) -> dict[str, Any]:
    """Returns the contents of the training maps."""
    known = {**config.labelling.splits, **config.simulation.splits}
    return {
        "splits": {name: plain(known[name]) if name in known else {"folder": name} for name in splits},
        "sensing": plain(config.labelling.sensing),
        "terrain": plain(config.terrain),
    }


def part_of(folders: Sequence[Place], trainer: TrainerSettings, robot: Robot | None = None) -> TaskSet:
    """Returns the maps that `trainer.share` and `trainer.residues` select; depends on both and the labels alone.

    Only as many shards are read as this share needs; each shard is a sample from its split.

    Raises:
        InputError: a split does not exist or records another robot than the one given, or no map is left.
    """
    import numpy as np

    from hdsp.labels.label_robots import OtherRobotError, read_own_tasks
    from hdsp.labels.shards import shard_paths
    from hdsp.labels.tasks import TaskSet
    from hdsp.robot.lattice import HEADINGS, HEADINGS_PER_ABSTRACT

    share = trainer.share
    if share == 1:
        tasks = _required(folders, robot)
    else:
        parts, random = [], np.random.default_rng(0)
        for folder in folders:
            shards = shard_paths(folder)
            wanted = share * len(shards)
            chosen = [shards[k] for k in sorted(random.permutation(len(shards))[: math.ceil(wanted)])]
            try:
                read = read_own_tasks(folder, robot, chosen)
            except OtherRobotError as error:
                raise InputError(f"cannot train: {error}") from None
            found = TaskSet.concatenate(read) if read else _required([folder], robot)
            left = round(len(found) * wanted / max(len(read), 1))
            parts.append(found[np.sort(random.permutation(len(found))[:left])])
        tasks = TaskSet.concatenate(parts)
    kept = np.ones(len(tasks), bool)
    if (residues := trainer.residues) is not None:
        kept &= np.isin(tasks.heading % (HEADINGS // 4), HEADINGS_PER_ABSTRACT * np.array(residues, int))
    if not kept.any():
        raise InputError(f"cannot train: no map is left of {len(tasks)} by trainer.share and trainer.residues")
    return tasks if kept.all() else tasks[kept]


def hashes_of(config: Config, places: Mapping[str, Place], sets: Mapping[str, TaskSet]) -> dict[str, str]:
    """Returns the hash of each split and watched set.

    Files of a scan may lie outside the folder with its description, so the hash of such a set is that of its tasks.

    Args:
        config: the configuration.
        places: place of each split and set.
        sets: the tasks of the watched sets.
    """
    watched = config.evaluation.watched
    scanned = {name for name in watched if name in sets and config.evaluation.sets[name].scans is not None}
    return {name: _tasks_hash(sets[name]) if name in scanned else folder_hash(at) for name, at in places.items()}


def _tasks_hash(tasks: TaskSet) -> str:
    digest = hashlib.sha256("\0".join(tasks.category).encode())
    for name, array in tasks.arrays().items():
        if name != "category":
            digest.update(f"{name} {array.dtype.str} {array.shape}\0".encode() + array.tobytes())
    return digest.hexdigest()


def folder_hash(folder: Place) -> str:
    """Hash over all file names and contents in a folder, also in subfolders and behind links; or over one file.

    For labels with an index, the hash of everything they depend on.
    """
    from hdsp.labels.shards import index_of

    if (index := index_of(folder)) is not None:
        return index.digest
    files, names = open_folder(folder), []
    if is_folder(folder):
        names = [name for name in sorted(files.stamps()) if not name.rpartition("/")[2].startswith(".")]
    else:
        files, name = split_place(folder)
        names = [name]
    digest = hashlib.sha256()
    for name in names:
        digest.update(f"{name}\0".encode())
        digest.update(hashlib.sha256(files.read(name)).digest())
    return digest.hexdigest()


def _hash_of(hashes: list[str]) -> str:
    return hashes[0] if len(hashes) == 1 else hashlib.sha256("".join(hashes).encode()).hexdigest()


def _required(paths: Sequence[Place], robot: Robot | None) -> TaskSet:
    """Joins the tasks from several splits in one set."""
    from hdsp.labels.tasks import TaskSet

    sets = []
    for path in paths:
        tasks, reason = read_set(path, robot)
        if tasks is None:
            raise InputError(f"cannot train: {reason}")
        sets.append(tasks)
    return sets[0] if len(sets) == 1 else TaskSet.concatenate(sets)


def _nested(metrics: dict[str, float]) -> dict[str, Any]:
    """Converts `{"cost_error/val": 1}` to `{"cost_error": {"val": 1}}`, for readable names in metric tables."""
    nested: dict[str, Any] = {}
    for name, value in metrics.items():
        group, _, of = name.partition("/")
        if of:
            nested.setdefault(group, {})[of] = value
    return nested


if __name__ == "__main__":
    run_stage(train, "train", sweep_context=tracking.sweep)
