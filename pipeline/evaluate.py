"""Stage `evaluate`: agreement between each abstraction and the detailed planner, on each set (the paper's Table I)."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hdsp.base.errors import InputError
from hdsp.base.files import replacing

from . import tracking
from .abstractions import available, task_predictor, trained_weights
from .config_types import Config
from .stage import Folders, run_stage, write_json
from .task_sets import read_evaluation_set

if TYPE_CHECKING:
    from hdsp.labels.tasks import TaskSet


def evaluate(config: Config, folders: Folders) -> None:
    from hdsp.labels.evaluation import COLUMNS, evaluate_set, predict, rows
    from hdsp.viz import save_example_patches, save_quality_bars, save_reliability

    model = config.evaluation.model
    methods = available(config.evaluation.methods, config.robot)
    if not methods:
        wanted = ", ".join(config.evaluation.methods)
        raise InputError(f"evaluation.methods: none of {wanted} exists for {config.robot.name}")
    predictors = {name: task_predictor(name, config, folders, model) for name in methods}
    weights = trained_weights(methods, folders, model)  # before a training replaces them
    sets: dict[str, Any] = {}
    example = None
    for name, entry in config.evaluation.sets.items():
        tasks, reason = read_evaluation_set(name, entry, config, folders)
        paper = entry.paper
        if tasks is None:
            print(f"{name}: skipped, {reason}")
            sets[name] = {"available": False, "paper": paper, "reason": reason}
            continue
        figures = evaluate_set(predictors, tasks) | {"calibration": calibration(predictors, tasks)}
        sets[name] = {"available": True, "paper": paper, **figures}
        for method, values in figures["methods"].items():
            accuracy, error = values["feasibility_accuracy"], values["cost_error"]
            print(f"{name}, {method}: {100 * accuracy:.2f} % feasibility correct, cost error {_digits(error)}")
        example = tasks if example is None else example
    if example is None:
        raise InputError("no tasks: " + "; ".join(f"{name}: {values['reason']}" for name, values in sets.items()))

    reports = [folders.write("reports", f"abstraction_quality.{suffix}") for suffix in ("json", "csv")]
    write_json(reports[0], {"sets": sets})
    with replacing(reports[1]) as path, path.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows(sets))
    save_quality_bars(sets, folders.write("reports", "figures", "abstraction_quality.png"))
    save_reliability(sets, folders.write("reports", "figures", "reliability.png"))
    tracking.add_results(folders, weights, table_one(sets), reports, "evaluation")
    judged = predict(next(iter(predictors.values())), example)
    picture = folders.write("reports", "figures", "example_patches.png")
    save_example_patches(example, judged, picture, config.evaluation.examples, config.robot)


def table_one(sets: Mapping[str, Any]) -> dict[str, float | None]:
    """Returns Table I and calibration errors with flat names, for MLflow."""
    found: dict[str, float | None] = {}
    for name, values in sets.items():
        for method, figures in values.get("methods", {}).items():
            for metric in ("feasibility_accuracy", "cost_error"):
                found[f"table 1/{name}/{method}/{metric}"] = figures[metric]
        for method, figures in values.get("calibration", {}).items():
            found[f"calibration/{name}/{method}/ece"] = figures["ece"]
    return found


def calibration(predictors: Mapping[str, Any], tasks: TaskSet) -> dict[str, Any]:
    """Returns `hdsp.learning.calibration.calibration_figures` for each method with probabilities."""
    return {
        name: predictor.calibration_figures(tasks)
        for name, predictor in predictors.items()
        if hasattr(predictor, "calibration_figures")
    }


def _digits(value: float | None) -> str:
    return "none" if value is None else f"{value:.4f}"


if __name__ == "__main__":
    run_stage(evaluate, "evaluate")
