"""Records, profiles and parts of a training."""

import csv
from itertools import zip_longest

import lightning.pytorch as pl
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from lightning.pytorch.loggers import CSVLogger

from hdsp.base.errors import InputError
from hdsp.learning import train
from hdsp.learning.learning_settings import ScheduleSettings
from hdsp.learning.module import _schedule
from hdsp.learning.training_parts import TaskMean
from pipeline.config import configure
from pipeline.parts import training_parts
from tests import ROOT
from tests.learning.synthetic import synthetic_tasks, tiny_config


class LogsEachStep(pl.Callback):
    """A callback that logs by the module, as Lightning's own do."""

    def on_train_batch_end(self, trainer, module, outputs, batch, index):
        module.log("own/step", float(trainer.global_step))

    def on_train_epoch_end(self, trainer, module):
        module.log("own/epoch", 10.0 + trainer.current_epoch)


def test_steps_and_values_of_callbacks_reach_loggers_at_the_configured_rate(tmp_path):
    config = tiny_config(epochs=2) | {"lightning": {"log_every": 2, "profiler": "simple"}}
    steps, seen = [], CSVLogger(tmp_path, name=None, version="log", flush_logs_every_n_steps=1)
    tasks = synthetic_tasks(64)
    train(
        config, tasks, {"val": tasks}, tmp_path, seen, [LogsEachStep()], quiet=True,
        on_step=lambda step, values: steps.append((step, values)),
    )  # fmt: skip
    assert [step for step, _ in steps] == [0, 2, 4, 6]
    names = {"step/feasibility", "step/cost", "step/learning_rate", "step/gradient_norm"}
    assert all(values.keys() == names and values["step/gradient_norm"] > 0 for _, values in steps)
    assert len({values["step/learning_rate"] for _, values in steps}) == 4
    rows = list(csv.DictReader((tmp_path / "log/metrics.csv").open()))
    norms = [float(row["step/gradient_norm"]) for row in rows if row["step/gradient_norm"]]
    assert norms == pytest.approx([values["step/gradient_norm"] for _, values in steps])
    assert [float(row["own/step"]) for row in rows if row["own/step"]] == [2, 4, 6, 8]
    assert [float(row["own/epoch"]) for row in rows if row["own/epoch"]] == [10, 11]
    assert [row["cost_error/val"] != "" for row in rows].count(True) == 2
    assert "run_training_batch" in (tmp_path / "fit-profile.txt").read_text()


def test_a_function_becomes_a_metric_by_its_mean_over_tasks():
    metric = TaskMean(lambda cost, logits, feasible, labelled: (logits > 0) & ~feasible)
    assert metric.compute() != metric.compute()  # no number without tasks
    for tasks in (1, 3):
        logits, feasible = torch.ones(2, tasks), torch.zeros(2, tasks, dtype=torch.bool)
        feasible[0] = True
        metric.update(logits, logits, feasible, logits)
    assert metric.compute() == 0.5
    metric.reset()
    metric.update(logits, logits, feasible[:1], logits[:1])
    assert metric.compute() == 0.0


@settings(max_examples=60, deadline=None)
@given(steps=st.integers(1, 40), warmup=st.sampled_from([1e-6, 0.1, 0.2, 0.25, 1 / 3, 0.5, 0.999]))
@example(steps=5, warmup=0.2)
@example(steps=10, warmup=0.1)
@example(steps=2, warmup=0.5)
def test_every_schedule_works_with_any_number_of_steps(steps, warmup):
    for name in ("onecycle", "cosine"):
        optimizer = torch.optim.SGD([torch.nn.Parameter(torch.zeros(1))], lr=0.5)
        schedule = _schedule(ScheduleSettings(name, warmup), optimizer, steps)
        rates = []
        for _ in range(steps):
            rates.append(optimizer.param_groups[0]["lr"])
            optimizer.step()
            schedule.step()
        assert all(0 <= rate <= 0.5 * (1 + 1e-6) for rate in rates)
        assert name == "onecycle" or rates[0] == 0.5
        if name == "onecycle" and warmup * steps >= 1:
            assert rates[0] == pytest.approx(0.5 / 25)  # it rises first


#: Groups of parts, as overrides name them.
GROUPS = (
    "trainer/callbacks", "trainer/loss", "trainer/metrics", "trainer/optimizer", "trainer/schedule", "debug",
    "runtime/lightning", "runtime/loggers",
)  # fmt: skip
CHOICES = [[(group, path.stem) for path in sorted((ROOT / "conf" / group).glob("*.yaml"))] for group in GROUPS]


@pytest.mark.parametrize("chosen", [dict(filter(None, row)) for row in zip_longest(*CHOICES)])
def test_every_choice_of_a_training_makes_its_parts(chosen, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = configure(["profile=tiny", *(f"{'+' * (g == 'runtime/loggers')}{g}={name}" for g, name in chosen.items())])
    parts = training_parts(config.trainer, config.runtime.lightning)
    found = {
        "trainer/callbacks": bool(parts.callbacks), "trainer/loss": parts.loss is not None,
        "trainer/metrics": bool(parts.metrics), "runtime/loggers": bool(parts.loggers),
    }  # fmt: skip
    assert found == {group: chosen.get(group, "none") != "none" for group in found}
    assert (parts.optimizer is not None) == (chosen.get("trainer/optimizer") == "nadam")
    assert (parts.schedule is not None) == (chosen.get("trainer/schedule") == "polynomial")
    expected = {"fast": (2, None), "profiler": (20, None), "overfit": (None, 16)}.get(chosen.get("debug"), (None, None))
    assert (config.trainer.limits.train, config.trainer.limits.overfit) == expected
    assert config.runtime.lightning.profiler == ("simple" if chosen.get("debug") == "profiler" else None)


def test_a_metric_that_is_none_is_named(tmp_path):
    config = configure(["profile=tiny", "+trainer.metrics.wrong._target_=builtins.int"])
    with pytest.raises(InputError, match=r"trainer.metrics.wrong: builtins.int makes 0; need an object with reset"):
        training_parts(config.trainer, config.runtime.lightning)
