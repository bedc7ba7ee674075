"""The study of a search: Optuna's record of all trials, new or continued, and the settings that its trials share."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.override_parser.types import ChoiceSweep, IntervalSweep, Override, RangeSweep

from hdsp.base.errors import InputError
from hdsp.base.files import made_folder
from hdsp.base.messages import one_line, shown, without_password

from .config import flatten
from .config_types import Config
from .finished_runs import deciding_settings
from .started_by import has_ended

if TYPE_CHECKING:
    from optuna import Study
    from optuna.distributions import BaseDistribution

#: Attributes of a trial: the process that runs it; the folder of the killed trial whose training it continues.
PROCESS, PLACE = "process", "place"
#: Attribute of a study with all settings that its trials share, written at once: several processes may begin a search.
SHARED = "shared"
#: Names of differing settings in a message.
_SHOWN = 3
_ANOTHER = "give another search.name"


def open_study(config: Config) -> Study:
    """Returns the study in its storage, new or continued.

    A trial that a killed process left open counts as failed, and the next one continues its training.

    Raises:
        InputError: Optuna is not installed, or the storage cannot be used.
    """
    try:
        import optuna
    except ImportError as error:
        raise InputError("a search needs Optuna: pip install 'hdsp[sweeps]'") from error
    optuna.logging.set_verbosity(logging.WARNING)
    settings = config.search
    with _storage(config):
        if config.search.storage is None:
            made_folder(_folder(config))
        study = optuna.create_study(
            storage=study_place(config),
            study_name=settings.name,
            direction=settings.direction,
            load_if_exists=True,
        )
        # A continued search draws other values than the first call. The sampler takes seeds of 32 bits.
        seed = (settings.seed + len(study.get_trials(deepcopy=False))) % 2**32
        study.sampler = optuna.samplers.TPESampler(seed=seed)
        for trial in study.get_trials(states=(optuna.trial.TrialState.RUNNING,)):
            if has_ended(trial.user_attrs.get(PROCESS, "")):
                study.tell(trial.number, state=optuna.trial.TrialState.FAIL)
                study.enqueue_trial(trial.params, user_attrs={PLACE: place_of(trial)})
    return study


def check_same_search(study: Study, config: Config, space: Mapping[str, Override]) -> dict[str, BaseDistribution]:
    """Returns the distributions of a search, and refuses a study whose trials have other settings.

    The study keeps the settings of its first search; a value of one search is compared with none of another.

    Raises:
        InputError: metric, direction, space or a setting of the trainings differs from those of the study's trials.
    """
    distributions = {key: distribution(override) for key, override in space.items()}
    texts = {key: str(override.input_line).partition("=")[2] for key, override in space.items()}
    shared: dict[str, Any] = {
        "search": {"metric": config.search.metric, "direction": config.search.direction, "space": texts},
        **deciding_settings(config),
    }
    kept = study.user_attrs.get(SHARED)
    own = f"search {study.study_name!r} in {shown_place(config)}"
    if kept and (differing := _differing(kept, shared)):
        more = f" and {len(differing) - _SHOWN} more" if len(differing) > _SHOWN else ""
        raise InputError(f"{own} began with other settings: {'; '.join(differing[:_SHOWN])}{more}; {_ANOTHER}")
    if (direction := study.direction.name.lower()) != config.search.direction:
        raise InputError(f"{own} has the direction {direction}, not {config.search.direction}; {_ANOTHER}")
    for trial in study.get_trials(deepcopy=False):
        for key, old in trial.distributions.items():
            if distributions.get(key) != old:
                raise InputError(f"{own} has trials with another {key}, {old}; {_ANOTHER}")
    if not kept:
        study.set_user_attr(SHARED, shared)
    return distributions


def _differing(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Values that differ, in words; those of the search itself first."""
    old, new = flatten(before), flatten(now)
    names = [name for name in {**new, **old} if old.get(name) != new.get(name)]
    return [f"{name} was {shown(old.get(name))}, is {shown(new.get(name))}" for name in names]


def study_place(config: Config) -> str:
    """Returns the address of the study's storage."""
    return config.search.storage or f"sqlite:///{(_folder(config) / 'optuna.db').resolve()}"


def shown_place(config: Config) -> str:
    """Returns the address of the storage without a password, for messages and records."""
    return without_password(study_place(config))


def place_of(trial: Any) -> str:
    """Returns the name of a trial's folder."""
    return trial.user_attrs.get(PLACE, str(trial.number))


def study_values(study: Study) -> list[float]:
    """Values of all finished trials."""
    return [trial.values[0] for trial in study.get_trials(deepcopy=False) if trial.state.name == "COMPLETE"]


def distribution(override: Override) -> BaseDistribution:
    """Returns the distribution behind an override that varies.

    Raises:
        InputError: it has no values in common with Optuna, for example an interval with its ends exchanged.
    """
    try:
        found = _distribution(override)
    except ValueError as error:
        raise InputError(f"search: {override.input_line}: {one_line(error)}") from error
    if found is None:
        raise InputError(f"search: {override.input_line} is no interval, range or choice")
    return found


def _distribution(override: Override) -> BaseDistribution | None:
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
    return None


def _folder(config: Config) -> Path:
    return Path(config.runtime.outputs or "outputs") / "search"


@contextmanager
def _storage(config: Config) -> Iterator[None]:
    """Tells in one line of a storage that cannot be used; databases and their drivers have errors of many kinds."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        words = one_line(str(error).partition("\n")[0]) or type(error).__name__
        raise InputError(f"cannot use search.storage {shown_place(config)}: {words}") from error
