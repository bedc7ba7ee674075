"""Stage `report`: both paper tables beside ours, in reports/tables.md.

`reports/index.html` has them with pictures, paths in three dimensions, data and their hashes, in one file.
"""

from __future__ import annotations

from typing import Any

from hdsp.base.files import replacing

from .config_types import Config
from .html_report import write_html_report
from .stage import Folders, read_json, run_stage, write_json
from .tables import abstraction_quality_table, heuristic_table, random_task_table


def report(config: Config, folders: Folders) -> None:
    quality = read_json(folders.read("reports", "abstraction_quality.json"))
    planning = read_json(folders.read("reports", "planning.json"))
    training = read_json(folders.read("reports", "training.json"))
    tables = all_tables(quality, planning, training)
    with replacing(folders.write("reports", "tables.md")) as path:
        path.write_text(tables, encoding="utf-8")
    write_json(folders.write("reports", "summary.json"), summary(quality, planning))
    reports = {"abstraction_quality": quality, "planning": planning, "training": training}
    print(write_html_report(config, folders, reports))


def all_tables(quality: dict[str, Any], planning: dict[str, Any], training: dict[str, Any]) -> str:
    """Table I, Table II and, where the stage `plan` made them, the random tasks."""
    parts = [abstraction_quality_table(quality, training), heuristic_table(planning)]
    if "random" in planning:
        parts.append(random_task_table(planning["random"]))
    return "\n\n".join(parts) + "\n"


def summary(quality: dict[str, Any], planning: dict[str, Any]) -> dict[str, Any]:
    """Headline numbers for `dvc metrics show` and `dvc exp show`."""
    accuracy: dict[str, Any] = {}
    error: dict[str, Any] = {}
    for name, values in quality["sets"].items():
        if values["available"]:
            accuracy[name] = {method: m["feasibility_accuracy"] for method, m in values["methods"].items()}
            error[name] = {method: m["cost_error"] for method, m in values["methods"].items()}
    speedup = {
        heuristic: {f"W{float(weight):g}": values["speedup"] for weight, values in by_weight.items()}
        for heuristic, by_weight in planning["summary"].items()
        if heuristic != "geometric"
    }
    return {"feasibility_accuracy": accuracy, "cost_error": error, "speedup": speedup}


if __name__ == "__main__":
    run_stage(report, "report")
