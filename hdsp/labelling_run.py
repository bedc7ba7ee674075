"""Labels for all maps of a split: in parallel, in shards, and resumable after whatever stopped it.

Map number t of a split is map ``t // categories`` of category ``t % categories``; a shard holds the labels of
consecutive maps. The name of a shard contains a hash of everything its labels depend on, code included, so that a run
keeps what is valid and makes the rest.
"""

import hashlib
import json
import os
import tempfile
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hdsp.errors import InputError
from hdsp.fingerprint import code_fingerprint
from hdsp.heightmap import HeightMap
from hdsp.lattice import ABSTRACT_HEADINGS, HEADINGS_PER_ABSTRACT, PATCH_CELLS
from hdsp.progress import TaskProgress
from hdsp.robot import Robot
from hdsp.shards import SCHEMA_VERSION, SUFFIX, read_shard, shard_paths, write_shard
from hdsp.tasks import REASON_UNKNOWN, TaskSet
from hdsp.terrain import CATEGORIES, TerrainSettings, random_map
from hdsp.workers import parallel_map

if TYPE_CHECKING:
    from hdsp.labelling import LabelSettings, MapTasks

#: Raised when this module gives maps other numbers, headings or sizes; the rest of the code is hashed.
LABELS_VERSION = 1

#: Side of the map around a start that does not head along x: it holds the patch at every heading.
TURNED_MAP_CELLS = 104

#: (map, robot, settings, start heading) -> labels, or None if the robot cannot start there.
LabelMap = Callable[[HeightMap, Robot, "LabelSettings", int], "MapTasks | None"]


@dataclass(frozen=True)
class SplitSettings:
    """Which maps a split consists of.

    Attributes:
        seed: of its random maps.
        maps_per_category: before those without a valid start are dropped.
        heading_residues: abstract headings, [0, 16), that maps start with in turn. Goals in the robot frame
            repeat at every quarter turn, so [0, 1, 2, 3] covers all that a planner asks for.
        categories: of terrain.
        maps_per_shard: before dropping.

    Raises:
        InputError: for a number out of range or an unknown category.
    """

    seed: int
    maps_per_category: int
    heading_residues: tuple[int, ...] = (0,)
    categories: tuple[str, ...] = CATEGORIES
    maps_per_shard: int = 90

    def __post_init__(self):
        for name, least in (("seed", 0), ("maps_per_category", 1), ("maps_per_shard", 1)):
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise InputError(f"split: {name} is {value!r}; need a whole number of at least {least}")
        object.__setattr__(self, "heading_residues", tuple(self.heading_residues))
        object.__setattr__(self, "categories", tuple(self.categories))
        if not self.heading_residues or not set(self.heading_residues) <= set(range(ABSTRACT_HEADINGS)):
            allowed = f"abstract headings, 0 to {ABSTRACT_HEADINGS - 1}"
            raise InputError(f"split: heading_residues is {list(self.heading_residues)}; need some {allowed}")
        if not self.categories or not set(self.categories) <= set(CATEGORIES):
            raise InputError(f"split: categories is {list(self.categories)}; need some of {', '.join(CATEGORIES)}")

    @property
    def maps(self) -> int:
        """Number of maps before dropping."""
        return self.maps_per_category * len(self.categories)


@dataclass(frozen=True)
class LabelRun:
    """All that the labels of a split depend on, apart from the number of maps."""

    split: SplitSettings
    robot: Robot
    terrain: TerrainSettings
    settings: "LabelSettings"

    def inputs(self) -> dict[str, Any]:
        """Plain values by name; the code as a fingerprint."""
        split = asdict(self.split)
        del split["maps_per_category"]  # more maps add shards and leave those that are there as they are
        return {
            "schema_version": SCHEMA_VERSION,
            "labels_version": LABELS_VERSION,
            "code": code_fingerprint(["hdsp.labelling", "hdsp.terrain"]),
            "split": split,
            "robot": self.robot.hash(),
            "terrain": asdict(self.terrain),
            "settings": asdict(self.settings),
        }

    def maps_of_shards(self) -> list[range]:
        """Numbers of the maps of each shard."""
        step = self.split.maps_per_shard
        return [range(first, min(first + step, self.split.maps)) for first in range(0, self.split.maps, step)]

    def map_of(self, number: int) -> tuple[str, int, int]:
        """(category, index, detailed start heading) of map ``number`` of the split."""
        index, category = divmod(number, len(self.split.categories))
        residues = self.split.heading_residues
        return self.split.categories[category], index, residues[index % len(residues)] * HEADINGS_PER_ABSTRACT

    def terrain_of(self, number: int) -> HeightMap:
        """The height map of map ``number``."""
        category, index, heading = self.map_of(number)
        cells = PATCH_CELLS if heading == 0 else TURNED_MAP_CELLS
        return random_map(self.split.seed, category, index, self.terrain, cells, heading)


def label_split(
    split: SplitSettings,
    robot: Robot,
    terrain: TerrainSettings,
    settings: "LabelSettings",
    folder: str | os.PathLike,
    *,
    workers: int | None = None,
    progress: bool = True,
    label: LabelMap | None = None,
) -> dict[str, Any]:
    """Labels all maps of a split into shards in ``folder``; shards that are there and valid stay.

    Args:
        split, robot, terrain, settings: what the labels depend on.
        folder: for the shards, and for nothing else: shards of other labels in it are removed.
        workers: processes; None = one for each core, 1 = this process.
        progress: show a bar with tasks per second and the share of infeasible tasks.
        label: labels one map; None = `hdsp.labelling.label_map`. With several workers it is pickled by name.

    Returns:
        `summary` of the split.

    Raises:
        InputError: if the folder cannot be written to, the disk is full, or a worker was killed. Finished shards stay.
    """
    if workers is not None and workers < 1:
        raise InputError(f"workers is {workers}; need at least 1, or null for one per core")
    folder = Path(folder)
    _check_writable(folder)
    run = LabelRun(split, robot, terrain, settings)
    inputs = json.dumps(run.inputs(), sort_keys=True)
    labels_hash = hashlib.sha256(inputs.encode()).hexdigest()
    shards = {folder / f"{k:05d}-{labels_hash[:12]}{SUFFIX}": maps for k, maps in enumerate(run.maps_of_shards())}

    with TaskProgress(folder.name, total=split.maps, show=progress) as bar:
        bar.say(*_remove_invalid(folder, shards, labels_hash))
        missing = {path: maps for path, maps in shards.items() if not path.exists()}
        bar.begin(already_done=split.maps - sum(map(len, missing.values())))
        numbers = [number for maps in missing.values() for number in maps]
        with closing(parallel_map(_label_number, (run, label), numbers, workers)) as results:
            for path, maps in missing.items():
                labels = [bar.count(tasks) for tasks in islice(results, len(maps))]
                attributes = {
                    "labels_hash": labels_hash,
                    "labels_inputs": inputs,
                    "first_map": maps.start,
                    "maps": len(maps),
                }
                write_shard(path, _task_set(run, maps, labels), attributes)
    return summary(split, [read_shard(path).tasks for path in shards])


def summary(split: SplitSettings, shards: list[TaskSet]) -> dict[str, Any]:
    """Counts of a labelled split, by name; they depend on the labels alone."""
    from hdsp.detailed.solve import Status

    tasks = TaskSet.concatenate(shards)
    kept = {category: int((tasks.category == category).sum()) for category in split.categories}
    names = {**{int(status): str(status) for status in Status}, REASON_UNKNOWN: "unknown"}
    reasons, counts = np.unique(tasks.reason, return_counts=True)
    cost = tasks.cost[tasks.feasible].astype(np.float64)
    return {
        "maps": len(tasks),
        "maps_dropped": split.maps - len(tasks),
        "maps_per_category": kept,
        "maps_dropped_per_category": {category: split.maps_per_category - count for category, count in kept.items()},
        "tasks": tasks.feasible.size,
        "feasible_share": float(tasks.feasible.mean()) if len(tasks) else None,
        "cost_mean": float(cost.mean()) if cost.size else None,
        "cost_std": float(cost.std()) if cost.size else None,
        "share_per_reason": {
            names[int(reason)]: int(count) / tasks.reason.size for reason, count in zip(reasons, counts, strict=True)
        },
    }


def _label_number(run: LabelRun, label: LabelMap | None, number: int) -> "MapTasks | None":
    if label is None:
        from hdsp.labelling import label_map as label
    heading = run.map_of(number)[2]
    try:
        return label(run.terrain_of(number), run.robot, run.settings, heading)
    except Exception as error:
        where = "seed {}, category {}, index {}, heading {}".format(run.split.seed, *run.map_of(number))
        raise RuntimeError(f"labelling failed on the map with {where}: {error}") from error


def _task_set(run: LabelRun, maps: range, labels: list["MapTasks | None"]) -> TaskSet:
    kept = [(number, tasks) for number, tasks in zip(maps, labels, strict=True) if tasks is not None]
    if not kept:
        return TaskSet.empty()
    numbers, tasks = zip(*kept, strict=True)
    category, index, heading = zip(*map(run.map_of, numbers), strict=True)
    arrays = {name: np.array(column) for name, column in zip(tasks[0]._fields, zip(*tasks, strict=True), strict=True)}
    return TaskSet(**arrays, category=category, index=index, heading=heading, seed=np.full(len(kept), run.split.seed))


def _check_writable(folder: Path) -> None:
    """Hours of labels must not end in a folder that cannot take them."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(f"cannot write labels to {folder}: {error.strerror}") from error


def _remove_invalid(folder: Path, shards: dict[Path, range], labels_hash: str) -> list[str]:
    """Removes what does not belong to this run; returns lines that name the files and why."""
    reasons = {path: "left by a run that was stopped" for path in folder.glob(f".*.tmp{SUFFIX}")}
    for path in shard_paths(folder):
        try:
            attributes = read_shard(path).attributes
        except InputError as error:
            reasons[path] = str(error)
            continue
        expected = {"labels_hash": labels_hash, "maps": len(shards.get(path, ()))}
        if any(attributes.get(name) != value for name, value in expected.items()):
            reasons[path] = "its labels were made with other settings, code or number of maps"
    same: dict[str, list[str]] = {}
    for path, reason in reasons.items():
        path.unlink()
        same.setdefault(reason, []).append(path.name)
    return [f"removed {', '.join(names)}: {reason}" for reason, names in same.items()]
