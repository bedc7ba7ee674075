"""Stage configuration: composed from conf/ by Hydra, or read from the params.yaml that DVC watches.

`python -m pipeline.config` composes conf/ into params.yaml, with the same bytes as `dvc exp run`. Overrides are
applied, e.g. `python -m pipeline.config profile=paper`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from hdsp.base.errors import InputError
from hdsp.base.files import replacing

CONF = Path(__file__).resolve().parent.parent / "conf"
PARAMS = Path("params.yaml")

Settings = TypeVar("Settings")


#: Mappings to which a command line may add entries without Hydra's +.
OPEN = ("evaluation.sets.",)


def compose(overrides: Sequence[str] = ()) -> DictConfig:
    """Composes conf/ with Hydra overrides; all interpolations are resolved.

    Raises:
        InputError: a key or group choice is unknown, or an override cannot be parsed.
    """
    GlobalHydra.instance().clear()
    overrides = [f"++{override}" if override.startswith(OPEN) else override for override in overrides]
    try:
        with initialize_config_dir(str(CONF), version_base=None):
            config = hydra_compose("config", overrides=list(overrides))
        OmegaConf.resolve(config)
    except (HydraException, OmegaConfBaseException) as error:
        raise InputError(_one_line(error, overrides)) from error
    return config


def read_params(path: Path = PARAMS) -> DictConfig:
    """Reads the configuration for `dvc repro`.

    Raises:
        InputError: the file does not exist, or is not a mapping.
    """
    if not path.is_file():
        raise InputError(f"{path} not found: run stages in the project's root, or compose it with `make params`")
    config = OmegaConf.load(path)
    if not isinstance(config, DictConfig):
        raise InputError(f"{path} is not a mapping: compose it anew with `make params`")
    OmegaConf.set_struct(config, True)
    return config


def write_params(path: Path = PARAMS, overrides: Sequence[str] = ()) -> None:
    """Composes conf/ into params.yaml, byte for byte as `dvc exp run` does."""
    text = OmegaConf.to_yaml(compose(overrides))
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def plain(section: Any) -> Any:
    """Converts a section to plain dicts, lists and numbers."""
    return OmegaConf.to_container(section, resolve=True) if OmegaConf.is_config(section) else section


def settings(kind: type[Settings], section: Any, where: str) -> Settings:
    """Builds a settings dataclass from a configuration section; lists become tuples.

    Raises:
        InputError: a key is unknown; the message names it and the allowed keys.
    """
    values = plain(section)
    allowed = sorted(f.name for f in fields(kind))  # type: ignore[arg-type]
    if unknown := sorted(set(values) - set(allowed)):
        raise InputError(f"unknown config key {where}.{unknown[0]}; allowed are {', '.join(allowed)}")
    return kind(**{name: _frozen(value) for name, value in values.items()})


def flatten(section: Any, prefix: str = "") -> dict[str, Any]:
    """Flattens nested mappings to one level with dotted names, for MLflow parameters."""
    flat: dict[str, Any] = {}
    for name, value in plain(section).items():
        value = plain(value)
        if isinstance(value, dict):
            flat |= flatten(value, f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = value
    return flat


def expand_choices(overrides: Sequence[str]) -> list[list[str]]:
    """Expands `a=1,2 b=3` to `[[a=1, b=3], [a=2, b=3]]`: one list for each value in a sweep.

    Only one override varies at a time, which is enough to check every value before a sweep begins.

    Raises:
        InputError: an override cannot be parsed.
    """
    try:
        parsed = OverridesParser.create().parse_overrides(list(overrides))
        choices: list[list[Any]] = [
            list(o.sweep_string_iterator()) if o.is_sweep_override() else [o.input_line] for o in parsed
        ]
    except HydraException as error:
        raise InputError(_one_line(error, overrides)) from error
    for i, override in enumerate(parsed):
        if override.is_sweep_override():
            choices[i] = [f"{override.get_key_element()}={value}" for value in choices[i]]
    first = [values[0] for values in choices]
    variants = [[*first[:i], value, *first[i + 1 :]] for i, values in enumerate(choices) for value in values[1:]]
    return [first, *variants]


def _frozen(value: Any) -> Any:
    return tuple(_frozen(item) for item in value) if isinstance(value, list) else value


def _one_line(error: Exception, overrides: Sequence[str]) -> str:
    """Shortens Hydra's message to one line with the key and the allowed keys beside it."""
    text = " ".join(str(error).split())
    for override in overrides:
        key = override.split("=")[0].lstrip("+~")
        if f"Could not override '{key}'" in text or f"Key '{key.split('.')[-1]}' is not in struct" in text:
            return f"unknown config key {key!r}; {_allowed_beside(key)}"
    return text.split(" Config search path:")[0].split(" See https:")[0]


def _allowed_beside(key: str) -> str:
    node: Any = compose()
    path: list[str] = []
    for part in key.split(".")[:-1]:
        if not isinstance(node, DictConfig) or part not in node:
            break
        node, path = node[part], [*path, part]
    keys = ", ".join(sorted(str(k) for k in node)) if isinstance(node, DictConfig) else "none: it is a value"
    return f"allowed under {'.'.join(path) or 'the root'}: {keys}"


if __name__ == "__main__":
    try:
        write_params(overrides=sys.argv[1:])
    except InputError as error:
        sys.exit(f"error: {error}")
