"""Common command line for all stages: overrides, sweeps, folders, one-line errors."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path

from omegaconf import OmegaConf

from hdsp.base.files import replacing

from .command_line import CommandLine, ends_in_one_line, parse, show
from .config import compose, read_params, typed
from .config_types import Config
from .folders import Folders, project_root, read_json, write_json
from .seconds import timed

__all__ = ["Folders", "Stage", "project_root", "read_json", "run_stage", "write_json"]

Stage = Callable[..., object]


def run_stage(
    stage: Stage,
    name: str,
    positional: Sequence[str] = (),
    sweep_context: Callable[[Sequence[str]], contextlib.AbstractContextManager] | None = None,
    place: Callable[[Config], str] | None = None,
) -> None:
    """Runs `stage(config, folders, *positional)` with the configuration from the command line.

    Without overrides, the configuration is params.yaml, and outputs go to the paths in dvc.yaml. With Hydra overrides,
    or a configuration of its own (`--config-dir`, `--config-name`), it is composed, and outputs go to a new folder
    under outputs/, so that DVC's files stay unchanged. A stage with a `place` writes its outputs there in both cases,
    unless `runtime.outputs` names another folder. With `-m`, Hydra runs every combination of choices inside
    `sweep_context`. Hydra answers its own flags (`--help`, `--cfg job`, `--info`). Bad input ends the process with one
    line and exit status 1, Ctrl-C with status 130, SIGTERM with status 143.
    """
    with ends_in_one_line():
        _run(stage, name, positional, sweep_context, place)


def _run(
    stage: Stage,
    name: str,
    positional: Sequence[str],
    sweep_context: Callable[[Sequence[str]], contextlib.AbstractContextManager] | None,
    place: Callable[[Config], str] | None,
) -> None:
    line = parse(sys.argv[1:], name, positional)
    if line.flags:
        show(name, positional, line)
    elif line.sweep:
        from .sweeps import checked_choices, sweep

        varied = checked_choices(line)  # before the sweep leaves a trace
        with (sweep_context or contextlib.nullcontext)(line.overrides):
            sweep(stage, name, line, varied)
    elif line.is_plain:
        config = read_params()
        with timed(name, line.arguments):
            stage(config, _folders(config, name, line, place), *line.arguments)
    else:
        composed = compose(line.overrides, line.source)
        config = typed(composed)
        folders = _folders(config, name, line, place)
        keep_overrides(folders, name, OmegaConf.to_yaml(composed), OmegaConf.to_yaml(list(line.overrides)))
        stage(config, folders, *line.arguments)


def keep_overrides(folders: Folders, name: str, config: str, overrides: str) -> None:
    """Writes configuration and overrides of a run beside its outputs, as Hydra does in a sweep."""
    for file, text in (("config.yaml", config), ("overrides.yaml", overrides)):
        with replacing(folders.write(".hydra", name, file)) as path:
            path.write_text(text, encoding="utf-8")


def _folders(config: Config, name: str, line: CommandLine, place: Callable[[Config], str] | None = None) -> Folders:
    outputs = config.runtime.outputs
    if outputs is None and place is not None:
        outputs = place(config)
    elif outputs is None:
        # Further processes of a training are started by the first one, with its environment.
        began = os.environ.setdefault("HDSP_RUN_BEGAN", f"{datetime.now():%Y-%m-%d_%H-%M-%S}")
        outputs = "." if line.is_plain else f"outputs/{name}/{began}"
    if not line.is_plain:
        print(f"writing to {outputs}", file=sys.stderr)
    return Folders(Path(config.runtime.inputs), Path(outputs), line.overrides)
