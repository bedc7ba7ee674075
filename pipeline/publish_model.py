"""Puts a trained abstraction into the package, with its model card.

    python -m pipeline.publish_model models/abstraction

A folder with an unfinished training (`models/training`) is also accepted; the overrides then describe the trained
model. The abstraction is calibrated on the validation set. All sets in `evaluation.sets` evaluate it in its final form,
with rounded weights. Output is `hdsp/learning/shipped/ROBOT/`, or ROBOT-NAME with `runtime.variant=NAME`; outside of a
checkout `models/published/ROBOT/`. With overrides, add `runtime.outputs=.`; otherwise the output lands in outputs/.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.settings import FileName, checked, load_settings
from hdsp.robot.robot import Robot

from .command_line import PACKAGE
from .config import plain
from .config_types import Config
from .label_places import shards_place
from .model_card import effort, model_card
from .publish_pages import put_between_markers
from .stage import Folders, read_json, run_stage
from .tables import markdown, percent
from .task_sets import read_evaluation_set, read_set

if TYPE_CHECKING:
    from hdsp.labels.tasks import TaskSet
    from hdsp.learning import LearnedAbstraction
    from hdsp.learning.abstraction import Precision

#: Page that shows effort and quality of a robot's shipped abstraction, if it has the markers.
PAGE = Path("docs/own-robot.md")
#: Place of the result: in a checkout within the package, elsewhere among the models.
SHIPPED, PUBLISHED = ("hdsp", "learning", "shipped"), ("models", "published")
#: Weights above this number of bytes are rounded to half floats.
LARGEST = 3_000_000
#: File in the folder of an unfinished training.
CHECKPOINT = "checkpoints/best.ckpt"
#: Cost error levels on the card.
ERROR_LEVELS = (0.5, 0.9, 0.99, 1.0)


@checked
class _NotedSplits:
    """Validation splits in the notes of a saved abstraction, which may come from elsewhere: names, no paths."""

    val_splits: tuple[FileName, ...]


def publish_model(config: Config, folders: Folders, source: str) -> None:
    from hdsp.learning.abstraction import LearnedAbstraction
    from hdsp.learning.architectures import network_class

    robot = config.robot
    hardware = config.runtime.hardware
    hardware.apply_threads()
    network_class(config.model.architecture)  # code that the configuration names may be run
    if (Path(source) / CHECKPOINT).is_file():
        trained = in_progress(Path(source), robot, config, folders)
    else:
        trained = LearnedAbstraction.from_pretrained(source, robot, hardware)
    size = sum(value.nbytes for value in trained.network.state_dict().values())
    precision: Precision = "float16" if size > LARGEST else "float32"
    with tempfile.TemporaryDirectory() as folder:
        trained.save_pretrained(Path(folder) / "model", precision, picture=False)
        abstraction = LearnedAbstraction.from_pretrained(Path(folder) / "model", robot, hardware)

    val = _validation(trained.provenance.notes.get("trainer") or plain(config.trainer), config, folders)
    abstraction = abstraction.calibrated(val)
    abstraction.edges_threshold = config.evaluation.edges_threshold
    figures = {"val": figures_of(abstraction, val)}
    missing = {}
    for name, entry in config.evaluation.sets.items():
        tasks, reason = read_evaluation_set(name, entry, config, folders)
        if tasks is None:
            missing[name] = reason
            continue
        figures[name] = figures_of(abstraction, tasks) | {"paper": entry.paper}
    abstraction.metrics = {
        f"{metric}/{name}": values[metric]
        for name, values in figures.items()
        for metric in ("feasibility_accuracy", "cost_error", "ece")
        if values[metric] is not None
    }
    variant = config.runtime.variant
    name = robot.name + (f"-{variant}" if variant else "")
    target = folders.write(*(SHIPPED if PACKAGE == "pipeline" else PUBLISHED), name)
    spent = hours(Path(source), abstraction, folders)
    card = model_card(abstraction, robot, precision, figures, missing, config, name, spent)
    abstraction.save_pretrained(target, precision, card)
    begin, end = markers(name)
    if PAGE.is_file() and begin in PAGE.read_text(encoding="utf-8"):
        put_between_markers(PAGE, f"{summary(abstraction, figures, spent)}\n", begin, end)
    size = (target / "model.safetensors").stat().st_size / 1e6
    print(f"{target}: {abstraction.model.architecture}, {precision}, {size:.2f} MB")
    for name, values in figures.items():
        error = "none" if values["cost_error"] is None else f"{values['cost_error']:.4f}"
        print(f"{name}: {100 * values['feasibility_accuracy']:.2f} %, cost error {error}, ECE {values['ece']:.4f}")


def hours(source: Path, abstraction: LearnedAbstraction, folders: Folders) -> dict[str, float]:
    """Returns hours where their records exist: `labels`, core hours; `training`, `last` after an earlier training."""
    notes = abstraction.provenance.notes
    trainer, found = notes.get("trainer") or {}, {}
    splits = [*trainer.get("splits", []), *trainer.get("val_splits", [])]
    records = [folders.read("data", "label_runs", f"{name}.jsonl") for name in splits]
    if records and all(path.is_file() for path in records):
        lines = [json.loads(line) for path in records for line in path.read_text(encoding="utf-8").splitlines()]
        found["labels"] = sum(line["seconds"] * line["workers"] for line in lines) / 3600
    kind = "last" if "initial" in notes else "training"
    for folder in (source, source.parent, source.parent / "training"):
        if (history := folder / "history.json").is_file():
            found[kind] = sum(row["seconds"] for row in read_json(history)) / 3600
    return found


def markers(name: str) -> tuple[str, str]:
    """Markers around the summary of an abstraction on `PAGE`."""
    return f"<!-- {name}: written by `python -m pipeline.publish_model` -->", f"<!-- end of the network {name} -->"


def summary(
    abstraction: LearnedAbstraction, figures: Mapping[str, Mapping[str, Any]], spent: Mapping[str, float]
) -> str:
    """Effort and quality as Markdown."""
    rows = [
        (name, f"{values['tasks']:,}", percent(values["feasibility_accuracy"]), *(
            "–" if values[key] is None else f"{values[key]:.4f}" for key in ("cost_error", "planning_cost_error", "ece")
        ))
        for name, values in figures.items()
    ]  # fmt: skip
    header = ("set", "tasks", "feasibility correct", "cost error", "planning cost error", "ECE")
    parts = []
    if maps := abstraction.provenance.notes.get("maps"):
        parts.append(f"The network learned from {maps:,} maps.")
    return " ".join([*parts, effort(spent)]).strip() + "\n\n" + markdown(header, rows)


def in_progress(source: Path, robot: Robot, config: Config, folders: Folders) -> LearnedAbstraction:
    """Loads the best epoch so far from an unfinished training of `config.model`."""
    from hdsp.learning import LearnedAbstraction, Provenance
    from hdsp.learning.checkpoints import read_checkpoint
    from hdsp.learning.networks import build_network

    from .train import folder_hash

    model = config.model
    network = build_network(model)
    state = read_checkpoint(source / CHECKPOINT)
    prefix = "network."
    weights = {key.removeprefix(prefix): value for key, value in state["state_dict"].items() if key.startswith(prefix)}
    try:
        network.load_state_dict(weights)
    except RuntimeError as error:
        raise InputError(f"{source / CHECKPOINT}: does not fit {model.architecture}: {error}".splitlines()[0]) from None
    hashes = [folder_hash(shards_place(config, folders.inputs, name)) for name in config.trainer.splits]
    epoch = f"epoch {state['epoch'] + 1} of {config.trainer.epochs}, the best of those done when it was published"
    return LearnedAbstraction(
        network, model, Provenance.of(robot, " ".join(hashes), profile=config.profile, epoch=epoch)
    )


def _validation(trainer: Mapping[str, Any], config: Config, folders: Folders) -> TaskSet:
    """Validation maps, which selected the training's epoch."""
    from hdsp.labels.tasks import TaskSet

    sets = []
    noted = load_settings(
        _NotedSplits, {"val_splits": trainer.get("val_splits") or ["val"]}, "provenance.notes.trainer"
    )
    for name in noted.val_splits:
        tasks, reason = read_set(shards_place(config, folders.inputs, name))
        if tasks is None:
            raise InputError(f"cannot calibrate: {reason}")
        sets.append(tasks)
    return TaskSet.concatenate(sets)


def figures_of(abstraction: LearnedAbstraction, tasks: TaskSet) -> dict[str, Any]:
    """Returns all figures on the card for a set.

    These are the figures from `hdsp.labels.evaluation.evaluate_set` and from the calibration, `categories` with the
    same figures per category, and `false_feasible`, `false_infeasible` (shares of tasks) and `cost_errors`.
    """
    from hdsp.labels.evaluation import evaluate_set, predict

    # One evaluation serves all figures, because sets are large and networks may be slow.
    feasible, cost = predict(abstraction, tasks)
    whole = evaluate_set({"it": _Answers(abstraction, feasible, cost)}, tasks)
    both = feasible & tasks.feasible
    errors = np.abs(cost - tasks.cost)[both]
    return {
        **{key: whole[key] for key in ("maps", "tasks", "feasible")},
        **whole["methods"]["it"],
        **abstraction.calibration_figures(tasks),
        "false_feasible": float((feasible & ~tasks.feasible).mean()),
        "false_infeasible": float((~feasible & tasks.feasible).mean()),
        "cost_errors": {level: float(np.quantile(errors, level)) for level in ERROR_LEVELS} if errors.size else {},
        "categories": {
            name: {"maps": part["maps"], **part["methods"]["it"]} for name, part in whole["categories"].items()
        },
    }


class _Answers:
    """Predictor with precomputed answers; its costs for planning are those of the abstraction."""

    def __init__(self, abstraction: LearnedAbstraction, feasible: np.ndarray, cost: np.ndarray):
        self.answers = feasible, cost
        self.predicts_planning_cost = abstraction.predicts_planning_cost
        self.for_planning = abstraction.for_planning

    def predict(self, patches: np.ndarray, goals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.answers


if __name__ == "__main__":
    run_stage(publish_model, "publish_model", positional=("folder",))
