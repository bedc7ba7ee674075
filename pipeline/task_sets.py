"""Sets of labelled tasks, as the stages find them on disk."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from hdsp.base.errors import InputError
from hdsp.base.storage import Place, is_folder, is_url
from hdsp.robot.robot import Robot
from pipeline.config import plain, settings
from pipeline.stage import Folders

if TYPE_CHECKING:
    from hdsp.labels.shards import TaskSet

#: Written by a stage that could not get its data: says why in `reason`.
ABSENT = "absent.json"


def read_set(folder: Place) -> tuple[TaskSet | None, str]:
    """The tasks of a folder of shards (path or URL), or None and the reason why there are none.

    Raises:
        InputError: a shard is damaged.
    """
    from hdsp.labels.shards import read_tasks

    if not is_folder(folder):
        return None, f"{folder} is not there yet"
    if not is_url(folder) and (absent := Path(folder) / ABSENT).is_file():
        return None, json.loads(absent.read_text(encoding="utf-8"))["reason"]
    return read_tasks(folder), ""


def set_place(entry: Mapping[str, Any], folders: Folders) -> Place:
    """Where an entry of `evaluation.sets` has its shards or scans."""
    place = entry.get("tasks") or entry["scans"]
    return place if is_url(place) else folders.read(place)


def read_evaluation_set(
    name: str, entry: Mapping[str, Any], config: DictConfig, folders: Folders
) -> tuple[TaskSet | None, str]:
    """As `read_set`, of an entry of `evaluation.sets`: `tasks` names a folder of shards among the inputs, or a URL;
    `scans` any folder of scans, which are labelled first (`hdsp.labels.scan_sets`).

    An entry with `robot` is of labels that were not made here; there are none for any other robot.

    Raises:
        InputError: also for another key, or none or both of the two.
    """
    allowed = ("tasks", "scans", "paper", "robot")
    if unknown := sorted(set(entry) - set(allowed)):
        raise InputError(f"evaluation.sets.{name}: unknown key {unknown[0]!r}; allowed are {', '.join(allowed)}")
    if ("tasks" in entry) == ("scans" in entry):
        raise InputError(f"evaluation.sets.{name}: need either tasks (a folder of shards) or scans (a folder of scans)")
    if (robot := entry.get("robot")) not in (None, config.robot.name):
        return None, f"its labels are of robot {robot}"
    if "tasks" in entry:
        return read_set(set_place(entry, folders))
    from hdsp.labels.rules import LabelSettings
    from hdsp.labels.scan_patches import PatchSettings
    from hdsp.labels.scan_sets import read_scan_folder

    found = read_scan_folder(
        entry["scans"],
        Robot.load(plain(config.robot)),
        settings(PatchSettings, config.scans.patches, "scans.patches"),
        settings(LabelSettings, config.labelling.settings, "labelling.settings"),
        folders.write("data", "scans", name),
        config.runtime.data_dir,
    )
    for scan, maps in found.used.items():
        print(f"{name}: {maps} patches of {scan}")
    for scan, reason in found.skipped.items():
        print(f"{name}: skipped {scan}: {reason}")
    return found.tasks, ""
