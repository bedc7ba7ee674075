"""Search for the best settings of a training with Optuna; each trial is a run of `pipeline.train` in its own process.

    python -m pipeline.search search=learning_rate search.trials=6
    python -m pipeline.search 'trainer.optimizer.lr=tag(log, interval(1e-4, 1e-2))' 'model=choice(compact, swept)'

The space is in Hydra's syntax: `interval(A, B)`, `int(interval(A, B))`, `range(A, B, STEP)`, `choice(...)` or `A,B`,
and `tag(log, ...)` for a logarithmic scale; a plain value holds for all trials. All values and ends are checked before
the first trial. The storage keeps each trial: a search that was killed continues, and several processes with one
storage share the work; a search with other settings needs another `search.name`. Trials are child runs in MLflow. A
failed trial makes the search end with exit status 1.
"""

from __future__ import annotations

import math
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.override_parser.types import Override

from hdsp.base.ending import Ended, end_children
from hdsp.base.errors import InputError
from hdsp.base.files import made_folder

from . import tracking
from .command_line import PACKAGE, CommandLine, ends_in_one_line, parse
from .config import configure, expand_choices, parse_overrides
from .config_types import Config, SearchSettings
from .folders import read_json, write_json
from .search_study import PROCESS, check_same_search, open_study, place_of, shown_place, study_values
from .started_by import this_process

if TYPE_CHECKING:
    from optuna import Study
    from optuna.distributions import BaseDistribution


def search(line: CommandLine) -> dict[str, Any]:
    """Runs all trials; returns the best one: `value`, `overrides`, `trials`, `folder`.

    Raises:
        InputError: a setting is wrong, Optuna is not installed, or trials failed, all of which are named.
    """
    config, fixed, space = settings_and_space(line)
    settings = config.search
    for variant in expand_choices([*fixed, *(str(override.input_line) for override in space.values())]):
        configure(variant, line.source)
    study = open_study(config)
    distributions = check_same_search(study, config, space)
    folder = made_folder(Path(config.runtime.outputs or "outputs") / "search" / settings.name)
    best: dict[str, Any] = {}
    with tracking.sweep(line.overrides, f"{shown_place(config)} {settings.name}"):
        failed = run_trials(study, distributions, config, [*own_flags(line), *fixed], folder)
        if study_values(study):
            overrides, trials = words_of(study.best_trial.params), len(study_values(study))
            best = {"value": study.best_value, "overrides": overrides, "trials": trials, "folder": str(folder)}
            write_json(folder / "best.json", best)
            print(f"best of {trials} trials: {study.best_value:.6g} with {' '.join(overrides)}")
        if failed:
            raise InputError(f"{len(failed)} trials failed: {'; '.join(failed)}")
    return best


def settings_and_space(line: CommandLine) -> tuple[Config, list[str], dict[str, Override]]:
    """Returns the configuration without choices, its overrides, and the overrides that vary by key.

    Entries of `search.space` come before the words of the command; the last word about a key counts.

    Raises:
        InputError: a setting is wrong, or nothing varies.
    """
    given = parse_overrides(line.overrides)
    plain_ones = [str(override.input_line) for override in given if not override.is_sweep_override()]
    config = configure(plain_ones, line.source)
    named = config.search.space
    texts = [f"{key}={'null' if text is None else text}" for key, text in named.items()]
    last = {override.get_key_element().lstrip("+"): override for override in [*parse_overrides(texts), *given]}
    space = {o.get_key_element(): o for o in last.values() if o.is_sweep_override()}
    if not space:
        raise InputError("search: nothing varies; give search=NAME, or KEY=interval(A, B) or KEY=choice(A, B)")
    fixed = [str(o.input_line) for o in last.values() if not o.is_sweep_override()]
    return config if fixed == plain_ones else configure(fixed, line.source), fixed, space


def run_trials(
    study: Study, space: Mapping[str, BaseDistribution], config: Config, words: Sequence[str], folder: Path
) -> list[str]:
    """Runs the trials that are still missing; returns a line for each that failed."""
    from optuna.trial import TrialState

    def run(_: int) -> str | None:
        trial = study.ask(dict(space))
        trial.set_user_attr(PROCESS, this_process())
        chosen, place = words_of(trial.params), folder / place_of(trial)
        title = f"trial {trial.number} ({' '.join(chosen)})"
        print(title, flush=True)
        command = [sys.executable, "-m", f"{PACKAGE}.train", *chosen, *words, f"runtime.outputs={place}"]
        done = subprocess.run(command, stderr=subprocess.PIPE, text=True)
        if done.returncode:
            study.tell(trial, state=TrialState.FAIL)
            last = (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]
            return f"{title}: {last.removeprefix('error: ')}"
        try:
            value = metric_of(read_json(place / "reports" / "training.json"), config.search)
        except InputError as error:
            study.tell(trial, state=TrialState.FAIL)
            return f"{title}: {error}"
        study.tell(trial, value)
        print(f"trial {trial.number}: {config.search.metric} {value:.6g}", flush=True)
        return None

    missing = max(config.search.trials - len(study_values(study)), 0)
    pool = ThreadPoolExecutor(config.search.jobs)
    try:
        return [fault for fault in pool.map(run, range(missing)) if fault is not None]
    except Ended:
        end_children(signal.SIGTERM)
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def metric_of(report: Mapping[str, Any], settings: SearchSettings) -> float:
    """Returns a metric from `reports/training.json`, `GROUP/SET` for a nested one.

    A number that is not finite is null there; as a value, it is worse than all others.

    Raises:
        InputError: there is no such number.
    """
    found: Any = report
    for part in settings.metric.split("/"):
        found = found.get(part, "") if isinstance(found, Mapping) else ""
    if found is None:
        return -math.inf if settings.direction == "maximize" else math.inf
    if not isinstance(found, int | float):
        raise InputError(
            f"search.metric: {settings.metric!r} is no number of this training; it has {', '.join(report)}"
        )
    return float(found)


def words_of(values: Mapping[str, Any]) -> list[str]:
    """Values as overrides."""
    return [f"{key}={value}" for key, value in values.items()]


def own_flags(line: CommandLine) -> list[str]:
    """Flags that tell a trial where the configuration is."""
    folder = ["--config-dir", str(line.source.folder)] if line.source.folder is not None else []
    return [*folder, "--config-name", line.source.name]


if __name__ == "__main__":
    with ends_in_one_line():
        search(parse(sys.argv[1:], "search"))
