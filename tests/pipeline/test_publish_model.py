"""Publishing a trained abstraction in the package: the folder and its model card."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

import hdsp
from hdsp.labels.shards import write_shard
from hdsp.labels.tasks import TaskSet
from hdsp.learning import LearnedAbstraction, Provenance, train
from hdsp.learning.networks import build_network
from hdsp.robot.robot import Robot
from pipeline.config import configure
from pipeline.label_places import shards_place
from pipeline.model_card import model_card
from pipeline.publish_model import figures_of, markers, publish_model
from pipeline.stage import Folders
from pipeline.train import notes
from tests.learning.synthetic import synthetic_tasks, tiny_config

pytestmark = pytest.mark.pipeline


@pytest.fixture(scope="module")
def sets() -> dict[str, TaskSet]:
    return {"val": synthetic_tasks(32, seed=1), "random": synthetic_tasks(24, seed=2)}


def test_the_folder_holds_a_calibrated_model_and_a_card_of_its_figures(sets, tmp_path, monkeypatch, capsys):
    config, folders = configure(["profile=tiny", "trainer.epochs=5"]), Folders(tmp_path, tmp_path)
    for name, tasks in sets.items():
        place = shards_place(config, tmp_path, name)
        write_shard(place / "0.h5", tasks, {"labels_hash": "0" * 64, "maps": len(tasks)})
    known = Provenance.of(config.robot, "", **notes(config, synthetic_tasks(64)))
    source = train(tiny_config(epochs=5), synthetic_tasks(64), sets, tmp_path, provenance=known, quiet=True).model_dir
    for name in ("train", "val"):
        record = folders.write("data", "label_runs", f"{name}.jsonl")
        record.write_text(json.dumps({"seconds": 3600.0, "workers": 2}) + "\n")
    page = tmp_path / "own-robot.md"
    page.write_text("\n".join(["before", *markers("momaro"), "after"]))
    monkeypatch.setattr("pipeline.publish_model.PAGE", page)
    publish_model(config, folders, str(source))
    folder = tmp_path / "hdsp/learning/shipped/momaro"
    stored, card = json.loads((folder / "config.json").read_text()), (folder / "README.md").read_text()
    judged, _ = hdsp.load_abstraction(folder, "momaro").predict(sets["random"].heights, sets["random"].goals)
    accuracy = (judged == sets["random"].feasible).mean()
    assert stored["metrics"]["feasibility_accuracy/random"] == pytest.approx(accuracy)
    assert stored["calibration"]["tasks"] == sets["val"].feasible.size
    for part in ("`compact`", "profile", "Without data: ", "never saw", "ECE", f"{100 * accuracy:.2f} %"):
        assert part in card
    assert "dvc exp run -S profile=tiny -S robot=momaro -S model=compact -S trainer.epochs=5 " in card
    assert "random: " in capsys.readouterr().out
    for text in (card, shown := page.read_text()):
        assert "Its labels took 4.0 core hours. Training took 0.0 hours." in text
    assert shown.startswith("before") and shown.endswith("after")
    assert f"| random | {sets['random'].feasible.size} " in shown and f"{100 * accuracy:.2f} %" in shown


def test_the_error_of_costs_for_planning_is_among_the_figures(sets):
    sizes = {"width": 8, "hidden": 16, "features": 8, "context": 8, "feet": 16, "head": 32, "planning": True}
    model = configure(["model=footprint"]).model
    settings = replace(model, options={**model.options, **sizes})
    torch.manual_seed(0)
    abstraction = LearnedAbstraction(build_network(settings), settings, Provenance.of(Robot.load("momaro"), ""))
    tasks = sets["random"]
    planned = replace(tasks, planning_cost=0.7 * tasks.cost)
    figures = figures_of(abstraction, planned)
    feasible, cost = abstraction.for_planning().predict(tasks.heights, tasks.goals)
    both = feasible & tasks.feasible
    assert both.any()
    expected = np.abs(cost - planned.planning_cost)[both].mean()
    assert figures["planning_cost_error"] == figures["categories"]["block"]["planning_cost_error"]
    assert figures["planning_cost_error"] == pytest.approx(expected)
    assert figures_of(abstraction, tasks)["planning_cost_error"] is None


def test_a_card_repeats_all_trainings_that_the_weights_went_through(sets, tmp_path):
    """A network without foot ways is trained, and trained on; then one with them begins with its weights."""
    sizes = {f"model.options.{name}": 8 for name in ("hidden", "features", "context", "feet", "head", "steps")}
    base = ["profile=tiny", "model=footprint", "model.options.width=16", *(f"{k}={v}" for k, v in sizes.items())]
    trainings = [
        ["model.options.foot_ways=null", "trainer.epochs=3"],
        ["model.options.foot_ways=null", "trainer.epochs=4", f"trainer.initial={tmp_path / 'first'}"],
        ["trainer.epochs=5", f"trainer.initial={tmp_path / 'second'}"],
    ]
    for folder, overrides in zip(("first", "second", "third"), trainings, strict=True):
        config = configure([*base, *overrides])
        known = Provenance.of(config.robot, "", **notes(config, synthetic_tasks(8)))
        torch.manual_seed(0)
        saved = LearnedAbstraction(build_network(config.model), config.model, known)
        saved.save_pretrained(tmp_path / folder, picture=False)
    assert known.notes["initial"]["model"] == {"options": {"foot_ways": None}}
    assert "model" not in known.notes["initial"]["initial"]
    saved = saved.calibrated(sets["val"])
    figures = {name: figures_of(saved, tasks) | {"paper": None} for name, tasks in sets.items()}
    card = model_card(saved, config.robot, "float32", figures, {}, configure(base), "momaro", {})
    for begun in ("It", "That training"):
        assert card.count(f"{begun} started from the weights of an earlier training") == 1
    commands = [line for line in card.splitlines() if line.startswith(("dvc", "mv", "python -m pipeline.train"))]
    assert len(commands) == 5
    assert "model.options.foot_ways=null" in commands[0] and "trainer.epochs=3" in commands[0]
    assert commands[1].endswith("/first") and commands[3].endswith("/second")
    for command, epochs in ((commands[2], 4), (commands[4], 5)):
        assert f"trainer.epochs={epochs}" in command and ("foot_ways=null" in command) == (epochs == 4)
