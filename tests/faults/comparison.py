"""Results of a run without what differs by nature."""

from __future__ import annotations

import csv
import json
from pathlib import Path

#: Values by name that differ from run to run, beside all seconds: times, and numbers of runs in MLflow.
VOLATILE = "begun", "begun_at", "created", "time", "stamp", "run", "model_id", "speedup", "first_plan", "time_to_best"
#: Files and folders by name: records of runs with their times and folders; MLflow's database; pictures of times; places
#: for temporary files of libraries.
LEFT_OUT = {
    ".dvc",
    ".git",
    ".hydra",
    "__pycache__",
    "label_runs",
    "mlartifacts",
    "mlflow.db",
    ".mlflow.lock",
    "planning.png",
    "seconds",
    "tmp",
}


def contents(folder: Path) -> dict[str, object]:
    """Contents of all files in a folder by name, JSON and CSV without values that differ from run to run."""
    found: dict[str, object] = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not LEFT_OUT & set(path.relative_to(folder).parts):
            found[str(path.relative_to(folder))] = _read(path)
    return found


def _read(path: Path) -> object:
    if path.name == "mlflow_run.json":
        return json.loads(path.read_text())["weights"]
    if path.suffix == ".json":
        return _lasting(json.loads(path.read_text()))
    if path.suffix == ".csv":
        with path.open(newline="") as file:
            return [_lasting(row) for row in csv.DictReader(file)]
    return path.read_bytes()


def _lasting(value: object) -> object:
    if isinstance(value, dict):
        return {key: _lasting(own) for key, own in value.items() if not _differs(key)}
    return [_lasting(own) for own in value] if isinstance(value, list) else value


def _differs(name: str) -> bool:
    return name in VOLATILE or "seconds" in name.split("_")
