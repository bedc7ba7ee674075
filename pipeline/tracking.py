"""MLflow: one experiment, one run per training, one parent run per sweep.

The database is `mlflow.db` in the project's root, unless MLFLOW_TRACKING_URI says otherwise; `mlflow ui` reads it.
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
    """The mlflow module, with tracking address and experiment set.

    The addresses are absolute, and belong to the repository and not to the working folder: `dvc exp run --temp` works
    in a copy that is removed afterwards.
    """
    import mlflow

    logging.getLogger("mlflow.store.db.utils").setLevel(logging.WARNING)
    root = project_root().resolve()
    local = not os.environ.get("MLFLOW_TRACKING_URI")
    if local:
        mlflow.set_tracking_uri(f"sqlite:///{root / 'mlflow.db'}")
    with _one_at_a_time(root / ".mlflow.lock") if local else contextlib.nullcontext():
        if mlflow.get_experiment_by_name(EXPERIMENT) is None:
            # A server chooses its own place for artifacts.
            mlflow.create_experiment(EXPERIMENT, (root / "mlartifacts").as_uri() if local else None)
    mlflow.set_experiment(EXPERIMENT)
    return mlflow


@contextlib.contextmanager
def run(name: str, parameters: Mapping[str, Any], tags: Mapping[str, str]) -> Iterator[Any]:
    """A run with its parameters and tags, inside the sweep's parent if there is one; yields the mlflow module.

    Args:
        name: shown in the list of runs.
        parameters: one level, dotted names (`pipeline.config.flatten`).
        tags: data hashes and the like; git commit and DVC experiment are added here.
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
    """A parent run; runs started inside, also in other processes, become its children."""
    mlflow = connect()
    tags = {**git_tags(), "sweep": " ".join(overrides)}
    with mlflow.start_run(run_name="sweep " + " ".join(overrides), tags=tags) as parent:
        parent_id = parent.info.run_id
    # Closed again while the children run: they are separate runs of this or of other processes.
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
    """Commit of the working tree, and whether files differ from it; empty outside of git."""
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
    """Two processes that create the database at the same time would break its migrations."""
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
