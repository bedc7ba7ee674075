"""Put a trained abstraction into the package, with its model card.

    python -m pipeline.publish_model models/abstraction

The folder of a training in progress (`models/training`) does too; its overrides say what is being trained.
It is calibrated on the validation set and judged on every set of `evaluation.sets` as it will be loaded, after its
weights were rounded. Writes `hdsp/learning/shipped/ROBOT/`, or ROBOT-NAME with `runtime.variant=NAME`. With overrides add
`runtime.outputs=.`, or it lands in outputs/.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from omegaconf import DictConfig

from hdsp.base.errors import InputError
from hdsp.robot.robot import Robot
from pipeline.config import plain
from pipeline.label import shards_place
from pipeline.model_card import model_card
from pipeline.stage import Folders, run_stage
from pipeline.task_sets import read_evaluation_set, read_set

if TYPE_CHECKING:
    from hdsp.labels.tasks import TaskSet
    from hdsp.learning import LearnedAbstraction

#: Bytes; larger weights are rounded to half floats.
LARGEST = 4_000_000
#: What a training in progress has in its folder.
CHECKPOINT = "checkpoints/best.ckpt"
#: Levels of the cost errors that the card states.
ERROR_LEVELS = (0.5, 0.9, 0.99, 1.0)


def publish_model(config: DictConfig, folders: Folders, source: str) -> None:
    from hdsp.learning.abstraction import LearnedAbstraction
    from hdsp.learning.hardware import HardwareSettings
    from hdsp.learning.network_settings import settings_from

    robot = Robot.load(plain(config.robot))
    hardware = settings_from(HardwareSettings, plain(config.runtime.hardware), "runtime.hardware")
    hardware.apply_threads()
    if (Path(source) / CHECKPOINT).is_file():
        trained = in_progress(Path(source), robot, config, folders)
    else:
        trained = LearnedAbstraction.from_pretrained(source, robot, hardware)
    size = sum(value.nbytes for value in trained.network.state_dict().values())
    precision = "float16" if size > LARGEST else "float32"
    with tempfile.TemporaryDirectory() as folder:
        trained.save_pretrained(Path(folder) / "model", precision)
        abstraction = LearnedAbstraction.from_pretrained(Path(folder) / "model", robot, hardware)

    val = _validation(trained.provenance.notes.get("trainer") or plain(config.trainer), config, folders)
    abstraction = abstraction.calibrated(val)
    figures = {"val": figures_of(abstraction, val)}
    missing = {}
    for name, entry in plain(config.evaluation.sets).items():
        tasks, reason = read_evaluation_set(name, entry, config, folders)
        if tasks is None:
            missing[name] = reason
            continue
        figures[name] = figures_of(abstraction, tasks) | {"paper": entry.get("paper")}
    abstraction.metrics = {
        f"{metric}/{name}": values[metric]
        for name, values in figures.items()
        for metric in ("feasibility_accuracy", "cost_error", "ece")
        if values[metric] is not None
    }
    variant = config.runtime.variant
    name = robot.name + (f"-{variant}" if variant else "")
    target = folders.write("hdsp", "learning", "shipped", name)
    card = model_card(abstraction, robot, precision, figures, missing, config, name)
    abstraction.save_pretrained(target, precision, beside={"README.md": card})
    size = (target / "model.safetensors").stat().st_size / 1e6
    print(f"{target}: {abstraction.model.architecture}, {precision}, {size:.2f} MB")
    for name, values in figures.items():
        error = "none" if values["cost_error"] is None else f"{values['cost_error']:.4f}"
        print(f"{name}: {100 * values['feasibility_accuracy']:.2f} %, cost error {error}, ECE {values['ece']:.4f}")


def in_progress(source: Path, robot: Robot, config: DictConfig, folders: Folders) -> LearnedAbstraction:
    """The best epoch so far of the training of `config.model` in a folder that holds checkpoints."""
    import torch

    from hdsp.learning import LearnedAbstraction, Provenance
    from hdsp.learning.network_settings import settings_from
    from hdsp.learning.networks import ModelSettings, build_network
    from pipeline.train import folder_hash

    model = settings_from(ModelSettings, plain(config.model), "model")
    network = build_network(model)
    state = torch.load(source / CHECKPOINT, map_location="cpu", weights_only=False)
    prefix = "network."
    network.load_state_dict({k.removeprefix(prefix): v for k, v in state["state_dict"].items() if k.startswith(prefix)})
    hashes = [folder_hash(shards_place(config, folders.inputs, name)) for name in config.trainer.splits]
    epoch = f"epoch {state['epoch'] + 1} of {config.trainer.epochs}, the best of those done when it was published"
    return LearnedAbstraction(
        network, model, Provenance.of(robot, " ".join(hashes), profile=config.profile, epoch=epoch)
    )


def _validation(trainer: Mapping[str, Any], config: DictConfig, folders: Folders) -> TaskSet:
    """The maps by which the training chose its epoch."""
    from hdsp.labels.tasks import TaskSet

    sets = []
    for name in trainer.get("val_splits") or ["val"]:
        tasks, reason = read_set(shards_place(config, folders.inputs, name))
        if tasks is None:
            raise InputError(f"cannot calibrate: {reason}")
        sets.append(tasks)
    return TaskSet.concatenate(sets)


def figures_of(abstraction: LearnedAbstraction, tasks: TaskSet) -> dict[str, Any]:
    """All that the card says of a set: what `hdsp.labels.evaluation.evaluate_predictor` and the calibration return,
    `categories` with the same for each, and `false_feasible`, `false_infeasible` (shares of tasks), `cost_errors`."""
    from hdsp.labels.evaluation import evaluate_set, predict

    # Answers are computed once: a set may be large, and a network slow.
    feasible, cost = predict(abstraction, tasks)
    whole = evaluate_set({"it": _Answers(feasible, cost)}, tasks)
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
    """A predictor that was asked already."""

    def __init__(self, feasible: np.ndarray, cost: np.ndarray):
        self.answers = feasible, cost

    def predict(self, patches: np.ndarray, goals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.answers


if __name__ == "__main__":
    run_stage(publish_model, "publish_model", positional=("folder",))
