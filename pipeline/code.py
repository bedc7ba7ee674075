"""Stage `code`: fingerprints of the code behind each other stage's result, `data/code/STAGE`.

The other stages depend on fingerprints instead of source files. An edit without influence on results (a comment, a
drawing, code moved to another file) changes no fingerprint, and no other stage runs again.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from hdsp.base.provenance import ROOT, code_fingerprint, reached_code
from hdsp.learning.architectures import architecture_place, network_class
from hdsp.learning.loading import load_abstraction, presets, shipped
from pipeline.config_types import Config
from pipeline.stage import Folders, run_stage

#: Modules of the other stages; each has a function of its own name.
STAGES = ("label", "published", "import_scans", "scan_arena", "scan_courses", "train", "evaluate", "plan", "report")


def code(config: Config, folders: Folders) -> None:
    folder = folders.write("data", "code")
    before = {path.name: path.read_text() for path in folder.glob("*")}
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    after = fingerprints(config.model.architecture)
    for stage, fingerprint in after.items():
        (folder / stage).write_text(fingerprint)
    changed = [stage for stage in after if before.get(stage) not in (None, after[stage])]
    print(f"code of {', '.join(changed)} changed" if changed else "no code that decides a result changed")


def fingerprints(architecture: str, root: Path = ROOT) -> dict[str, str]:
    """The fingerprint of each stage's code.

    Args:
        architecture: architecture for training.
        root: folder with `hdsp` and `pipeline`.

    Raises:
        InputError: the architecture is unknown.
    """
    return {stage: code_fingerprint(*entries(stage, architecture, root), root=root) for stage in STAGES}


def entries(stage: str, architecture: str, root: Path = ROOT) -> list[str]:
    """Start of a stage's code: its function, and all networks it builds by name."""
    entry = f"pipeline.{stage}:{stage}"
    reached = reached_code(entry, root=root)
    networks = [architecture] if _is_in(network_class, reached) else []
    if _is_in(load_abstraction, reached):
        networks += shipped_architectures()
    return [entry, *map(architecture_place, dict.fromkeys(networks))]


def shipped_architectures() -> list[str]:
    """Architectures of all shipped abstractions."""
    configs = [shipped().joinpath(name, "config.json").read_text(encoding="utf-8") for name in presets()]
    return sorted({json.loads(config)["model"]["architecture"] for config in configs})


def _is_in(function, reached: dict[str, list[str]]) -> bool:
    return function.__name__ in reached.get(function.__module__, [])


if __name__ == "__main__":
    run_stage(code, "code")
