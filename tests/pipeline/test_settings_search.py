"""Searches for settings of a training with Optuna; the trainings are stand-ins that write a score or fail."""

import contextlib
import json
import subprocess
from pathlib import Path

import pytest

from hdsp.base.errors import InputError
from pipeline.command_line import parse
from pipeline.config import configure, parse_overrides
from pipeline.search import distribution, metric_of, open_study, search
from pipeline.started_by import this_process

optuna = pytest.importorskip("optuna")


@pytest.fixture
def trainings(monkeypatch):
    """Settings of each training; one with `trainer.batch.size=16` fails, another's score is its learning rate."""
    seen: list[dict[str, str]] = []

    def train(command, **_):
        settings = dict(word.split("=", 1) for word in command[3:] if "=" in word)
        seen.append(settings)
        if settings.get("trainer.batch.size") == "16":
            return subprocess.CompletedProcess(command, 1, stderr="a warning\nerror: no memory")
        reports = Path(settings["runtime.outputs"]) / "reports"
        reports.mkdir(parents=True)
        (reports / "training.json").write_text(json.dumps({"score": float(settings["trainer.optimizer.lr"])}))
        return subprocess.CompletedProcess(command, 0, stderr="")

    monkeypatch.setattr("pipeline.search.subprocess.run", train)
    monkeypatch.setattr("pipeline.search.tracking.sweep", lambda *_: contextlib.nullcontext())
    return seen


def command(folder: Path, *words: str):
    return parse([*words, f"runtime.outputs={folder}"], "search")


RATE = "trainer.optimizer.lr=tag(log, interval(1e-4, 1e-2))"


def test_the_best_of_all_trials_is_returned_and_kept(trainings, tmp_path):
    best = search(command(tmp_path, RATE, "search.trials=6"))
    rates = [float(settings["trainer.optimizer.lr"]) for settings in trainings]
    assert len(rates) == 6 and all(1e-4 <= rate <= 1e-2 for rate in rates)
    assert best["value"] == pytest.approx(min(rates)) and best["trials"] == 6
    assert best["overrides"] == [f"trainer.optimizer.lr={min(rates)}"]
    assert json.loads((tmp_path / "search/search/best.json").read_text()) == best


def test_a_search_continues_where_it_ended_with_other_values(trainings, tmp_path):
    search(command(tmp_path, RATE, "search.trials=2"))
    best = search(command(tmp_path, RATE, "search.trials=5"))
    assert len(trainings) == best["trials"] == 5
    assert len({settings["trainer.optimizer.lr"] for settings in trainings}) == 5


def test_each_failed_trial_is_named_and_the_best_of_the_others_is_kept(trainings, tmp_path):
    with pytest.raises(InputError, match=r"\d trials failed: trial \d .*trainer.batch.size=16\): no memory"):
        search(command(tmp_path, RATE, "trainer.batch.size=choice(8, 16)", "search.trials=8"))
    assert "trainer.batch.size=8" in json.loads((tmp_path / "search/search/best.json").read_text())["overrides"]


def test_a_trial_of_a_killed_search_is_continued_in_its_folder_with_its_values(trainings, tmp_path):
    study = open_study(configure(["search.name=search", f"runtime.outputs={tmp_path}"]))
    lost = study.ask({"trainer.optimizer.lr": optuna.distributions.FloatDistribution(1e-4, 1e-2, log=True)})
    lost.set_user_attr("process", this_process() + "0")  # a process that began at another time, and is gone
    best = search(command(tmp_path, RATE, "search.trials=2"))
    first, second = trainings
    assert float(first["trainer.optimizer.lr"]) == lost.params["trainer.optimizer.lr"] and best["trials"] == 2
    assert first["runtime.outputs"] == str(tmp_path / "search/search/0")
    assert second["runtime.outputs"] == str(tmp_path / "search/search/2")


def test_a_trial_that_another_process_still_runs_is_left_alone(trainings, tmp_path):
    study = open_study(configure(["search.name=search", f"runtime.outputs={tmp_path}"]))
    theirs = study.ask({"trainer.optimizer.lr": optuna.distributions.FloatDistribution(1e-4, 1e-2, log=True)})
    theirs.set_user_attr("process", this_process())
    search(command(tmp_path, RATE, "search.trials=1"))
    assert trainings[0]["runtime.outputs"] == str(tmp_path / "search/search/1")


@pytest.mark.parametrize(
    "words",
    [["trainer.optimizer.lr=interval(-1, 1)"], ["trainer.batch.size=choice(8, few)"], ["trainer.lr=choice(1, 2)"], []],
)
def test_values_are_checked_before_the_first_trial(trainings, tmp_path, words):
    with pytest.raises(InputError):
        search(command(tmp_path, *words, "search.trials=2"))
    assert not trainings


def test_each_kind_of_space_has_its_distribution():
    kinds = optuna.distributions
    for text, expected in {
        "interval(0.5, 2.5)": kinds.FloatDistribution(0.5, 2.5),
        "tag(log, interval(1e-4, 1e-2))": kinds.FloatDistribution(1e-4, 1e-2, log=True),
        "int(interval(2, 8))": kinds.IntDistribution(2, 8),
        "range(1, 8, 3)": kinds.IntDistribution(1, 7, step=3),
        "choice(a, b)": kinds.CategoricalDistribution(["a", "b"]),
    }.items():
        (override,) = parse_overrides([f"key={text}"])
        assert distribution(override) == expected, text


def test_a_metric_that_a_training_lacks_is_named():
    report = {"score": 0.5, "cost_error": {"val": 0.02}}
    assert metric_of(report, "cost_error/val") == 0.02
    with pytest.raises(InputError, match="'accuracy' is no number of this training; it has score, cost_error"):
        metric_of(report, "accuracy")
