"""Sweeps by Hydra's multirun, with any launcher: each run leaves a record, and a failed run makes the sweep fail.

The same sweep with the same `hydra.sweep.dir` continues after a kill: finished runs stay.
"""

from __future__ import annotations

import os
import sys
import tempfile
import traceback
from collections.abc import Callable, Collection, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from hdsp.base.errors import InputError

from .command_line import CommandLine, run_hydra
from .config import configure, configured_choices, expand_choices, parse_overrides, typed
from .config_types import Config
from .finished_runs import once, run_digest
from .folders import Folders, read_json, write_json

#: Environment variable with the folder for records; runs in other processes inherit it.
RECORDS = "HDSP_SWEEP_RECORDS"


def checked_choices(line: CommandLine) -> set[str]:
    """Checks all values of a sweep; returns the keys that vary.

    Raises:
        InputError: a value is wrong, or `runtime.outputs` is given: each run has a folder of its own.
    """
    if any(override.get_key_element().lstrip("+") == "runtime.outputs" for override in parse_overrides(line.overrides)):
        raise InputError("runtime.outputs: each run of a sweep has its own folder; give hydra.sweep.dir=FOLDER for all")
    words = [*configured_choices(line.overrides, line.source), *line.overrides]
    for variant in expand_choices(words):
        configure(variant, line.source)
    return {
        override.get_key_element().lstrip("+") for override in parse_overrides(words) if override.is_sweep_override()
    }


def sweep(stage: Callable[..., Any], name: str, line: CommandLine, varied: Collection[str]) -> None:
    """Runs a stage for every combination of choices. A run that fails does not end the others.

    Args:
        stage: the function that Hydra runs.
        name: stage.
        line: command line.
        varied: keys from `checked_choices`.

    Raises:
        InputError: runs failed, all of which are named.
    """
    with tempfile.TemporaryDirectory(prefix="hdsp-sweep-") as folder:
        before, os.environ[RECORDS] = os.environ.get(RECORDS), folder
        try:
            run = SweptRun(stage, name, line.arguments, folder, varied)
            run_hydra(run, name, line, ["-m", "hydra.output_subdir=.hydra"])
        except SystemExit as error:  # Hydra has printed why
            raise InputError("; ".join(failures(Path(folder))) or f"{name}: the sweep ended early") from error
        finally:
            if before is None:
                del os.environ[RECORDS]
            else:
                os.environ[RECORDS] = before
        if failed := failures(Path(folder)):
            total = len(list(Path(folder).glob("*.json")))
            raise InputError(f"{len(failed)} of {total} runs failed: {'; '.join(failed)}")


class SweptRun:
    """A run of a sweep; a plain object, so that launchers can send it to other processes."""

    def __init__(
        self, stage: Callable[..., Any], name: str, arguments: Sequence[str], records: str, varied: Collection[str]
    ):
        self.stage, self.name, self.arguments = stage, name, tuple(arguments)
        self.records, self.varied = records, varied
        self.__name__ = self.__qualname__ = getattr(stage, "__name__", "stage")

    def __call__(self, config: DictConfig) -> float:
        """Runs the stage; returns its value, NaN after a failure."""
        from hydra.core.hydra_config import HydraConfig

        here = HydraConfig.get()
        overrides = tuple(here.overrides.task)
        varied = tuple(word for word in overrides if word.partition("=")[0].lstrip("+") in self.varied)
        words = f"run {here.job.num} ({' '.join(varied)})"
        record = Path(self.records, f"{here.job.num}.json")
        write_json(record, {"run": words, "fault": "its process ended before the run did"})
        print(words, file=sys.stderr, flush=True)
        fault, value = None, float("nan")
        try:
            checked = typed(config)
            folders = Folders(Path(checked.runtime.inputs), Path(here.runtime.output_dir), overrides, varied)
            digest = run_digest(checked, self.name, self.arguments)
            value = once(folders.outputs, digest, partial(self.work, checked, folders))
        except InputError as error:
            fault = str(error)
        except Exception as error:
            traceback.print_exc()
            fault = f"{type(error).__name__}: {error}"
        write_json(record, {"run": words, "fault": fault})
        return value

    def work(self, config: Config, folders: Folders) -> float:
        """Runs the stage; returns its value, NaN without one."""
        found = self.stage(config, folders, *self.arguments)
        return float("nan") if found is None else float(found)


def failures(folder: Path) -> list[str]:
    """Returns a line for each failed run, from the records in a folder."""
    records = [read_json(path) for path in sorted(folder.glob("*.json"), key=lambda path: int(path.stem))]
    return [f"{record['run']}: {record['fault']}" for record in records if record["fault"] is not None]
