"""Search for the best settings of a training with Optuna; each trial is a run of `pipeline.train` in its own process.

    python -m pipeline.search search=learning_rate search.trials=6
    python -m pipeline.search 'trainer.optimizer.lr=tag(log, interval(1e-4, 1e-2))' 'model=choice(compact, swept)'

The space is in Hydra's syntax: `interval(A, B)`, `int(interval(A, B))`, `range(A, B, STEP)`, `choice(...)` or `A,B`,
and `tag(log, ...)` for a logarithmic scale. All values and ends are checked before the first trial. The storage keeps
each trial: a search that was killed continues, and several processes with one storage share the work. Trials are child
runs in MLflow. A failed trial makes the search end with exit status 1.
"""

from __future__ import annotations

import logging
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.override_parser.types import ChoiceSweep, IntervalSweep, Override, RangeSweep

from hdsp.base.ending import Ended, end_children
from hdsp.base.errors import InputError

from . import tracking
from .command_line import PACKAGE, CommandLine, ends_in_one_line, parse
from .config import configure, expand_choices, parse_overrides
from .config_types import Config
from .folders import read_json, write_json
from .started_by import has_ended, this_process

#: Attributes of a trial: the process that runs it; the folder of the killed trial whose training it continues.
PROCESS, PLACE = "process", "place"

if TYPE_CHECKING:
    from optuna import Study
    from optuna.distributions import BaseDistribution


def search(line: CommandLine) -> dict[str, Any]:
    """Runs all trials; returns the best one: `value`, `overrides`, `trials`, `folder`.

    Raises:
        InputError: a setting is wrong, Optuna is not installed, or trials failed, all of which are named.
    """
    given = parse_overrides(line.overrides)
    fixed = [str(override.input_line) for override in given if not override.is_sweep_override()]
    config = configure(fixed, line.source)
    settings = config.search
    named = parse_overrides([f"{key}={text}" for key, text in settings.space.items()])
    space = {override.get_key_element(): override for override in [*named, *given] if override.is_sweep_override()}
    if not space:
        raise InputError("search: nothing varies; give search=NAME, or KEY=interval(A, B) or KEY=choice(A, B)")
    for variant in expand_choices([*fixed, *(str(override.input_line) for override in space.values())]):
        configure(variant, line.source)
    distributions = {key: distribution(override) for key, override in space.items()}
    study = open_study(config)
    folder = Path(config.runtime.outputs or "outputs") / "search" / settings.name
    folder.mkdir(parents=True, exist_ok=True)
    best: dict[str, Any] = {}
    with tracking.sweep(line.overrides, f"{study_place(config)} {settings.name}"):
        failed = run_trials(study, distributions, config, [*own_flags(line), *fixed], folder)
        if study_values(study):
            overrides, trials = words_of(study.best_trial.params), len(study_values(study))
            best = {"value": study.best_value, "overrides": overrides, "trials": trials, "folder": str(folder)}
            write_json(folder / "best.json", best)
            print(f"best of {trials} trials: {study.best_value:.6g} with {' '.join(overrides)}")
        if failed:
            raise InputError(f"{len(failed)} trials failed: {'; '.join(failed)}")
    return best


def open_study(config: Config) -> Study:
    """Returns the study in its storage, new or continued.

    A trial that a killed process left open counts as failed, and the next one continues its training.
    """
    try:
        import optuna
    except ImportError as error:
        raise InputError("a search needs Optuna: pip install 'hdsp[sweeps]'") from error
    optuna.logging.set_verbosity(logging.WARNING)
    settings = config.search
    (Path(config.runtime.outputs or "outputs") / "search").mkdir(parents=True, exist_ok=True)
    study = optuna.create_study(
        storage=study_place(config),
        study_name=settings.name,
        direction=settings.direction,
        load_if_exists=True,
    )
    # A continued search draws other values than the first call.
    study.sampler = optuna.samplers.TPESampler(seed=settings.seed + len(study.get_trials(deepcopy=False)))
    for trial in study.get_trials(states=(optuna.trial.TrialState.RUNNING,)):
        if has_ended(trial.user_attrs.get(PROCESS, "")):
            study.tell(trial.number, state=optuna.trial.TrialState.FAIL)
            study.enqueue_trial(trial.params, user_attrs={PLACE: place_of(trial)})
    return study


def study_place(config: Config) -> str:
    """Returns the address of the study's storage."""
    folder = Path(config.runtime.outputs or "outputs") / "search"
    return config.search.storage or f"sqlite:///{(folder / 'optuna.db').resolve()}"


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
            value = metric_of(read_json(place / "reports" / "training.json"), config.search.metric)
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


def place_of(trial: Any) -> str:
    """Returns the name of a trial's folder."""
    return trial.user_attrs.get(PLACE, str(trial.number))


def study_values(study: Study) -> list[float]:
    """Values of all finished trials."""
    return [trial.values[0] for trial in study.get_trials(deepcopy=False) if trial.state.name == "COMPLETE"]


def metric_of(report: Mapping[str, Any], name: str) -> float:
    """Returns a metric from `reports/training.json`, `GROUP/SET` for a nested one.

    Raises:
        InputError: there is no such number.
    """
    found: Any = report
    for part in name.split("/"):
        found = found.get(part) if isinstance(found, Mapping) else None
    if not isinstance(found, int | float):
        raise InputError(f"search.metric: {name!r} is no number of this training; it has {', '.join(report)}")
    return float(found)


def words_of(values: Mapping[str, Any]) -> list[str]:
    """Values as overrides."""
    return [f"{key}={value}" for key, value in values.items()]


def own_flags(line: CommandLine) -> list[str]:
    """Flags that tell a trial where the configuration is."""
    folder = ["--config-dir", str(line.source.folder)] if line.source.folder is not None else []
    return [*folder, "--config-name", line.source.name]


def distribution(override: Override) -> BaseDistribution:
    """Returns the distribution behind an override that varies.

    Raises:
        InputError: it has no values in common with Optuna.
    """
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

    value = override.value()
    log = "log" in getattr(value, "tags", ())
    if isinstance(value, IntervalSweep):
        assert value.start is not None and value.end is not None
        if isinstance(value.start, int) and isinstance(value.end, int):
            return IntDistribution(value.start, value.end, log=log)
        return FloatDistribution(float(value.start), float(value.end), log=log)
    if isinstance(value, RangeSweep) and isinstance(value.start, int) and isinstance(value.stop, int):
        return IntDistribution(value.start, value.stop - 1, step=int(value.step))
    if isinstance(value, ChoiceSweep | RangeSweep):
        return CategoricalDistribution([str(text) for text in override.sweep_string_iterator()])
    raise InputError(f"search: {override.input_line} is no interval, range or choice")


if __name__ == "__main__":
    with ends_in_one_line():
        search(parse(sys.argv[1:], "search"))
