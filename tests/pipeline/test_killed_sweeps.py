"""A sweep that `kill -9` ended continues in its folder: finished runs stay, the interrupted one resumes."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import lightning.pytorch as pl
import pytest

from hdsp.learning import train
from pipeline.command_line import parse
from pipeline.sweeps import checked_choices, sweep
from tests import ROOT
from tests.learning.synthetic import synthetic_tasks, tiny_config


class KillAll(pl.Callback):
    """Ends all processes of the sweep at once, within an epoch after a checkpoint."""

    def on_train_batch_start(self, trainer, module, batch, index):
        if (trainer.current_epoch, index) == (1, 1):
            os.killpg(0, signal.SIGKILL)


def trained(config, folders) -> float:
    """A real training; until a file says that it happened, the one with seed 1 ends the sweep."""
    seed, happened = config.trainer.seed, folders.inputs / "happened"
    result = training(seed, folders.outputs, [KillAll()] * (seed == 1 and not happened.exists()))
    with (folders.inputs / "log.txt").open("a") as file:
        file.write(f"{seed} from epoch {result.resumed_from}\n")
    return result.metrics["score"]


def training(seed: int, folder: Path, callbacks=()):
    tasks, settings = synthetic_tasks(48), tiny_config(epochs=2, seed=seed, checkpoint_minutes=1e-7)
    return train(settings, tasks, {"val": tasks}, folder, callbacks=callbacks, quiet=True)


def swept(folder: Path, launcher: str) -> None:
    words = [f"runtime.inputs={folder}", f"hydra.sweep.dir={folder / 'runs'}", f"hydra/launcher={launcher}"]
    line = parse(["trainer.seed=0,1", "profile=tiny", *words, "-m"], "train")
    sweep(trained, "train", line, checked_choices(line))


@pytest.mark.parametrize("launcher", ["basic", pytest.param("joblib", marks=pytest.mark.nightly)])
def test_a_killed_sweep_continues_to_the_same_weights(tmp_path, launcher):
    if launcher == "joblib":
        pytest.importorskip("hydra_plugins.hydra_joblib_launcher")
    script = f"from tests.pipeline.test_killed_sweeps import *; swept(Path({str(tmp_path)!r}), {launcher!r})"
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, start_new_session=True)
    assert done.returncode == -signal.SIGKILL, done.stderr
    (tmp_path / "happened").touch()
    swept(tmp_path, launcher)
    log = (tmp_path / "log.txt").read_text().splitlines()
    assert sorted(log)[-1] == "1 from epoch 1"
    assert launcher != "basic" or log == ["0 from epoch 0", "1 from epoch 1"], "a finished run is not repeated"
    undisturbed = training(1, tmp_path / "undisturbed").model_dir / "model.safetensors"
    assert (tmp_path / "runs/1/model/model.safetensors").read_bytes() == undisturbed.read_bytes()
