"""Labelled task sets on disk, as stages read them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from hdsp.base.files import made_folder
from hdsp.base.storage import Place, is_url

from .config_types import Config, EvaluationSet
from .label_places import not_there, shards_place
from .stage import Folders

if TYPE_CHECKING:
    from hdsp.labels.tasks import TaskSet
    from hdsp.robot.robot import Robot

#: Written by a stage without data; `reason` explains why.
ABSENT = "absent.json"


def remove_results(folder: Path, *names: str) -> None:
    """Removes the results of a stage's earlier run from a folder, its note included; all other files stay.

    Raises:
        InputError: the folder cannot be written to.
    """
    for path in (made_folder(folder) / name for name in (*names, ABSENT)):
        if not path.is_dir():
            path.unlink(missing_ok=True)


def read_set(folder: Place, robot: Robot | None = None) -> tuple[TaskSet | None, str]:
    """Returns the tasks in a shard or a folder with shards (path or URL), or None and the reason for their absence.

    With a robot, labels that record another one are a reason. Each shard is read once.

    Raises:
        InputError: a shard is damaged.
    """
    from hdsp.labels.label_robots import OtherRobotError, read_own_tasks
    from hdsp.labels.shards import shard_paths
    from hdsp.labels.tasks import TaskSet

    if not is_url(folder) and (absent := Path(folder) / ABSENT).is_file():
        return None, json.loads(absent.read_text(encoding="utf-8"))["reason"]
    if not shard_paths(folder):
        return None, not_there(folder)
    try:
        tasks = TaskSet.concatenate(read_own_tasks(folder, robot))
    except OtherRobotError as error:
        return None, str(error)
    return (tasks, "") if len(tasks) else (None, f"{folder} holds no maps: its shards are empty")


def set_place(entry: EvaluationSet, config: Config, folders: Folders) -> Place:
    """Returns the place of the shards or scans for an entry in `evaluation.sets`."""
    if entry.split is not None:
        return shards_place(config, folders.inputs, entry.split)
    return entry.place if is_url(entry.place) else folders.read(entry.place)


def read_evaluation_set(
    name: str, entry: EvaluationSet, config: Config, folders: Folders
) -> tuple[TaskSet | None, str]:
    """Like `read_set`, for an entry in `evaluation.sets`.

    In an entry, `split` names a labelled split; `tasks` names an input folder or URL with shards, or one shard; `scans`
    names any folder with scans, which are labelled first (`hdsp.labels.scan_sets`). `robot` marks labels made
    elsewhere; they exist for this robot alone.

    Raises:
        InputError: a shard is damaged, or the folder of scans does not exist.
    """
    if (robot := entry.robot) not in (None, config.robot.name):
        return None, f"its labels are of robot {robot}"
    if entry.split is not None:
        return read_set(set_place(entry, config, folders))
    if entry.tasks is not None:
        return read_set(set_place(entry, config, folders), config.robot)
    from hdsp.labels.scan_sets import NoTasksError, read_scan_folder

    try:
        found = read_scan_folder(
            entry.place,
            config.robot,
            config.scans.patches,
            config.labelling.settings,
            folders.write("data", "scans", name),
            config.runtime.data_dir,
        )
    except NoTasksError as error:
        return None, str(error)
    for scan, maps in found.used.items():
        print(f"{name}: {maps} patches of {scan}")
    for scan, reason in found.skipped.items():
        print(f"{name}: skipped {scan}: {reason}")
    return found.tasks, ""
