"""MLflow tracking: one experiment, one run per training, one parent run per sweep.

The database is `mlflow.db` in the project root, unless MLFLOW_TRACKING_URI is set; `mlflow ui` reads it.
"""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.stage import project_root

EXPERIMENT = "hdsp"
PARENT_VARIABLE = "HDSP_MLFLOW_PARENT_RUN"

os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")


def connect() -> Any:
    """Returns the mlflow module, with tracking address and experiment set.

    Addresses are absolute and belong to the repository instead of the working folder, because `dvc exp run --temp`
    works in a copy and removes it afterwards.
    """
    import mlflow

    logging.getLogger("mlflow.store.db.utils").setLevel(logging.WARNING)
    root = project_root().resolve()
    local = not os.environ.get("MLFLOW_TRACKING_URI")
    if local:
        mlflow.set_tracking_uri(f"sqlite:///{root / 'mlflow.db'}")
    with _one_at_a_time(root / ".mlflow.lock") if local else contextlib.nullcontext():
        if mlflow.get_experiment_by_name(EXPERIMENT) is None:
            # A server chooses its own artifact location.
            mlflow.create_experiment(EXPERIMENT, (root / "mlartifacts").as_uri() if local else None)
    mlflow.set_experiment(EXPERIMENT)
    return mlflow


@contextlib.contextmanager
def run(name: str, parameters: Mapping[str, Any], tags: Mapping[str, str]) -> Iterator[Any]:
    """Yields the mlflow module inside a run with parameters and tags; a sweep's parent becomes its parent.

    Args:
        name: name in the list of runs.
        parameters: one level, dotted names (`pipeline.config.flatten`).
        tags: data hashes and similar values; git commit and DVC experiment are added here.
    """
    mlflow = connect()
    tags = {**git_tags(), **tags}
    if parent := os.environ.get(PARENT_VARIABLE):
        tags["mlflow.parentRunId"] = parent
    if experiment := os.environ.get("DVC_EXP_NAME"):
        tags["dvc.experiment"] = experiment
    with mlflow.start_run(run_name=name, tags=tags):
        mlflow.log_params(parameters)
        yield mlflow


@contextlib.contextmanager
def sweep(overrides: Sequence[str]) -> Iterator[None]:
    """Opens a parent run; runs started inside become its children, also in other processes."""
    mlflow = connect()
    tags = {**git_tags(), "sweep": " ".join(overrides)}
    with mlflow.start_run(run_name="sweep " + " ".join(overrides), tags=tags) as parent:
        parent_id = parent.info.run_id
    # The parent is closed while its children run, because they are separate runs in this or other processes.
    client = mlflow.MlflowClient()
    client.update_run(parent_id, status="RUNNING")
    os.environ[PARENT_VARIABLE] = parent_id
    status = "FAILED"
    try:
        yield
        status = "FINISHED"
    finally:
        os.environ.pop(PARENT_VARIABLE, None)
        client.set_terminated(parent_id, status)


def git_tags() -> dict[str, str]:
    """Returns the working tree's commit, and whether files differ from it; empty outside git."""
    try:
        commit = _git("rev-parse", "HEAD")
        return {"git.commit": commit, "git.dirty": str(bool(_git("status", "--porcelain", "-uno"))).lower()}
    except (OSError, subprocess.CalledProcessError):
        return {}


def _git(*arguments: str) -> str:
    here = Path(__file__).parent
    return subprocess.run(["git", *arguments], cwd=here, capture_output=True, text=True, check=True).stdout.strip()


@contextlib.contextmanager
def _one_at_a_time(path: Path) -> Iterator[None]:
    """Serialises database creation: two processes at the same time would break its migrations."""
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
