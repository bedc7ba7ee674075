"""MLflow tracking: one experiment, one run per training, one parent run per sweep.

The database is `mlflow.db` in the project root, unless MLFLOW_TRACKING_URI is set; `mlflow ui` reads it. Stages after
the training add their results to its run.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import logging
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hdsp.base.errors import InputError
from hdsp.base.files import replacing
from hdsp.base.messages import one_line, without_password

from .config import parse_overrides
from .folders import Folders, in_short, project_root, read_json
from .run_view import show_results
from .started_by import has_ended, this_process

EXPERIMENT = "hdsp"
PARENT_VARIABLE = "HDSP_MLFLOW_PARENT_RUN"
#: File that ties a trained abstraction to its run.
RUN_FILE = ("models", "training", "mlflow_run.json")
#: Tag with the process behind a run.
PROCESS = "mlflow.process"  # the page of a run hides tags that begin so
#: Longest name of a run.
LONGEST = 120
#: Longest reason in a message, in characters.
_LONGEST_REASON = 200

os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")


@dataclass(frozen=True)
class RunRecord:
    """Description of a training for its run.

    Attributes:
        name: name in the list of runs; it tells what differs.
        parameters: values that matter, with dotted names.
        tags: data hashes and similar values.
        texts: files by name: the whole configuration, overrides.
        system_metrics: whether load and memory of the machine are recorded.
    """

    name: str
    parameters: Mapping[str, Any]
    tags: Mapping[str, str] = field(default_factory=dict)
    texts: Mapping[str, str] = field(default_factory=dict)
    system_metrics: bool = False


def connect() -> Any:
    """Returns the mlflow module, with tracking address and experiment set.

    Addresses are absolute and belong to the repository instead of the working folder, because `dvc exp run --temp`
    works in a copy and removes it afterwards.

    Raises:
        InputError: the database is damaged or cannot be written, or no server answers.
    """
    import mlflow

    # It logs errors with their tracebacks before it raises them.
    logging.getLogger("mlflow.store.db.utils").setLevel(logging.CRITICAL)
    root = project_root().resolve()
    local = not os.environ.get("MLFLOW_TRACKING_URI")
    address = f"sqlite:///{root / 'mlflow.db'}" if local else os.environ["MLFLOW_TRACKING_URI"]
    try:
        if local:
            mlflow.set_tracking_uri(address)
        with _one_at_a_time(root / ".mlflow.lock") if local else _few_retries():
            if local and not (root / "mlflow.db").exists():
                _make_database(mlflow, root / "mlflow.db")
            if mlflow.get_experiment_by_name(EXPERIMENT) is None:
                # A server chooses its own artifact location.
                mlflow.create_experiment(EXPERIMENT, (root / "mlartifacts").as_uri() if local else None)
        show_results(mlflow, mlflow.set_experiment(EXPERIMENT))
    except Exception as error:  # databases, servers and their drivers have errors of many kinds
        first: BaseException = error
        while (cause := first.__cause__ or first.__context__) is not None:
            first = cause
        reason = without_password(one_line(first))[:_LONGEST_REASON]
        raise InputError(f"cannot use MLflow at {without_password(address)}: {reason}") from error
    return mlflow


def _make_database(mlflow: Any, path: Path) -> None:
    """Makes an empty database, which is whole or absent: MLflow's migrations cannot go on after an interruption."""
    with tempfile.TemporaryDirectory(prefix="mlflow-") as folder:
        made = Path(folder) / path.name
        client = mlflow.MlflowClient(f"sqlite:///{made}")
        client.search_experiments()
        client._tracking_client.store.engine.dispose()  # nothing is left in a journal
        with replacing(path) as temporary:
            shutil.copyfile(made, temporary)


@contextlib.contextmanager
def _few_retries() -> Iterator[None]:
    """Lets the first question to a server fail within seconds; MLflow would repeat it for minutes."""
    name = "MLFLOW_HTTP_REQUEST_MAX_RETRIES"
    given = os.environ.get(name)
    os.environ.setdefault(name, "2")
    try:
        yield
    finally:
        if given is None:
            os.environ.pop(name, None)


@contextlib.contextmanager
def run(record: RunRecord) -> Iterator[Any]:
    """Yields the mlflow module inside a new run; a sweep's parent becomes its parent."""
    mlflow = connect()
    end_abandoned(mlflow)
    tags = {**git_tags(), PROCESS: this_process(), **record.tags}
    if parent := os.environ.get(PARENT_VARIABLE):
        tags["mlflow.parentRunId"] = parent
    if experiment := os.environ.get("DVC_EXP_NAME"):
        tags["dvc.experiment"] = experiment
    with mlflow.start_run(run_name=shortened(record.name), tags=tags, log_system_metrics=record.system_metrics):
        mlflow.log_params(record.parameters)
        texts = dict(record.texts)
        if difference := git_diff():
            texts["git.diff"] = difference
        for name, text in texts.items():
            mlflow.log_text(text, name)
        yield mlflow


def keep_run(folders: Folders, run_id: str, model_id: str | None, weights: str) -> None:
    """Notes the run behind a trained abstraction, for later stages."""
    with replacing(folders.write(*RUN_FILE)) as path:
        path.write_text(json.dumps({"run": run_id, "model": model_id, "weights": weights}) + "\n", encoding="utf-8")


def add_results(
    folders: Folders, weights: str | None, metrics: Mapping[str, float | None], files: Sequence[Path], place: str
) -> None:
    """Adds metrics and files to the run behind the judged abstraction, if it is known.

    Args:
        folders: stage folders; the run's note is among the inputs.
        weights: checksum of the judged weights, as from `pipeline.abstractions.trained_weights`.
        metrics: by name; None is left out.
        files: the stage's reports.
        place: folder for the files among the run's artifacts.
    """
    note = folders.read(*RUN_FILE)
    if weights is None or not note.is_file():
        return
    known = read_json(note)
    if known["weights"] != weights:
        return  # the abstraction comes from elsewhere, for example from a cache, or is another one than the trained one
    mlflow = connect()
    with contextlib.suppress(mlflow.MlflowException):  # the run may have been deleted
        values = {name: float(value) for name, value in metrics.items() if value is not None}
        mlflow.log_metrics(values, run_id=known["run"], model_id=known["model"])
        for file in files:
            mlflow.log_artifact(str(file), place, run_id=known["run"])


@contextlib.contextmanager
def sweep(overrides: Sequence[str], key: str | None = None) -> Iterator[None]:
    """Opens a parent run; runs started inside become its children, also in other processes.

    Args:
        overrides: the sweep in words.
        key: place of a sweep that may be continued; it keeps its parent. None = `hydra.sweep.dir`, if it is given.
    """
    mlflow = connect()
    end_abandoned(mlflow)
    words, client = " ".join(overrides), mlflow.MlflowClient()
    varied = [str(found.input_line) for found in parse_overrides(overrides) if found.is_sweep_override()]
    name = shortened(f"sweep {in_short(varied or overrides)}")
    key = key or next((word for word in overrides if word.startswith("hydra.sweep.dir=")), "")
    tags = {**git_tags(), "sweep": words, "sweep.key": key, PROCESS: this_process()}
    begun = _runs(mlflow, f"tags.`sweep.key` = '{key}'") if key and "'" not in key else []
    with mlflow.start_run(begun[0].info.run_id if begun else None, run_name=name, tags=tags) as parent:
        parent_id = parent.info.run_id
    # The parent is closed while its children run, because they are separate runs in this or other processes.
    client.update_run(parent_id, status="RUNNING")
    os.environ[PARENT_VARIABLE] = parent_id
    status = "FAILED"
    try:
        yield
        status = "FINISHED"
    finally:
        os.environ.pop(PARENT_VARIABLE, None)
        client.set_terminated(parent_id, status)


def end_abandoned(mlflow: Any) -> None:
    """Gives the status KILLED to runs whose process on this machine has ended without an end of the run."""
    for run in _runs(mlflow, "attributes.status = 'RUNNING'"):
        if has_ended(run.data.tags.get(PROCESS, "")):
            mlflow.MlflowClient().set_terminated(run.info.run_id, "KILLED")


def _runs(mlflow: Any, which: str) -> list[Any]:
    return mlflow.search_runs(experiment_names=[EXPERIMENT], filter_string=which, output_format="list")


def shortened(name: str) -> str:
    """A name that fits into a list."""
    return name if len(name) <= LONGEST else f"{name[: LONGEST - 4]} ..."


def git_tags() -> dict[str, str]:
    """Returns the working tree's commit, and whether files differ from it; empty outside git."""
    try:
        commit = _git("rev-parse", "HEAD")
        return {"git.commit": commit, "git.dirty": str(bool(_git("status", "--porcelain", "-uno"))).lower()}
    except (OSError, subprocess.CalledProcessError):
        return {}


def git_diff() -> str:
    """Returns the differences of the code's working tree from its commit; empty without any, or outside git."""
    try:
        return _git("diff", "HEAD", "--", ".", ":(exclude)reports", ":(exclude)dvc.lock")
    except (OSError, subprocess.CalledProcessError):
        return ""


def _git(*arguments: str) -> str:
    return subprocess.run(["git", *arguments], capture_output=True, text=True, check=True).stdout.strip()


@contextlib.contextmanager
def _one_at_a_time(path: Path) -> Iterator[None]:
    """Serialises the creation of database and experiment."""
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
