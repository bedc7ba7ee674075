"""Finished runs of a sweep: the same sweep in the same folder continues after a kill.

A run with an end leaves its value beside its overrides. A later run in this folder with the same configuration and code
takes this value instead of work. A lock lets no two processes work in one folder, because workers of a killed sweep may
live on.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable, Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from hdsp.learning.architectures import architecture_place

from .code import STAGES, own_places
from .command_line import PACKAGE
from .config import plain
from .config_types import Config
from .folders import alone, read_json, write_json

#: Record of a finished run, and the file that its process locks; beside the overrides.
RECORD, LOCK = ".hydra/finished.json", ".hydra/lock"


def once(folder: Path, digest: str, work: Callable[[], float]) -> float:
    """Does the work of a run unless it is done; returns its value.

    Args:
        folder: outputs of the run.
        digest: everything that decides its result, from `run_digest`.
        work: the run; an exception leaves no record.
    """
    record = folder / RECORD
    with alone(folder, LOCK):
        if record.is_file() and (stored := read_json(record)).get("digest") == digest:
            print(f"{folder}: finished before", file=sys.stderr, flush=True)
            return float("nan") if stored["value"] is None else float(stored["value"])
        record.unlink(missing_ok=True)
        value = work()
        write_json(record, {"digest": digest, "value": value})
        return value


def run_digest(config: Config, stage: str, arguments: Sequence[str] = ()) -> str:
    """Hash of settings and code behind a run.

    All files of this project and of packages that the settings name count, because a fingerprint of the reached code
    alone takes seconds.
    """
    own = [place for name in STAGES for place in own_places(name, config)] + [
        architecture_place(config.model.architecture)
    ]
    packages = {"hdsp", PACKAGE, *(place.partition(":")[0].partition(".")[0] for place in own)}
    parts = [stage, deciding_settings(config), list(arguments), *map(_code_of, sorted(packages))]
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


def deciding_settings(config: Config) -> dict[str, Any]:
    """Plain settings that decide results: all but those of searches and of `runtime`, of which only `inputs` counts."""
    others = {name: value for name, value in plain(config).items() if name not in ("runtime", "search")}
    return {**others, "inputs": config.runtime.inputs}


@cache
def _code_of(package: str) -> str:
    """Hash of all sources of a package when it is first asked for."""
    spec, digest = find_spec(package), hashlib.sha256()
    for folder in spec.submodule_search_locations or () if spec else ():
        for path in sorted(Path(folder).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()
