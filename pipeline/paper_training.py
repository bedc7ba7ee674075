"""The paper's network, trained by its recipe: our curve beside the published one, in docs/architectures.md.

    python -m pipeline.paper_training

The run with `conf/experiment/klamt2019.yaml` in `outputs/paper` becomes `reports/klamt2019.json`. Without this run the
report stays unchanged. Page and picture come from the report alone. An unfinished training shows its finished epochs.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hdsp.base.errors import InputError

from .compare import PAGE, markers
from .config import compose
from .config_types import Config
from .publish_pages import put_between_markers
from .stage import Folders, read_json, run_stage, write_json
from .tables import markdown, percent

RUN = ("outputs", "paper")
#: History files of an unfinished and of a finished training.
HISTORIES = (("models", "training", "history.csv"), ("reports", "training_history.csv"))
#: Validation accuracy and cost error in the paper's figure, per epoch.
PUBLISHED = Path(__file__).with_name("paper_training.csv")
METRICS = ("feasibility_accuracy", "cost_error")


def paper_training(config: Config, folders: Folders) -> None:
    from hdsp.viz import save_training_beside

    report = folders.write("reports", "klamt2019.json")
    for parts in HISTORIES:
        history = folders.read(*RUN, *parts)
        if history.is_file():
            write_json(report, {"epochs": read_history(history)})
            break
    if not report.is_file():
        command = "python -m pipeline.train experiment=klamt2019 runtime.outputs=outputs/paper"
        raise InputError(f"{report} is missing, and there is no training yet: {command}")
    ours, theirs = read_json(report)["epochs"], read_published()
    curves = [{"epoch": row["epoch"], **{metric: row[f"{metric}/val"] for metric in METRICS}} for row in ours]
    save_training_beside(
        curves, theirs, folders.write("docs", "figures", "klamt2019_training.png"), "Klamt & Behnke 2019"
    )
    page = folders.outputs / "docs" / PAGE
    if page.is_file():
        put_between_markers(
            page, table(ours, theirs, compose(["experiment=klamt2019"]).trainer.epochs) + "\n", *begin_end()
        )


def begin_end() -> tuple[str, str]:
    """Markers around the table on the page."""
    begin, end = (line.replace("pipeline.compare", "pipeline.paper_training") for line in markers("klamt2019"))
    return begin, end


def read_history(path: Path) -> list[dict[str, Any]]:
    """Rows from a `history.csv`; epochs count from 1."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = [{name: float(value) for name, value in row.items() if value} for row in csv.DictReader(file)]
    return [{**row, "epoch": int(row["epoch"]) + 1} for row in rows]


def read_published() -> list[dict[str, Any]]:
    """The paper's curve: `epoch`, `feasibility_accuracy`, `cost_error`."""
    with PUBLISHED.open(newline="", encoding="utf-8") as file:
        return [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]


def table(ours: Sequence[Mapping[str, Any]], theirs: Sequence[Mapping[str, Any]], planned: int) -> str:
    """Best epochs by validation, ours and the paper's, and our other sets in our best epoch."""

    def best(rows, accuracy, error):
        return min(rows, key=lambda row: 1 - row[accuracy] + row[error])

    def shown(row, suffix=""):
        return f"{percent(row[f'feasibility_accuracy{suffix}'])} / {row[f'cost_error{suffix}']:.4f}"

    chosen, published = best(ours, "feasibility_accuracy/val", "cost_error/val"), best(theirs, *METRICS)
    sets = sorted(name.partition("/")[2] for name in chosen if name.startswith("cost_error/"))
    rows = [
        ["paper, validation", str(len(theirs)), str(int(published["epoch"])), shown(published)],
        *([f"ours, {name}", str(len(ours)), str(chosen["epoch"]), shown(chosen, f"/{name}")] for name in sets),
    ]
    note = "" if len(ours) >= planned else f"\n\nThe training has done {len(ours)} of {planned} epochs so far."
    return markdown(["", "epochs", "best epoch", "feasibility correct / cost error there"], rows) + note


if __name__ == "__main__":
    run_stage(paper_training, "paper_training")
