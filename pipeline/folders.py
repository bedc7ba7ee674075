"""Folders of a stage, and its reports as JSON."""

from __future__ import annotations

import fcntl
import json
import math
import os
import sys
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hdsp.base.errors import InputError
from hdsp.base.files import made_folder, replacing
from hdsp.base.yaml_files import read_json as read_json_file

#: Settings without influence on results.
_ELSEWHERE = ("runtime.", "hydra.", "hydra/", "search=", "search.")


@dataclass(frozen=True)
class Folders:
    """Input folder with results from earlier stages, and output folder; each holds data/, models/ and reports/.

    Attributes:
        overrides: Hydra overrides of the command behind these outputs.
        varied: those of them that differ among the runs of a sweep; empty outside a sweep.
    """

    inputs: Path
    outputs: Path
    overrides: tuple[str, ...] = ()
    varied: tuple[str, ...] = ()

    def read(self, *parts: str) -> Path:
        return self.inputs.joinpath(*parts)

    def write(self, *parts: str) -> Path:
        """Returns a path to write to; its folder exists.

        Raises:
            InputError: the folder cannot be made.
        """
        path = self.outputs.joinpath(*parts)
        made_folder(path.parent)
        return path

    @property
    def title(self) -> str:
        """What tells a run apart: its part of a sweep, or its overrides without those of places and workers."""
        return in_short(self.varied or self.overrides)


def in_short(overrides: Sequence[str]) -> str:
    """Overrides without those of places and workers; a key is as short as it can be: `lr=0.01`."""
    own = [line.lstrip("+~").partition("=") for line in overrides if not line.lstrip("+~").startswith(_ELSEWHERE)]
    keys = dict.fromkeys(key for key, *_ in own)
    return " ".join(f"{_short(key, keys)}{sign}{value}" for key, sign, value in own)


def _short(key: str, others: Collection[str]) -> str:
    """End of a key that no other key ends with."""
    parts = key.split(".")
    ends = [".".join(parts[-length:]) for length in range(1, len(parts) + 1)]
    taken = [f".{other}" for other in others if other != key]
    return next((end for end in ends if not any(other.endswith(f".{end}") for other in taken)), key)


@contextmanager
def alone(folder: Path, lock: str) -> Iterator[None]:
    """Waits until no other process holds this lock in a folder; a process that ends in any way lets it go.

    Args:
        folder: the folder, for a line about the wait.
        lock: file in it, which stays.

    Raises:
        InputError: the folder cannot be written to.
    """
    path = folder / lock
    made_folder(path.parent)
    try:
        file = path.open("w")
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror}") from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print(f"{folder}: waiting for another process in this folder", file=sys.stderr, flush=True)
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def project_root() -> Path:
    """Returns the folder with the tracking database: the checkout, or the working folder of an installed package.

    `dvc exp run --temp` runs stages in a copy; the database then is in the original folder.
    """
    checkout = Path(__file__).resolve().parent.parent
    here = checkout if (checkout / "pyproject.toml").is_file() and _is_within(checkout) else Path.cwd()
    return Path(os.environ.get("DVC_ROOT") or here)


def _is_within(checkout: Path) -> bool:
    """Whether the working folder lies in the checkout, or is no project of its own."""
    here = Path.cwd().resolve()
    return here.is_relative_to(checkout) or not (here / "pyproject.toml").is_file()


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
