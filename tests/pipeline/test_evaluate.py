"""Evaluation and the planning experiment on the tiny profile: contents of the reports."""

import csv
import json
from types import SimpleNamespace

import pytest

from hdsp.labels.shards import shard_paths
from pipeline import tracking
from pipeline.abstractions import trained_weights
from pipeline.stage import Folders
from tests.pipeline.conftest import run_python, tiny

pytestmark = [pytest.mark.pipeline, pytest.mark.xdist_group("chain")]

STATUSES = {"solved", "infeasible", "cost_limit", "expansion_limit", "memory_limit", "time_limit"}


def test_each_set_has_figures_of_each_method_or_a_reason(chain):
    sets = json.loads((chain / "reports/abstraction_quality.json").read_text())["sets"]
    assert list(sets) == ["random", "published", "simulated", "real"]
    assert sets["random"]["available"]
    for values in sets.values():
        if not values["available"]:
            assert values["reason"]
            continue
        assert set(values["methods"]) == {"trained", "manual", "flat"}
        assert values["tasks"] == 22 * values["maps"]
        for method in values["methods"].values():
            assert 0 <= method["feasibility_accuracy"] <= 1
            assert method["both_feasible"] <= values["feasible"]


def test_networks_are_also_judged_by_their_calibration(chain):
    random = json.loads((chain / "reports/abstraction_quality.json").read_text())["sets"]["random"]
    assert list(random["calibration"]) == ["trained"]  # the others state no probabilities
    figures = random["calibration"]["trained"]
    assert 0 <= figures["ece"] <= 1 and 0 <= figures["ece_adaptive"] <= 1
    assert sum(figures["bins"]["tasks"]) == random["tasks"]
    assert (chain / "reports/figures/reliability.png").read_bytes().startswith(b"\x89PNG")


def test_a_folder_of_shards_that_somebody_has_is_judged_with_the_abstraction_of_the_package(chain, tmp_path):
    (shard,) = shard_paths(chain / "data/labels/random")
    overrides = ["evaluation.model=momaro", f"evaluation.sets.mine.scans={shard.parent}"]
    said = run_python(
        "pipeline.evaluate", *tiny(chain), f"runtime.outputs={tmp_path}", *overrides, tracking=chain
    ).stdout
    sets = json.loads((tmp_path / "reports/abstraction_quality.json").read_text())["sets"]
    assert "mine, trained: " in said
    assert sets["mine"]["methods"] == sets["random"]["methods"]


@pytest.mark.parametrize(
    ("names", "model", "added"),
    [
        (["flat", "trained"], "models/abstraction", True),
        (["trained"], "models/copied", True),
        (["flat", "shipped"], "models/abstraction", False),
        (["trained"], "models/other", False),
        (["trained"], "momaro", False),
        (["trained"], "models/nothing", False),
    ],
)
def test_results_reach_the_run_of_the_judged_weights_alone(tmp_path, monkeypatch, names, model, added):
    for folder, weights in (("abstraction", "aa"), ("copied", "aa"), ("other", "bb")):
        (tmp_path / "models" / folder).mkdir(parents=True)
        (tmp_path / "models" / folder / "config.json").write_text(json.dumps({"weights_sha256": weights}))
    folders, logged = Folders(tmp_path, tmp_path), []
    tracking.keep_run(folders, "a run", None, "aa")
    mlflow = SimpleNamespace(
        MlflowException=RuntimeError,
        log_metrics=lambda values, run_id, model_id: logged.append((run_id, values)),
        log_artifact=lambda file, place, run_id: logged.append((run_id, file)),
    )
    monkeypatch.setattr(tracking, "connect", lambda: mlflow)
    tracking.add_results(folders, trained_weights(names, folders, model), {"a": 1.0, "b": None}, [tmp_path], "place")
    assert logged == ([("a run", {"a": 1.0}), ("a run", str(tmp_path))] if added else [])


def test_the_flat_baseline_judges_everything_feasible(chain):
    random = json.loads((chain / "reports/abstraction_quality.json").read_text())["sets"]["random"]
    flat = random["methods"]["flat"]
    assert flat["judged_feasible"] == random["tasks"]
    assert flat["feasibility_accuracy"] == pytest.approx(random["feasible"] / random["tasks"])


def test_the_table_has_a_row_for_each_set_and_method(chain):
    sets = json.loads((chain / "reports/abstraction_quality.json").read_text())["sets"]
    rows = list(csv.DictReader((chain / "reports/abstraction_quality.csv").open()))
    for name, values in sets.items():
        for method, figures in values.get("methods", {}).items():
            (row,) = [r for r in rows if (r["set"], r["category"], r["method"]) == (name, "all", method)]
            assert float(row["feasibility_accuracy"]) == figures["feasibility_accuracy"]


def test_a_missing_model_is_named(labelled, tmp_path):
    with pytest.raises(AssertionError, match=r"error: pretrained abstraction .*config.json: no such file\n"):
        run_python("pipeline.evaluate", *tiny(tmp_path))


def test_each_pair_is_planned_with_each_heuristic_and_weight(chain):
    planning = json.loads((chain / "reports/planning.json").read_text())
    runs = planning["runs"]
    assert {(r["pair"], r["heuristic"], r["weight"]) for r in runs} == {
        (pair, heuristic, weight)
        for pair in ("near",)
        for heuristic in ("geometric", "manual", "trained")
        for weight in (1.0, 2.0)
    }
    for run in runs:
        assert run["status"] in STATUSES
        assert (run["cost"] is not None) == (run["status"] == "solved")
        assert run["seconds"] > 0
        assert run["collision_free"] is None  # a generated arena has heights only
    assert any(run["status"] == "solved" for run in runs)
    assert planning["arena"]["source"] == "a generated arena"
    assert planning["best_known"]["near"]["cost"] == min(run["cost"] for run in runs if run["cost"] is not None)


def test_at_weight_one_no_heuristic_beats_the_admissible_one(chain):
    runs = json.loads((chain / "reports/planning.json").read_text())["runs"]
    best = {
        r["pair"]: r["cost"] for r in runs if (r["heuristic"], r["weight"], r["status"]) == ("geometric", 1.0, "solved")
    }
    for run in runs:
        if run["status"] == "solved" and run["pair"] in best:
            assert run["cost"] >= best[run["pair"]] * (1 - 1e-5)


def test_pictures_are_pictures(chain):
    for name in (
        "training_curves",
        "abstraction_quality",
        "example_patches",
        "planned_path",
        "planned_paths",
        "planning",
    ):
        assert (chain / f"reports/figures/{name}.png").read_bytes().startswith(b"\x89PNG"), name
