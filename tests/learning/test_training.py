"""Training: it learns, keeps the best state, resumes, and reports errors."""

import csv
import json
import math
import os
import signal
import subprocess
import sys
from dataclasses import replace

import lightning.pytorch as pl
import numpy as np
import pytest
import torch
from torch.optim.swa_utils import AveragedModel

from hdsp.base.errors import InputError
from hdsp.labels.shards import write_shard
from hdsp.learning import HardwareSettings, LearnedAbstraction, train
from hdsp.learning.callbacks import AveragedWeights
from hdsp.learning.learning_settings import BatchSettings
from hdsp.learning.metrics import combined_score, task_losses
from hdsp.learning.task_data import BatchSampler, generator_seed
from hdsp.learning.training_parts import TrainingParts
from tests import ROOT
from tests.learning.synthetic import synthetic_tasks, tiny_config
from tests.learning.test_zoo import model_file


@pytest.fixture(scope="module")
def tasks():
    return synthetic_tasks(96)


@pytest.fixture(scope="module")
def val():
    return synthetic_tasks(48, seed=1)


def test_a_small_network_learns_a_simple_rule(tasks, val, tmp_path):
    result = train(tiny_config(epochs=12, mirror=True), tasks, {"val": val}, tmp_path, quiet=True)
    always_feasible = val.feasible.mean()
    assert result.metrics["feasibility_accuracy/val"] > (1 + always_feasible) / 2
    assert result.metrics["cost_error/val"] < val.cost[val.feasible].std() / 2


def test_costs_for_planning_are_learned_beside_label_costs(tasks, val, tmp_path):
    def planned(tasks):
        return replace(tasks, planning_cost=tasks.cost * np.linspace(0.4, 0.9, 22, dtype=np.float32))

    config = tiny_config(epochs=18)
    config["model"] = model_file("footprint")
    config["model"]["options"] |= {
        "planning": True,
        "foot_ways": None,  # the synthetic labels do not depend on how feet move
        "width": 8,
        "hidden": 16,
        "features": 8,
        "context": 8,
        "feet": 16,
        "head": 32,
    }
    result = train(config, planned(tasks), {"val": planned(val), "label": val}, tmp_path, quiet=True)
    assert result.metrics["planning_cost_error/val"] < 0.5 * result.history[0]["planning_cost_error/val"]
    assert "planning_cost_error/label" not in result.metrics
    abstraction = LearnedAbstraction.from_pretrained(result.model_dir)
    feasible, cost = abstraction.predict(val.heights, val.goals)
    again, planning = abstraction.for_planning().predict(val.heights, val.goals)
    both = feasible & val.feasible
    np.testing.assert_array_equal(again, feasible)
    assert (planning <= cost).all() and planning[both].mean() < 0.85 * cost[both].mean()
    error = np.abs(planning - planned(val).planning_cost)[both].mean()
    assert error == pytest.approx(result.metrics["planning_cost_error/val"], rel=0.05)
    with pytest.raises(InputError, match="its labels have no planning_cost"):
        train(config, tasks, {"val": val}, tmp_path / "other", quiet=True)


def test_the_best_epoch_is_saved_and_gives_its_metrics_again(tasks, val, tmp_path):
    # With this high learning rate, late epochs are sometimes worse than early ones.
    config = tiny_config(epochs=5, optimizer={"name": "adamw", "lr": 0.03}, schedule={"name": "constant"})
    result = train(config, tasks, {"val": val, "other": tasks}, tmp_path, quiet=True)
    scores = [combined_score(row["feasibility_accuracy/val"], row["cost_error/val"]) for row in result.history]
    assert result.best_epoch == int(np.argmin(scores))
    hardware = HardwareSettings(**config["hardware"])
    abstraction = LearnedAbstraction.from_pretrained(result.model_dir, hardware=hardware)
    feasible, cost = abstraction.predict(val.heights, val.goals)
    both = feasible & val.feasible
    assert (feasible == val.feasible).mean() == pytest.approx(result.metrics["feasibility_accuracy/val"], abs=1e-6)
    assert np.abs(cost - val.cost)[both].mean() == pytest.approx(result.metrics["cost_error/val"], rel=1e-3)


def test_history_is_written_and_told(tasks, val, tmp_path, capsys):
    told = []
    result = train(
        tiny_config(), tasks, {"val": val}, tmp_path, on_epoch=lambda epoch, metrics: told.append((epoch, metrics))
    )
    assert [epoch for epoch, _ in told] == [0, 1, 2]
    names = {
        "loss/feasibility", "loss/cost", "loss_weight/feasibility", "loss_weight/cost",
        "feasibility_accuracy/val", "cost_error/val",
    }  # fmt: skip
    assert names <= set(told[0][1])
    assert json.loads((tmp_path / "history.json").read_text()) == result.history
    with (tmp_path / "history.csv").open() as file:
        assert [int(row["epoch"]) for row in csv.DictReader(file)] == [0, 1, 2]
    assert len(capsys.readouterr().out.splitlines()) == 3


class StopAfter(pl.Callback):
    """Interrupts the training after an epoch's checkpoint."""

    def __init__(self, epoch):
        self.epoch = epoch

    def on_train_epoch_start(self, trainer, module):
        if trainer.current_epoch > self.epoch:
            raise KeyboardInterrupt


@pytest.mark.parametrize("rule", ["plateau", "published"])
def test_an_interrupted_training_ends_like_an_undisturbed_one(tasks, val, tmp_path, rule):
    # A reduced loss weight must survive too. At this learning rate, losses are noise and sometimes rise.
    config = tiny_config(
        epochs=6,
        mirror=True,
        optimizer={"name": "adamw", "lr": 1e-5},
        schedule={"name": "cosine"},
        losses={"rule": rule, "patience": 1},
    )
    whole = train(config, tasks, {"val": val}, tmp_path / "whole", quiet=True)
    with pytest.raises((KeyboardInterrupt, SystemExit)):
        train(config, tasks, {"val": val}, tmp_path / "parts", callbacks=[StopAfter(2)], quiet=True)
    resumed = train(config, tasks, {"val": val}, tmp_path / "parts", quiet=True)
    assert resumed.resumed_from == 3
    assert whole.history[-1]["loss_weight/feasibility"] < 1
    timeless = [[{k: v for k, v in row.items() if k != "seconds"} for row in r.history] for r in (whole, resumed)]
    assert timeless[0] == timeless[1]
    weights = [(path.model_dir / "model.safetensors").read_bytes() for path in (whole, resumed)]
    assert weights[0] == weights[1]


class StopWithin(pl.Callback):
    """Interrupts the training within an epoch, after a checkpoint there; at its end, in the validation."""

    def __init__(self, epoch, batch):
        self.epoch, self.batch = epoch, batch

    def on_train_batch_start(self, trainer, module, batch, index):
        if (trainer.current_epoch, index) == (self.epoch, self.batch):
            raise KeyboardInterrupt
        if (trainer.current_epoch, index) == (self.epoch, self.batch - 1):
            for kept in trainer.checkpoint_callbacks:  # their interval is over
                kept._last_time_checked = -math.inf

    def on_validation_start(self, trainer, module):
        if (trainer.current_epoch, trainer.num_training_batches) == (self.epoch, self.batch):
            raise KeyboardInterrupt


def noisy_losses(cost, logits, feasible, labelled):
    """The losses, times a random number each, as from a dropout layer."""
    return tuple(torch.rand(()) * loss for loss in task_losses(cost, logits, feasible, labelled))


@pytest.mark.parametrize(
    ("stop", "trainer"),
    [
        # A checkpoint after the third batch would lose its gradients.
        (StopWithin(1, 3), {"accumulate": 2, "checkpoint_minutes": 1e3}),
        (StopWithin(1, 6), {}),
        (StopWithin(1, 2), {"limits": {"train": 4}}),
        (StopAfter(0), {"limits": {"train": 4}}),  # the next epoch begins at its first batch
    ],
)
def test_a_training_goes_on_wherever_it_was_interrupted(tasks, val, tmp_path, stop, trainer):
    def trained(name, callbacks=()):
        config = tiny_config(**{"epochs": 2, "mirror": True, "checkpoint_minutes": 1e-7, **trainer})
        parts = TrainingParts(loss=noisy_losses)
        found = train(config, tasks, {"val": val}, tmp_path / name, callbacks=callbacks, quiet=True, parts=parts)
        weights = (found.model_dir / "model.safetensors").read_bytes()
        return [{k: v for k, v in row.items() if k != "seconds"} for row in found.history], weights

    with pytest.raises((KeyboardInterrupt, SystemExit)):
        trained("parts", [stop])
    assert trained("parts") == trained("whole")


def test_a_training_that_has_stopped_early_stays_so_after_a_restart(tasks, val, tmp_path):
    still = {"optimizer": {"name": "adamw", "lr": 0.0}, "schedule": {"name": "constant"}}
    for stop in ({"early_stopping": 2}, {"epochs": 3}):
        config = tiny_config(**{"epochs": 9, **still, **stop})
        first, second = (
            train(config, tasks[:16], {"val": val}, tmp_path / next(iter(stop)), quiet=True) for _ in range(2)
        )
        assert len(first.history) == second.resumed_from == 3 and second.history == first.history


def test_other_validation_sets_come_and_go_but_another_selection_set_begins_anew(tasks, val, tmp_path, capsys):
    config = tiny_config(epochs=3)
    with pytest.raises((KeyboardInterrupt, SystemExit)):
        train(config, tasks, {"val": val, "a": val[:8]}, tmp_path, callbacks=[StopAfter(0)], quiet=True)
    with pytest.raises((KeyboardInterrupt, SystemExit)):
        train(config, tasks, {"b": tasks[:8], "val": val}, tmp_path, callbacks=[StopAfter(1)], quiet=True)
    other = train(config, tasks, {"val": val}, tmp_path, quiet=True)
    assert other.resumed_from == 2 and "begins anew" not in capsys.readouterr().out
    with (tmp_path / "history.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [[row[f"cost_error/{name}"] != "" for name in ("val", "a", "b")] for row in rows] == [
        [True, True, False], [True, False, True], [True, False, False],
    ]  # fmt: skip
    again = train(config, tasks, {"val": val[:24]}, tmp_path, quiet=True)
    assert again.resumed_from == 0 and len(again.history) == 3
    assert "other settings, maps or selection set; this one begins anew" in capsys.readouterr().out


def test_seeds_of_any_size_are_seeds():
    assert generator_seed(3, 7) == 3 * 1_000_003 + 7
    for seed in (2**32 - 1, 10**14, 2**63 - 1):
        sampler = BatchSampler(4, 22, BatchSettings("map", 2), shuffle=True, mirror=True, seed=seed)
        assert len(list(sampler)) == 2 and 0 <= generator_seed(seed, 1, 2) < 2**63


@pytest.mark.parametrize("streamed", [False, True])
def test_a_training_interrupted_within_an_epoch_ends_like_an_undisturbed_one(tasks, val, tmp_path, streamed):
    data = tasks
    if streamed:
        for number in range(3):
            write_shard(tmp_path / f"shards/{number}.h5", tasks[number * 32 : number * 32 + 32], {"labels_hash": "x"})
        data = [tmp_path / "shards"]
    config = tiny_config(epochs=3, mirror=True, ema=0.9, checkpoint_minutes=1e-7)
    whole = train(config, data, {"val": val}, tmp_path / "whole", quiet=True)
    with pytest.raises((KeyboardInterrupt, SystemExit)):
        train(config, data, {"val": val}, tmp_path / "parts", callbacks=[StopWithin(1, 3)], quiet=True)
    resumed = train(config, data, {"val": val}, tmp_path / "parts", quiet=True)
    assert resumed.resumed_from == 1 and resumed.maps == len(tasks)
    timeless = [[{k: v for k, v in row.items() if k != "seconds"} for row in r.history] for r in (whole, resumed)]
    assert timeless[0] == timeless[1]
    weights = [(path.model_dir / "model.safetensors").read_bytes() for path in (whole, resumed)]
    assert weights[0] == weights[1]


def streamed(folder, out, callbacks=()):
    """A streamed training, eight batches an epoch, with a reader and on one thread."""
    config = tiny_config(epochs=2, mirror=True, checkpoint_minutes=1e-7, stream=True, stream_shards=2)
    config["trainer"]["batch"]["size"] = 12
    config["hardware"]["readers"] = 1
    return train(config, [folder], {"val": synthetic_tasks(16, seed=1)}, out, callbacks=callbacks, quiet=True)


class KillWithin(pl.Callback):
    """Ends its process at once, as `kill -9` does, after a checkpoint within the second epoch."""

    def on_train_batch_start(self, trainer, module, batch, index):
        if (trainer.current_epoch, index) == (1, 5):
            os.kill(os.getpid(), signal.SIGKILL)


def test_a_streamed_training_that_was_killed_ends_with_the_same_weights(tasks, tmp_path):
    for number in range(6):
        write_shard(tmp_path / f"shards/{number}.h5", tasks[number * 16 : number * 16 + 16], {"labels_hash": "x"})
    places = tmp_path / "shards", tmp_path / "killed"
    script = f"from tests.learning.test_training import *; streamed({places[0]!r}, {places[1]!r}, [KillWithin()])"
    script = f"from pathlib import *; {script}"
    killed = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    resumed, whole = streamed(*places), streamed(tmp_path / "shards", tmp_path / "whole")
    assert resumed.resumed_from == 1
    weights = [(result.model_dir / "model.safetensors").read_bytes() for result in (resumed, whole)]
    assert weights[0] == weights[1]


def test_the_average_of_the_weights_is_judged_and_saved(tasks, val, tmp_path):
    plain, averaged = (
        train(tiny_config(epochs=2, ema=ema), tasks, {"val": val}, tmp_path / str(ema), quiet=True)
        for ema in (None, 0.99)
    )
    assert plain.history[0]["loss/cost"] == averaged.history[0]["loss/cost"]  # training itself is the same
    assert plain.history[0]["cost_error/val"] != averaged.history[0]["cost_error/val"]
    hardware = HardwareSettings(**tiny_config()["hardware"])
    feasible, _ = LearnedAbstraction.from_pretrained(averaged.model_dir, hardware=hardware).predict(
        val.heights, val.goals
    )
    expected = averaged.metrics["feasibility_accuracy/val"]
    assert (feasible == val.feasible).mean() == pytest.approx(expected, abs=1e-6)


def test_the_average_is_what_its_definition_says():
    averaging, current = AveragedWeights(0.5), torch.nn.Linear(1, 1, bias=False)
    average = AveragedModel(current, **averaging._kwargs)
    expected = None
    for step, value in enumerate([4.0, 1.0, 2.0, 8.0, 1.0] * 3):
        torch.nn.init.constant_(current.weight, value)
        average.update_parameters(current)
        decay = min(0.5, (1 + step) / (10 + step))
        expected = value if step == 0 else decay * expected + (1 - decay) * value
        assert average.module.weight.item() == pytest.approx(expected)


def test_training_ends_early_where_nothing_gets_better(tasks, val, tmp_path):
    config = tiny_config(
        epochs=9, early_stopping=2, optimizer={"name": "adamw", "lr": 0.0}, schedule={"name": "constant"}
    )
    result = train(config, tasks[:16], {"val": val}, tmp_path, quiet=True)
    assert (len(result.history), result.best_epoch) == (3, 0)


def test_a_diverged_training_is_named(tasks, val, tmp_path):
    config = tiny_config(epochs=2, optimizer={"name": "sgd", "lr": 1e6}, schedule={"name": "constant"})
    with pytest.raises(InputError, match=r"diverged: in epoch \d .*trainer\.optimizer\.lr than 1e\+06"):
        train(config, tasks, {"val": val}, tmp_path, quiet=True)


def test_a_network_that_finds_nothing_feasible_goes_on(tasks, val, tmp_path, capsys):
    never = replace(val, feasible=np.zeros_like(val.feasible))
    result = train(tiny_config(epochs=2), tasks, {"val": never}, tmp_path, quiet=True)
    assert "judges no feasible task of 'val' feasible after 2 epochs; the last epoch is kept" in capsys.readouterr().out
    assert result.best_epoch == 1 and len(result.history) == 2
    assert LearnedAbstraction.from_pretrained(result.model_dir).metrics["loss/cost"] == result.history[1]["loss/cost"]


def test_a_damaged_last_state_gives_way_to_the_best_one(tasks, val, tmp_path, capsys):
    config = tiny_config(epochs=4)
    with pytest.raises((KeyboardInterrupt, SystemExit)):
        train(config, tasks, {"val": val}, tmp_path, callbacks=[StopAfter(2)], quiet=True)
    (tmp_path / "checkpoints/last.ckpt").write_bytes(b"cut off")
    resumed = train(config, tasks, {"val": val}, tmp_path, quiet=True)
    assert "last.ckpt is damaged" in capsys.readouterr().out
    assert resumed.resumed_from > 0 and len(resumed.history) == 4


def test_training_may_begin_with_the_weights_of_a_saved_model(tasks, val, tmp_path):
    first = train(tiny_config(epochs=3), tasks, {"val": val}, tmp_path / "first", quiet=True)
    still = {"epochs": 1, "optimizer": {"name": "sgd", "lr": 1e-12}, "initial": str(first.model_dir)}
    again = train(tiny_config(**still), tasks, {"val": val}, tmp_path / "again", quiet=True)
    assert again.metrics["cost_error/val"] < 1.2 * first.metrics["cost_error/val"] < first.history[0]["cost_error/val"]
    weights = [LearnedAbstraction.from_pretrained(result.model_dir).network.state_dict() for result in (first, again)]
    for name, value in weights[0].items():
        if "running" not in name and "num_batches" not in name:  # norms go on counting
            torch.testing.assert_close(weights[1][name], value)
    other = tiny_config(**still)
    other["model"] = {**other["model"], "architecture": "table", "options": {}}
    with pytest.raises(InputError, match=r"trainer.initial: .* holds a"):
        train(other, tasks, {"val": val}, tmp_path / "other", quiet=True)


def test_another_training_does_not_resume(tasks, val, tmp_path):
    train(tiny_config(epochs=1), tasks, {"val": val}, tmp_path, quiet=True)
    assert train(tiny_config(epochs=2), tasks, {"val": val}, tmp_path, quiet=True).resumed_from == 0
    assert train(tiny_config(epochs=2), val, {"val": val}, tmp_path, quiet=True).resumed_from == 0


def test_single_tasks_and_the_papers_optimiser_work(tasks, val, tmp_path):
    config = tiny_config(
        epochs=1,
        batch={"by": "task", "size": 8},
        optimizer={"name": "sgd", "lr": 1e-4, "momentum": 0.9},
        schedule={"name": "constant"},
        losses={"rule": "plateau"},
    )
    result = train(config, tasks[:8], {"val": val}, tmp_path, quiet=True)
    assert result.history[0]["learning_rate"] == 1e-4
    assert np.isfinite(result.history[0]["loss/cost"])


def test_bfloat16_agrees_with_float32(tasks, val, tmp_path):
    config = tiny_config(epochs=8)
    exact = train(config, tasks, {"val": val}, tmp_path / "exact", quiet=True)
    config["hardware"]["precision"] = "bf16"
    coarse = train(config, tasks, {"val": val}, tmp_path / "coarse", quiet=True)
    for metric in ("feasibility_accuracy/val", "cost_error/val"):
        assert coarse.metrics[metric] == pytest.approx(exact.metrics[metric], abs=0.05)


def test_training_leaves_the_global_random_state_alone(tasks, val, tmp_path):
    torch.manual_seed(5)
    expected = torch.rand(1)
    torch.manual_seed(5)
    train(tiny_config(epochs=1), tasks[:16], {"val": val[:8]}, tmp_path, quiet=True)
    assert torch.rand(1) == expected


@pytest.mark.parametrize(
    ("part", "message"),
    [
        ({"selection": {"set": "test"}}, "trainer.selection.set: 'test' is not one of the validation sets val"),
        ({"epochs": 0}, "trainer.epochs is 0; need at least 1"),
        ({"ema": 1.0}, "trainer.ema is 1.0; need less than 1"),
        ({"early_stopping": 0}, "trainer.early_stopping is 0; need at least 1"),
        ({"splits": []}, "trainer.splits is []; need a list of at least 1"),
        ({"share": 0.0}, "trainer.share is 0.0; need a positive number"),
        (
            {"stream": True, "residues": [0]},
            "trainer.stream is True; need false where share is below 1 or residues is set",
        ),
        ({"optimiser": {}}, "trainer: unknown key 'optimiser'; did you mean 'optimizer'?"),
        ({"batch": {"by": "patch"}}, "trainer.batch.by is 'patch'; need 'map' or 'task'"),
        ({"optimizer": {"lr": "high"}}, "trainer.optimizer.lr is 'high'; need a finite number"),
    ],
)
def test_wrong_configurations_are_named(tasks, val, tmp_path, part, message):
    with pytest.raises(InputError) as error:
        train(tiny_config(**part), tasks, {"val": val}, tmp_path)
    assert message in str(error.value)
