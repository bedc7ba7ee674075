"""Stage `code`: fingerprints of the code behind each other stage's result, `data/code/STAGE`.

The other stages depend on fingerprints instead of source files. An edit without influence on results (a comment, a
drawing, code moved to another file) changes no fingerprint, and no other stage runs again.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from hdsp.base.extensions import HEURISTICS, TERRAIN, distribution_of, extension_place
from hdsp.base.provenance import ROOT, code_fingerprint, reached_code
from hdsp.learning.architectures import architecture_place, network_class
from hdsp.learning.loading import load_abstraction, presets, shipped
from hdsp.terrain.scenes import ALL_CATEGORIES

from .config import plain
from .config_types import Config, is_own_heuristic
from .stage import Folders, run_stage

#: Name of this package's folder: `pipeline` in a checkout.
PLACE = Path(__file__).resolve().parent.name
#: Modules of the other stages; each has a function of its own name.
STAGES = ("label", "published", "import_scans", "scan_arena", "scan_courses", "train", "evaluate", "plan", "report")


def code(config: Config, folders: Folders) -> None:
    own = {stage: places for stage in STAGES if (places := own_places(stage, config))}
    folder = folders.write("data", "code")
    before = {path.name: path.read_text() for path in folder.glob("*")}
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    after = fingerprints(config.model.architecture, own=own)
    for stage, fingerprint in after.items():
        (folder / stage).write_text(fingerprint)
    changed = [stage for stage in after if before.get(stage) not in (None, after[stage])]
    print(f"code of {', '.join(changed)} changed" if changed else "no code that decides a result changed")


def fingerprints(
    architecture: str, root: Path = ROOT, own: Mapping[str, Sequence[str]] | None = None
) -> dict[str, str]:
    """The fingerprint of each stage's code.

    Args:
        architecture: architecture for training.
        root: folder with `hdsp` and `pipeline`.
        own: code of other packages behind a stage, as `module:name`.

    Raises:
        InputError: the architecture is unknown.
    """
    more = own or {}
    return {
        stage: code_fingerprint(*entries(stage, architecture, root), *more.get(stage, ()), root=root)
        for stage in STAGES
    }


def own_places(stage: str, config: Config) -> list[str]:
    """Returns `module:name` for everything from other packages that the configuration names for a stage."""
    names: list[str] = []
    if stage == "label":
        categories = {name for split in config.labelling.splits.values() for name in split.categories}
        names = [place for name in sorted(categories - {*ALL_CATEGORIES}) if (place := extension_place(TERRAIN, name))]
    elif stage == "plan":
        wanted = dict.fromkeys((*config.planner.heuristics, *config.planner.random.heuristics))
        names = [place for name in wanted if is_own_heuristic(name) and (place := extension_place(HEURISTICS, name))]
    elif stage == "train":
        names = [place for place in targets(plain(config.trainer)) if needs_hdsp(place)]
    return names


def targets(values: Any) -> list[str]:
    """Returns `module:name` of each `_target_` in nested settings."""
    if isinstance(values, Mapping):
        own = values.get("_target_")
        found = [":".join(own.rsplit(".", 1))] if isinstance(own, str) else []
        return found + [place for value in values.values() for place in targets(value)]
    return [place for value in values for place in targets(value)] if isinstance(values, list | tuple) else []


def needs_hdsp(place: str) -> bool:
    """Whether the code at `module:name` belongs to another project that builds on this one."""
    distribution = distribution_of(place)
    if distribution is None:
        return place.partition(".")[0] not in ("hdsp", PLACE)
    needs = metadata.requires(distribution) or []
    return distribution != "hdsp" and any(re.match(r"hdsp\b", need) for need in needs)


def entries(stage: str, architecture: str, root: Path = ROOT) -> list[str]:
    """Start of a stage's code: its function, and all networks it builds by name."""
    entry = f"{PLACE}.{stage}:{stage}"
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
