"""Publishing a trained abstraction in the package: the folder and its model card."""

import json

import pytest

import hdsp
from hdsp.labels.shards import read_tasks
from tests.pipeline.conftest import run_python, tiny

pytestmark = [pytest.mark.pipeline, pytest.mark.xdist_group("chain")]


def test_the_folder_holds_a_calibrated_model_and_a_card_of_its_figures(chain, tmp_path):
    source = chain / "models/abstraction"
    said = run_python("pipeline.publish_model", str(source), *tiny(chain), f"runtime.outputs={tmp_path}").stdout
    folder = tmp_path / "hdsp/learning/shipped/momaro"
    abstraction = hdsp.load_abstraction(folder, "momaro")
    config = json.loads((folder / "config.json").read_text())
    tasks = read_tasks(chain / "data/labels/random")
    judged, _ = abstraction.predict(tasks.heights, tasks.goals)
    accuracy = float((judged == tasks.feasible).mean())
    assert config["metrics"]["feasibility_accuracy/random"] == pytest.approx(accuracy, abs=0.02)
    assert config["calibration"]["tasks"] == 22 * len(read_tasks(chain / "data/labels/val"))
    card = (folder / "README.md").read_text()
    for part in ("`compact`", "profile", "Without data: ", "never saw", "ECE"):
        assert part in card
    assert f"{100 * config['metrics']['feasibility_accuracy/random']:.2f} %" in card
    assert "random: " in said
