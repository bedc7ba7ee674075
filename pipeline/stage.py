"""Common command line for all stages: overrides, sweeps, folders, one-line errors."""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from hdsp.base.ending import Ended, ended_by
from hdsp.base.errors import InputError
from hdsp.base.files import replacing
from hdsp.base.settings import read_json as read_json_file
from pipeline.config import configure, expand_choices, read_params, typed
from pipeline.config_types import Config
from pipeline.seconds import timed

SWEEP_FLAGS = ("-m", "--multirun")


@dataclass(frozen=True)
class Folders:
    """Input folder with results from earlier stages, and output folder; each holds data/, models/ and reports/."""

    inputs: Path
    outputs: Path

    def read(self, *parts: str) -> Path:
        return self.inputs.joinpath(*parts)

    def write(self, *parts: str) -> Path:
        """Returns a path to write to; its folder exists."""
        path = self.outputs.joinpath(*parts)
        path.parent.mkdir(parents=True, exist_ok=True)
        return path


Stage = Callable[..., None]


def run_stage(
    stage: Stage,
    name: str,
    positional: Sequence[str] = (),
    sweep_context: Callable[[Sequence[str]], contextlib.AbstractContextManager] | None = None,
    place: Callable[[Config], str] | None = None,
) -> None:
    """Runs `stage(config, folders, *positional)` with the configuration from the command line.

    Without overrides, the configuration is params.yaml, and outputs go to the paths in dvc.yaml. With Hydra overrides,
    it is composed from conf/, and outputs go to a new folder under outputs/, so that DVC's files stay unchanged. A
    stage with a `place` writes its outputs there in both cases, unless `runtime.outputs` names another folder. With
    `-m` (only if `sweep_context` is given), Hydra runs every combination of choices inside this context. Bad input ends
    the process with one line and exit status 1, Ctrl-C with status 130, SIGTERM with status 143.
    """
    try:
        with ended_by(signal.SIGINT, signal.SIGTERM):
            _run(stage, name, positional, sweep_context, place)
    except InputError as error:
        sys.exit(f"error: {error}")
    except Ended as end:
        print(end, file=sys.stderr, flush=True)
        sys.exit(end.told())


def _run(
    stage: Stage,
    name: str,
    positional: Sequence[str],
    sweep_context: Callable[[Sequence[str]], contextlib.AbstractContextManager] | None,
    place: Callable[[Config], str] | None,
) -> None:
    arguments, overrides, sweep = _parse(sys.argv[1:], name, positional, sweep_context is not None)
    if sweep:
        assert sweep_context is not None  # _parse refuses -m without
        for variant in expand_choices(overrides):
            configure(variant)  # any wrong value is reported before the first run
        with sweep_context(overrides):
            _sweep(stage, name, arguments, overrides)
    else:
        config = configure(overrides) if overrides else read_params()
        with contextlib.nullcontext() if overrides else timed(name, arguments):
            stage(config, _folders(config, name, bool(overrides), place), *arguments)


def project_root() -> Path:
    """Returns the repository that holds the tracking database; `dvc exp run --temp` runs stages in a copy."""
    return Path(os.environ.get("DVC_ROOT") or Path(__file__).resolve().parent.parent)


def write_json(path: Path, values: Any) -> None:
    """Writes a JSON file, whole or absent; non-finite numbers become null, which every JSON reader accepts."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(_finite(values), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def read_json(path: Path) -> Any:
    """Returns the contents of an earlier stage's report.

    Raises:
        InputError: the file does not exist, or is not JSON.
    """
    return read_json_file(path, "report")


def _finite(values: Any) -> Any:
    if isinstance(values, dict):
        return {str(key): _finite(value) for key, value in values.items()}
    if isinstance(values, list | tuple):
        return [_finite(value) for value in values]
    if hasattr(values, "item"):  # numpy scalars
        values = values.item()
    return None if isinstance(values, float) and not math.isfinite(values) else values


def _parse(argv: Sequence[str], name: str, positional: Sequence[str], sweepable: bool):
    usage = " ".join([f"python -m pipeline.{name}", *(p.upper() for p in positional), "[group=choice] [key=value] ..."])
    sweep = any(a in SWEEP_FLAGS for a in argv)
    if sweep and not sweepable:
        raise InputError(f"{name} does not sweep (-m); usage: {usage}")
    overrides = [a for a in argv if "=" in a or a[0] in "+~"]
    arguments = [a for a in argv if a not in overrides and a not in SWEEP_FLAGS]
    if len(arguments) != len(positional) or any(a.startswith("-") for a in arguments):
        raise InputError(f"cannot read {' '.join(arguments) or 'an empty command line'!r}; usage: {usage}")
    return arguments, overrides, sweep


def _folders(config: Config, name: str, has_overrides: bool, place: Callable[[Config], str] | None = None) -> Folders:
    outputs = config.runtime.outputs
    if outputs is None and place is not None:
        outputs = place(config)
    elif outputs is None:
        outputs = f"outputs/{name}/{datetime.now():%Y-%m-%d_%H-%M-%S}" if has_overrides else "."
    if has_overrides:
        print(f"writing to {outputs}", file=sys.stderr)
    return Folders(Path(config.runtime.inputs), Path(outputs))


def _sweep(stage: Stage, name: str, arguments: Sequence[str], overrides: Sequence[str]) -> None:
    """Runs a sweep through Hydra's own multirun, so that its launchers work."""
    import hydra
    from hydra.core.hydra_config import HydraConfig

    from pipeline.config import CONF

    failed: list[str] = []

    def job(config: DictConfig) -> None:
        here = HydraConfig.get()
        print(f"run {here.job.num}: {' '.join(here.overrides.task)}", file=sys.stderr)
        try:
            checked = typed(config)
            stage(checked, Folders(Path(checked.runtime.inputs), Path(here.runtime.output_dir)), *arguments)
        except InputError as error:  # the sweep's other runs continue
            failed.append(f"run {here.job.num} ({' '.join(here.overrides.task)}): {error}")

    argv, sys.argv = sys.argv, [f"pipeline/{name}.py", "-m", *overrides]
    try:
        hydra.main(version_base=None, config_path=str(CONF), config_name="config")(job)()
    finally:
        sys.argv = argv
    if failed:
        raise InputError("; ".join(failed))
