"""Evaluation sets from a user's folder with scans or labelled tasks, without any configuration.

All files below the folder are searched:

- ``*.yaml``: scan descriptions as in conf/scans. A scan's files are taken from ``real/NAME/`` or ``NAME/`` beside the
  description, from the description's own folder, or from their usual places (``hdsp.terrain.scans``). NAME comes from
  the line ``# @package scans.sources.NAME``, or else is the description's file name.
- shards with labelled tasks (``*.h5``): used unchanged, but those that record another robot.
- height maps (``.npz``, ``.h5``) and point files that no description names: each is a scan; metres, z up.

Maps with other cells than those of the detailed lattice are resampled as for planning (`hdsp.terrain.conditioning`).
A file that cannot be used leaves the others in the set, and its reason is given.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from hdsp.base.errors import InputError
from hdsp.base.short_repr import short_repr
from hdsp.base.yaml_files import read_yaml
from hdsp.labels.label_robots import is_of_other_robot
from hdsp.labels.rules import LabelSettings
from hdsp.labels.scan_patches import ScanPatchSettings, label_scan
from hdsp.labels.shards import is_shard, read_shard
from hdsp.labels.tasks import TaskSet
from hdsp.robot.lattice import is_detailed
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.map_formats import is_self_contained
from hdsp.terrain.pointcloud import FORMATS
from hdsp.terrain.scans import Scan, build_map, find_files, load_scan, places_beside

_PACKED = (".gz", ".bz2")


class NoTasksError(InputError):
    """Raised if a folder of scans exists and gives no tasks."""


class Described(NamedTuple):
    """A scan and the path of its description."""

    scan: Scan
    path: Path


class ScanFolder(NamedTuple):
    """Result of reading a folder.

    Attributes:
        tasks: all labelled tasks; the category is the place.
        used: map count from each scan or shard, by name.
        skipped: reason for each scan or shard without maps, by name.
    """

    tasks: TaskSet
    used: dict[str, int]
    skipped: dict[str, str]

    def __repr__(self) -> str:
        return short_repr(self)


def read_scan_folder(
    folder: str | os.PathLike,
    robot: Robot,
    patches: ScanPatchSettings,
    rules: LabelSettings,
    work: str | os.PathLike,
    data_dir: str | os.PathLike | None = None,
) -> ScanFolder:
    """Reads the tasks in a folder's shards, and labels patches of its scans.

    Args:
        folder: the folder, see above.
        robot: the robot whose planner makes the labels.
        patches: start states to draw from each map.
        rules: labelling rules.
        work: folder for the shards of the scans; labels there that are still valid are kept.
        data_dir: as in ``hdsp.terrain.scans.find_files``.

    Raises:
        InputError: if the folder does not exist, a description is invalid (units and axes of its files would be
            unknown), or a shard cannot be written.
        NoTasksError: if there are no tasks.
    """
    folder, work = Path(folder), Path(work)
    if not os.path.isdir(folder):
        raise InputError(f"folder of scans {folder}: no such folder")
    sets: list[TaskSet] = []
    used: dict[str, int] = {}
    skipped: dict[str, str] = {}

    def take(name: str, tasks: TaskSet) -> None:
        if len(tasks) == 0:
            skipped[name] = "no place in it where the robot can stand"
            return
        sets.append(tasks)
        used[name] = len(tasks)

    def label(name: str, terrain: HeightMap, shard: str, about: Mapping[str, str]) -> None:
        take(name, label_scan(terrain, robot, patches, rules, work / f"{shard}.h5", about))

    named: set[Path] = set()
    for scan, path in _descriptions(folder):
        named.update(_described_files(scan, path.parent))
        try:
            files, reason = find_files(scan, data_dir, beside=path.parent)
            terrain = _detailed(build_map(scan, files)) if files else None
        except InputError as error:  # e.g. another file than the described one
            terrain, reason = None, str(error)
        if terrain is None:
            skipped[scan.name] = reason
            continue
        about = {key: getattr(scan, key) for key in ("place", "sensor", "licence", "source")} | {"scan": scan.name}
        label(scan.name, terrain, scan.name, about)
    for path in _maps(folder, named):
        name = path.relative_to(folder).as_posix()
        try:
            is_labelled = path.suffix == ".h5" and is_shard(path)
            found = _labelled(path, robot) if is_labelled else _detailed(HeightMap.load(path))
        except InputError as error:  # e.g. a text file about the scans
            skipped[name] = str(error)
            continue
        if isinstance(found, TaskSet):
            take(name, found)
        else:
            digest = hashlib.sha256(name.encode()).hexdigest()[:8]
            label(name, found, f"{path.stem}-{digest}", {"place": path.stem})
    if not sets:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in skipped.items())
        raise NoTasksError(f"folder of scans {folder} gave no tasks ({reasons or 'it holds none'})")
    return ScanFolder(TaskSet.concatenate(sets), used, skipped)


def _labelled(path: Path, robot: Robot) -> TaskSet:
    """The tasks in a shard; an InputError if it is damaged or records another robot."""
    shard = read_shard(path)
    if is_of_other_robot(shard.attributes, robot):
        raise InputError(f"its labels are of another robot than {robot.name} as it is now")
    return shard.tasks


def _descriptions(folder: Path) -> Iterator[Described]:
    for path in sorted([*folder.rglob("*.yaml"), *folder.rglob("*.yml")]):
        values = read_yaml(path, "description of a scan").values
        if not {"defaults", "rosbag2_bagfile_information"} & {*values}:  # neither the list of conf/scans nor a bag
            yield Described(load_scan(path), path)


def _described_files(scan: Scan, beside: Path) -> set[Path]:
    """Files beside a description that it names, also those with another checksum; they are no scans of their own."""
    paths = (place / file.place for place in places_beside(scan, beside) for file in scan.files)
    return {path.resolve() for path in paths if os.path.isfile(path)}


def _detailed(terrain: HeightMap) -> HeightMap:
    """The map with the cells of the detailed lattice; a map that has them stays as it is."""
    return terrain if is_detailed(terrain.resolution) else terrain.conditioned().terrain


def _maps(folder: Path, named: set[Path]) -> Iterator[Path]:
    for path in sorted(path for path in folder.rglob("*") if path.is_file() and path.resolve() not in named):
        suffixes = path.suffixes[:-1] if path.suffix in _PACKED else path.suffixes
        if not path.name.startswith(".") and (is_self_contained(path) or (suffixes and suffixes[-1] in FORMATS)):
            yield path
