"""Searches for settings of a training with Optuna; the trainings are stand-ins that write a score or fail."""

import contextlib
import json
import math
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from hdsp.base.errors import InputError
from pipeline.command_line import parse
from pipeline.config import configure, parse_overrides
from pipeline.config_types import SearchSettings
from pipeline.folders import write_json
from pipeline.search import metric_of, search
from pipeline.search_study import check_same_search, distribution, open_study
from pipeline.started_by import this_process

optuna = pytest.importorskip("optuna")


@pytest.fixture(scope="module")
def config():
    return configure(["model=compact"])


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
        write_json(reports / "training.json", {"score": float(settings["trainer.optimizer.lr"]), "gain": math.inf})
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


@pytest.mark.parametrize("text", ["interval(1e-2, 1e-4)", "tag(log, interval(0, 0.1))", "int(interval(8, 2))"])
def test_a_space_that_optuna_refuses_is_named_in_one_line(text):
    (override,) = parse_overrides([f"trainer.optimizer.weight_decay={text}"])
    with pytest.raises(InputError, match=r"^search: trainer\.optimizer\.weight_decay=[^\n]*(low|positive|larger)"):
        distribution(override)


def test_a_study_with_trials_of_other_settings_is_not_continued(config):
    def check(*changed: str, texts: Sequence[str] = (RATE, "trainer.batch.size=choice(4, 8)"), **settings):
        other = replace(config, **settings, search=replace(config.search, **dict(word.split("=") for word in changed)))
        check_same_search(study, other, {text.partition("=")[0]: parse_overrides([text])[0] for text in texts})

    study = optuna.create_study(study_name="search")
    check()
    check("name=search")
    narrow = "trainer.optimizer.lr=tag(log, interval(1e-4, 1e-3))"
    swept = replace(config.model, architecture="swept")
    for act, says in {
        lambda: check("direction=maximize"): "search.direction was 'minimize', is 'maximize'",
        lambda: check("metric=gain"): "search.metric was 'score', is 'gain'",
        lambda: check(trainer=replace(config.trainer, seed=7)): "trainer.seed was 0, is 7",
        lambda: check(model=swept): "model.architecture was 'compact', is 'swept'",
        lambda: check(runtime=replace(config.runtime, inputs="other")): "inputs was '.', is 'other'",
        lambda: check(texts=[RATE, "trainer.batch.size=choice(4, 16)"]): "is 'choice(4, 16)'",
        lambda: check(texts=[narrow, "trainer.batch.size=choice(4, 8)"]): "search.space.trainer.optimizer.lr was",
        lambda: check(texts=[RATE]): "search.space.trainer.batch.size was 'choice(4, 8)', is None",
    }.items():
        with pytest.raises(InputError, match=r"^search 'search' in sqlite:.* began with other settings: ") as caught:
            act()
        assert says in str(caught.value) and str(caught.value).endswith("; give another search.name")
    check(runtime=replace(config.runtime, workers=7, outputs="elsewhere"))  # decides no value


def test_a_search_with_another_setting_ends_before_its_first_trial(trainings, tmp_path):
    search(command(tmp_path, RATE, "search.trials=1"))
    with pytest.raises(InputError, match=r"trainer\.seed was 0, is 7; give another search\.name"):
        search(command(tmp_path, RATE, "search.trials=2", "trainer.seed=7"))
    assert len(trainings) == 1


def test_processes_that_begin_a_search_at_once_do_not_refuse_each_other(config, tmp_path, monkeypatch):
    mine = replace(config, search=replace(config.search, storage=f"sqlite:///{tmp_path}/optuna.db"))
    space = {"trainer.optimizer.lr": parse_overrides([RATE])[0]}
    study, other, write, looks = open_study(mine), open_study(mine), optuna.Study.set_user_attr, []

    def write_while_the_other_begins(self, key, value):
        if self is study:
            looks.append(check_same_search(other, mine, space))
        write(self, key, value)
        if self is study:
            looks.append(check_same_search(other, mine, space))

    monkeypatch.setattr(optuna.Study, "set_user_attr", write_while_the_other_begins)
    found = check_same_search(study, mine, space)
    assert looks and all(look == found for look in looks)
    for process in (study, other):
        with pytest.raises(InputError, match=r"trainer\.seed was 0, is 7; give another"):
            check_same_search(process, replace(mine, trainer=replace(mine.trainer, seed=7)), space)


def test_a_study_without_record_of_its_settings_is_compared_by_direction_and_space(config):
    study, space = optuna.create_study(), {"trainer.optimizer.lr": parse_overrides([RATE])[0]}
    with pytest.raises(InputError, match="has the direction minimize, not maximize"):
        check_same_search(study, replace(config, search=replace(config.search, direction="maximize")), space)
    study.tell(study.ask({"trainer.optimizer.lr": optuna.distributions.FloatDistribution(0.5, 1)}), 1.0)
    with pytest.raises(InputError, match=r"has trials with another trainer\.optimizer\.lr, FloatDistribution"):
        check_same_search(study, config, space)


def test_a_value_that_is_not_finite_is_worse_than_all_others(trainings, tmp_path):
    best = search(command(tmp_path, RATE, "search.trials=2", "search.metric=gain", "search.direction=maximize"))
    assert best["trials"] == 2 and best["value"] == -math.inf
    settings = SearchSettings("s", {}, 1, 1, "score", "minimize", 0, None)
    assert metric_of({"score": None}, settings) == math.inf


def test_the_last_word_about_a_key_counts_and_plain_values_of_a_space_hold_for_all_trials(trainings, tmp_path):
    named = "++search.space={trainer.optimizer.lr: 'interval(1e-4, 1e-2)', trainer.batch.size: 8}"
    best = search(command(tmp_path, named, "search.trials=1"))
    assert trainings[0]["trainer.batch.size"] == "8" and len(best["overrides"]) == 1
    words = ["trainer.batch.size=choice(4, 8)", "trainer.optimizer.lr=0.003", "search.name=other", "search.trials=1"]
    best = search(command(tmp_path, named, *words))
    assert trainings[1]["trainer.optimizer.lr"] == "0.003" and best["overrides"][0].startswith("trainer.batch.size=")


def test_a_storage_that_cannot_be_used_is_named_without_its_password(config, tmp_path):
    damaged = tmp_path / "optuna.db"
    damaged.write_text("no database" * 500)
    nowhere = f"sqlite:///{tmp_path}/none/optuna.db"
    for place in ("nothing", nowhere, "postgresql://me:secret@127.0.0.1:9/x", f"sqlite:///{damaged}"):
        with pytest.raises(InputError, match=r"^cannot use search\.storage ") as caught:
            open_study(replace(config, search=replace(config.search, storage=place)))
        assert "\n" not in str(caught.value) and "secret" not in str(caught.value)


def test_a_metric_that_a_training_lacks_is_named():
    report = {"score": 0.5, "cost_error": {"val": 0.02}}
    nested, absent = (
        SearchSettings("s", {}, 1, 1, metric, "minimize", 0, None) for metric in ("cost_error/val", "accuracy")
    )
    assert metric_of(report, nested) == 0.02
    with pytest.raises(InputError, match="'accuracy' is no number of this training; it has score, cost_error"):
        metric_of(report, absent)
