"""Stage configuration: composed from conf/ by Hydra, or read from the params.yaml that DVC watches.

`python -m pipeline.config` composes conf/ into params.yaml, with the same bytes as `dvc exp run`. Overrides are
applied, e.g. `python -m pipeline.config profile=paper`.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any

from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf

from hdsp.base.errors import InputError
from hdsp.base.files import replacing
from hdsp.base.settings import load_settings, read_yaml, shown, unknown_key
from pipeline.config_types import Config

CONF = Path(__file__).resolve().parent.parent / "conf"
PARAMS = Path("params.yaml")

#: Mappings to which a command line may add entries without Hydra's +.
OPEN = ("evaluation.sets.",)


def compose(overrides: Sequence[str] = ()) -> DictConfig:
    """Composes conf/ with Hydra overrides; all interpolations are resolved. `configure` also checks the values.

    Raises:
        InputError: a key or group choice is unknown, or an override cannot be parsed.
    """
    GlobalHydra.instance().clear()
    overrides = [f"++{override}" if override.startswith(OPEN) else override for override in overrides]
    try:
        with initialize_config_dir(str(CONF), version_base=None):
            config = hydra_compose("config", overrides=list(overrides))
        OmegaConf.resolve(config)
    except Exception as error:  # Hydra and OmegaConf raise exceptions of many kinds at unusual overrides
        raise InputError(_one_line(error, overrides)) from error
    return config


def configure(overrides: Sequence[str] = ()) -> Config:
    """Composes conf/ with Hydra overrides, and checks all values.

    Raises:
        InputError: as `compose`; or a key is unknown or missing, or a value is wrong.
    """
    return typed(compose(overrides))


def typed(config: DictConfig) -> Config:
    """Checks all values of a composed configuration.

    Raises:
        InputError: a key is unknown or missing, or a value is wrong.
    """
    return load_settings(Config, plain(config))


def read_params(path: Path = PARAMS) -> Config:
    """Reads the configuration for `dvc repro`, and checks all values.

    Raises:
        InputError: the file does not exist or is no YAML mapping; a key is unknown or missing, or a value is wrong.
    """
    if not path.is_file():
        raise InputError(f"{path} not found: run stages in the project's root, or compose it with `make params`")
    document = read_yaml(path, "params file")
    return load_settings(Config, document.values, source=document)


def write_params(path: Path = PARAMS, overrides: Sequence[str] = ()) -> None:
    """Composes conf/ into params.yaml, byte for byte as `dvc exp run` does."""
    text = OmegaConf.to_yaml(compose(overrides))
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def plain(section: Any) -> Any:
    """Converts settings to plain dicts, lists and numbers."""
    if OmegaConf.is_config(section):
        return OmegaConf.to_container(section, resolve=True)
    if is_dataclass(section) and not isinstance(section, type):
        section = asdict(section)
    if isinstance(section, Mapping):
        return {name: plain(value) for name, value in section.items()}
    return [plain(value) for value in section] if isinstance(section, list | tuple) else section


def flatten(section: Any, prefix: str = "") -> dict[str, Any]:
    """Flattens nested mappings to one level with dotted names, for MLflow parameters."""
    flat: dict[str, Any] = {}
    for name, value in plain(section).items():
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


def _one_line(error: Exception, overrides: Sequence[str]) -> str:
    """Shortens Hydra's message of many lines to the key and the allowed alternatives."""
    text = " ".join(str(error).split())
    for override in overrides:
        key = override.split("=")[0].lstrip("+~")
        missing = f"Could not override '{key}'" in text or f"Key '{key.split('.')[-1]}' is not in struct" in text
        if missing and (words := _unknown(key)):
            return words
    text = text.split(" Config search path:")[0].split(" See https:")[0] or type(error).__name__
    named = any(override.split("=")[0].lstrip("+~") in text for override in overrides)
    return text if named else f"cannot apply {' '.join(overrides) or 'the defaults'}: {text}"


@cache
def _without_overrides() -> DictConfig:
    return compose()


def _unknown(key: str) -> str:
    """Names the part of a key that does not exist; empty if all do."""
    node, path = _without_overrides(), ""
    for part in key.split("."):
        if not isinstance(node, DictConfig):
            return f"{path} is {shown(plain(node))}, a value without keys; {part!r} is unknown"
        if part not in node:
            return (f"{path}: " if path else "") + unknown_key(part, map(str, node))
        node, path = node[part], f"{path}.{part}" if path else part
    return ""


if __name__ == "__main__":
    try:
        write_params(overrides=sys.argv[1:])
    except InputError as error:
        sys.exit(f"error: {error}")
