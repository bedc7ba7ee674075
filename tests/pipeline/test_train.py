"""Training as a user starts it: tracking, output files and sweeps."""

import base64
import json
import math
import os
import zlib

import numpy as np
import pytest
import yaml

from pipeline import run_view, tracking
from pipeline.started_by import this_process
from tests.pipeline.conftest import run_python, tiny

pytestmark = [pytest.mark.pipeline, pytest.mark.xdist_group("chain")]


@pytest.fixture
def mlflow(chain):
    import mlflow

    mlflow.set_tracking_uri(f"sqlite:///{chain / 'mlflow.db'}")
    yield mlflow
    mlflow.set_tracking_uri(None)


def runs(mlflow, where=lambda run: True):
    client = mlflow.MlflowClient()
    experiment = client.get_experiment_by_name("hdsp")
    return [run for run in client.search_runs([experiment.experiment_id]) if where(run)]


def test_a_training_is_tracked_with_everything(chain, mlflow):
    (run,) = runs(mlflow, lambda run: "sweep" not in run.data.tags and "mlflow.parentRunId" not in run.data.tags)
    assert run.info.status == "FINISHED"
    parameters = run.data.params
    assert parameters["model.architecture"] == "compact"
    assert parameters["trainer.epochs"] == "2"
    assert parameters["model.options.hidden"] == "16"
    assert len(parameters) < 60 and not any(value in ("None", "{}", "[]") for value in parameters.values())
    assert run.info.run_name.startswith("compact profile=tiny widths=[4, 4] blocks=[1, 1] map_features=4")
    assert len(run.data.tags["data.train"]) == 64
    assert {"git.commit", "git.dirty", "data.val", "data.random"} <= set(run.data.tags)
    assert {"parameters", "maps", "best_epoch"} <= set(run.data.metrics)
    assert run.data.metrics["seconds"] > run.data.metrics["epoch_seconds"] > 0  # of the training, of its last epoch

    client = mlflow.MlflowClient()
    whole = yaml.safe_load(mlflow.artifacts.load_text(f"{run.info.artifact_uri}/config.yaml"))
    assert whole["robot"]["drive"]["unevenness_cost"] == 0.0309234
    assert whole["labelling"]["splits"]["train"]["maps_per_category"] == 2
    assert "profile=tiny" in mlflow.artifacts.load_text(f"{run.info.artifact_uri}/overrides.txt").splitlines()
    names = ["feasibility_accuracy/val", "feasibility_accuracy/random", "loss/feasibility", "loss/cost"]
    for name in [*names, "loss_weight/feasibility", "loss_weight/cost"]:
        history = client.get_metric_history(run.info.run_id, name)
        assert [metric.step for metric in history] == [0, 1], name
        assert all(math.isfinite(metric.value) for metric in history), name
    assert {"cost_error/val", "cost_error/random"} <= set(run.data.metrics)


def test_the_table_of_runs_has_a_view_with_metrics_that_users_may_change(chain, mlflow):
    client = mlflow.MlflowClient()
    experiment = client.get_experiment_by_name("hdsp")
    assert experiment.tags["mlflow.experimentKind"] == "custom_model_development"
    view = json.loads(experiment.tags[run_view.VIEW_TAG])
    state = json.loads(zlib.decompress(base64.b64decode(view["state"].removeprefix("deflate;"))))
    (run,) = runs(mlflow, lambda run: "sweep" not in run.data.tags and "mlflow.parentRunId" not in run.data.tags)
    assert view["name"] == "results" and state["orderByKey"] == "metrics.`best/score`"
    assert {name.removeprefix("metrics.").strip("`") for name in state["selectedColumns"]} <= run.data.metrics.keys()

    client.set_experiment_tag(experiment.experiment_id, run_view.VIEW_TAG, "changed by a user")
    run_view.show_results(mlflow, client.get_experiment(experiment.experiment_id))
    assert client.get_experiment(experiment.experiment_id).tags[run_view.VIEW_TAG] == "changed by a user"


def test_data_model_and_later_stages_belong_to_the_run(chain, mlflow):
    (run,) = runs(mlflow, lambda run: "sweep" not in run.data.tags and "mlflow.parentRunId" not in run.data.tags)
    used = {(i.dataset.name, i.tags[0].value): i.dataset.digest for i in run.inputs.dataset_inputs}
    assert used["train", "training"] == run.data.tags["data.train"][:32]
    assert {("val", "validation"), ("random", "test")} <= set(used)
    (model,) = mlflow.search_logged_models(experiment_ids=[run.info.experiment_id], output_format="list")
    linked = {(metric.key, metric.dataset_name) for metric in model.metrics}
    assert {("best/feasibility_accuracy/val", "val"), ("best/feasibility_accuracy/random", "random")} <= linked
    requirements = mlflow.artifacts.load_text(f"{model.artifact_location}/requirements.txt").split()
    assert any(line.partition("=")[0] == "hdsp" for line in requirements)
    quality = json.loads((chain / "reports/abstraction_quality.json").read_text())["sets"]["random"]
    accuracy = quality["methods"]["trained"]["feasibility_accuracy"]
    assert run.data.metrics["table 1/random/trained/feasibility_accuracy"] == pytest.approx(accuracy)
    assert run.data.metrics["calibration/random/trained/ece"] == pytest.approx(quality["calibration"]["trained"]["ece"])
    assert "table 2/manual/W1.0/seconds_mean" in run.data.metrics
    assert not any(name.startswith("table 1/mine/") for name in run.data.metrics)  # of another abstraction


def test_the_tracked_model_has_a_signature_and_predicts_as_the_saved_one(chain, mlflow):
    from hdsp.labels.shards import read_tasks
    from hdsp.learning import LearnedAbstraction

    (run,) = runs(mlflow, lambda run: "sweep" not in run.data.tags and "mlflow.parentRunId" not in run.data.tags)
    model = mlflow.pyfunc.load_model(f"runs:/{run.info.run_id}/abstraction")
    assert set(model.metadata.signature.inputs.input_names()) == {"heights", "goals"}
    assert set(model.metadata.signature.outputs.input_names()) == {"feasible", "cost"}

    tasks = read_tasks(chain / "data/labels/random")
    served = model.predict({"heights": tasks.heights, "goals": tasks.goals})
    abstraction = LearnedAbstraction.from_pretrained(chain / "models/abstraction")
    feasible, cost = abstraction.predict(tasks.heights, tasks.goals)
    np.testing.assert_array_equal(served["feasible"], feasible)
    np.testing.assert_array_equal(served["cost"], cost)


def test_a_training_writes_its_reports(chain):
    report = json.loads((chain / "reports/training.json").read_text())
    assert report["model"] == "compact"
    assert report["epochs"] == 2
    assert 0 <= report["feasibility_accuracy"]["val"] <= 1
    header, *rows = (chain / "reports/training_history.csv").read_text().splitlines()
    assert {"epoch", "feasibility_accuracy/val", "cost_error/val"} <= set(header.split(","))
    assert len(rows) == 2
    assert (chain / "reports/figures/training_curves.png").read_bytes().startswith(b"\x89PNG")


def test_a_sweep_has_two_child_runs_under_one_parent(chain, mlflow, tmp_path):
    overrides = [*tiny(chain)[:2], "runtime.workers=1", "trainer.epochs=1", f"hydra.sweep.dir={tmp_path}"]
    run_python("pipeline.train", "-m", "model=klamt2019,compact", *overrides, tracking=chain)

    (parent,) = runs(mlflow, lambda run: "sweep" in run.data.tags)
    children = runs(mlflow, lambda run: run.data.tags.get("mlflow.parentRunId") == parent.info.run_id)
    assert parent.info.status == "FINISHED"
    assert parent.data.tags["sweep"].startswith("model=klamt2019,compact")
    assert sorted(run.data.params["model.architecture"] for run in children) == ["compact", "klamt2019"]
    assert all("feasibility_accuracy/val" in run.data.metrics for run in children)
    for number in "01":
        assert (tmp_path / number / "models/abstraction/model.safetensors").is_file()


def test_runs_of_killed_processes_end_and_a_continued_sweep_keeps_its_parent(chain, mlflow, monkeypatch):
    monkeypatch.setenv("DVC_ROOT", str(chain))
    client, mine = tracking.connect().MlflowClient(), this_process()
    experiment = client.get_experiment_by_name("hdsp").experiment_id
    gone, alive = (client.create_run(experiment, tags={tracking.PROCESS: p}).info.run_id for p in (f"{mine}0", mine))
    words, parents = ["model=compact,swept", "hydra.sweep.dir=outputs/mine"], []
    for _ in range(2):
        with tracking.sweep(words):
            parents.append(os.environ[tracking.PARENT_VARIABLE])
            assert client.get_run(parents[-1]).info.status == "RUNNING"
    assert parents[0] == parents[1] and client.get_run(parents[0]).info.status == "FINISHED"
    assert client.get_run(parents[0]).info.run_name == "sweep model=compact,swept"
    assert [client.get_run(run).info.status for run in (gone, alive)] == ["KILLED", "RUNNING"]
    for run in (gone, alive, *parents[:1]):
        client.delete_run(run)


def test_a_sweep_with_an_unknown_choice_starts_no_run(chain, mlflow):
    before = len(runs(mlflow))
    with pytest.raises(AssertionError, match=r"error: .*Available options in 'model'"):
        run_python("pipeline.train", "-m", "model=compact,nonsense", *tiny(chain)[:2], tracking=chain)
    assert len(runs(mlflow)) == before
