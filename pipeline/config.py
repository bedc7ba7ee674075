"""Stage configuration: composed from conf/ by Hydra, or read from the params.yaml that DVC watches.

`python -m pipeline.config` composes conf/ into params.yaml, with the same bytes as `dvc exp run`. Overrides are
applied, e.g. `python -m pipeline.config profile=paper`. `--config-dir FOLDER` adds a folder with further groups and
choices; `--config-name NAME` begins with `NAME.yaml` in this folder instead of `config.yaml`.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any

from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Glob, IntervalSweep, Override
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf

from hdsp.base.errors import InputError
from hdsp.base.files import replacing
from hdsp.base.messages import shown, unknown_key
from hdsp.base.settings import load_settings
from hdsp.base.yaml_files import read_yaml

from .config_types import Config

_HERE = Path(__file__).resolve().parent
#: In a checkout, conf/ lies beside this package; in an installation, within it.
CONF = _HERE / "conf" if (_HERE / "conf").is_dir() else _HERE.parent / "conf"
PARAMS = Path("params.yaml")
CONFIG_NAME = "config"

#: Mappings to which a command line may add entries without Hydra's +.
OPEN = ("evaluation.sets.",)


@dataclass(frozen=True)
class Source:
    """Place of the configuration.

    Attributes:
        folder: folder with own groups and choices; None = only those of this package.
        name: file to begin with, without its suffix.
    """

    folder: Path | None = None
    name: str = CONFIG_NAME

    def primary(self) -> tuple[Path, list[str]]:
        """Returns the folder with the file `name`, and overrides that make the other folder known.

        Raises:
            InputError: the folder does not exist, or no folder has this file.
        """
        if self.folder is not None and not self.folder.is_dir():
            raise InputError(f"--config-dir {self.folder}: no such folder")
        folders = [self.folder.resolve()] if self.folder is not None else []
        for folder in folders:
            if self.name != CONFIG_NAME and (folder / f"{self.name}.yaml").is_file():
                return folder, [f"hydra.searchpath=[file://{CONF}]"]
        if self.name != CONFIG_NAME and not (CONF / f"{self.name}.yaml").is_file():
            raise InputError(f"--config-name {self.name}: no {self.name}.yaml in {self.folder or CONF}")
        return CONF, [f"hydra.searchpath=[file://{folder}]" for folder in folders]


def compose(overrides: Sequence[str] = (), source: Source | None = None, hydra: bool = False) -> DictConfig:
    """Composes conf/ with Hydra overrides; all interpolations are resolved. `configure` also checks the values.

    With `hydra`, the result has Hydra's own settings too, not resolved.

    Raises:
        InputError: a key or group choice is unknown, or an override cannot be parsed.
    """
    GlobalHydra.instance().clear()
    source = source or Source()
    folder, more = source.primary()
    overrides = with_open_keys(overrides)
    try:
        with initialize_config_dir(str(folder), version_base=None):
            config = hydra_compose(source.name, overrides=[*more, *overrides], return_hydra_config=hydra)
        if not hydra:
            OmegaConf.resolve(config)
    except Exception as error:  # Hydra and OmegaConf raise exceptions of many kinds at unusual overrides
        raise InputError(_one_line(error, overrides)) from error
    return config


def with_open_keys(overrides: Sequence[str]) -> list[str]:
    """Returns overrides as Hydra needs them to add entries to the mappings in `OPEN`."""
    return [f"++{override}" if override.startswith(OPEN) else override for override in overrides]


def configure(overrides: Sequence[str] = (), source: Source | None = None) -> Config:
    """Composes conf/ with Hydra overrides, and checks all values.

    Raises:
        InputError: as `compose`; or a key is unknown or missing, or a value is wrong.
    """
    return typed(compose(overrides, source))


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


def write_params(path: Path = PARAMS, overrides: Sequence[str] = (), source: Source | None = None) -> None:
    """Composes conf/ into params.yaml, byte for byte as `dvc exp run` does.

    Raises:
        InputError: as `configure`; the file then stays as it is.
    """
    composed = compose(overrides, source)
    typed(composed)
    text = OmegaConf.to_yaml(composed)
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

    Only one override varies at a time, which is enough to check every value before a sweep begins. An interval gives
    its ends. A later override of a key replaces an earlier one. Choices by `glob` exist, and are left out.

    Raises:
        InputError: an override cannot be parsed.
    """
    parsed = {override.get_key_element(): override for override in parse_overrides(overrides)}
    choices = [found for override in parsed.values() if (found := _choices(override))]
    first = [values[0] for values in choices]
    variants = [[*first[:i], value, *first[i + 1 :]] for i, values in enumerate(choices) for value in values[1:]]
    return [first, *variants]


def parse_overrides(overrides: Sequence[str]) -> list[Override]:
    """Parses Hydra overrides.

    Raises:
        InputError: an override cannot be parsed.
    """
    try:
        return OverridesParser.create().parse_overrides(list(overrides))
    except HydraException as error:
        raise InputError(_one_line(error, overrides)) from error


def _choices(override: Override) -> list[str]:
    """All values of an override, each as an override of its own."""
    key, value = override.get_key_element(), override.value()
    if isinstance(value, Glob):
        return []
    if isinstance(value, IntervalSweep):
        return [f"{key}={end}" for end in (value.start, value.end)]
    if override.is_sweep_override():
        return [f"{key}={found}" for found in override.sweep_string_iterator()]
    return [str(override.input_line)]


def configured_choices(overrides: Sequence[str], source: Source | None = None) -> list[str]:
    """Returns the choices of a sweep that the configuration itself holds, `hydra.sweeper.params`, as overrides."""
    plain_overrides = [o.input_line for o in parse_overrides(overrides) if not o.is_sweep_override()]
    composed = compose([str(line) for line in plain_overrides], source, hydra=True)
    return [f"{key}={value}" for key, value in (composed.hydra.sweeper.params or {}).items()]


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


def _main(words: Sequence[str]) -> None:
    from .command_line import parse

    line = parse(words, "config")
    write_params(overrides=line.overrides, source=line.source)


if __name__ == "__main__":
    try:
        _main(sys.argv[1:])
    except InputError as error:
        sys.exit(f"error: {error}")
