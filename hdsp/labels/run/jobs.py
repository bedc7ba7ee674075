"""Work of a label worker: it labels maps, counts the labels, and writes a shard.

The module is separate so that a worker imports only this module and the label function, without the scheduling code.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.storage import Place, open_folder
from hdsp.labels.counts import LabelCounts, counts_by_category
from hdsp.labels.run.splits import LabelRun, ShardPlan, labels_code
from hdsp.labels.shards import shard_bytes
from hdsp.labels.tasks import TaskSet
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap

if TYPE_CHECKING:
    from hdsp.labels.rules import LabelSettings, MapTasks

#: (map, robot, settings, start heading) -> labels, or None if the robot cannot start there.
LabelMap = Callable[[HeightMap, Robot, "LabelSettings", int], "MapTasks | None"]
Labels = list["MapTasks | None"]


def label_maps(run: LabelRun, label: LabelMap | None, code: str, numbers: Sequence[int]) -> Labels:
    """Labels maps of a split.

    Args:
        run: the split, with everything on which its labels depend.
        label: function that labels one map; None = `hdsp.labels.rules.label_map`.
        code: `labels_code` of the requesting process.
        numbers: map numbers.

    Raises:
        InputError: if this process has other code than the requesting process, because the shard's hash would be wrong.
        RuntimeError: if labelling fails; the message names the map.
    """
    if _own_code() != code:
        raise InputError("a worker has another version of hdsp than the process that asks it for labels")
    if label is None:
        label = _label_function(run)
    return [_label_map(run, label, number) for number in numbers]


def _label_function(run: LabelRun) -> LabelMap:
    if run.split.standable:
        from hdsp.labels.rules import label_map

        return label_map
    return label_unstandable


def label_unstandable(
    terrain: HeightMap, robot: Robot, settings: "LabelSettings", start_heading: int
) -> "MapTasks | None":
    """The tasks, all infeasible, of a map in whose middle cell the robot cannot stand; None if it can.

    As `hdsp.labels.rules.label_map`; start and goals are the start on neutral feet. No search needs the settings.
    A change of these lines is not in the hash of shards (`hdsp.labels.run.splits.labels_code`): raise `LABELS_VERSION` with it.
    """
    from hdsp.abstract.transform import feet_at
    from hdsp.detailed.search.solve import Status
    from hdsp.detailed.world.world import build_world
    from hdsp.labels.rules import MapTasks
    from hdsp.robot.lattice import HEADINGS_PER_ABSTRACT, N_ABSTRACT_ACTIONS, Grid, robot_frame_goals

    world, base = build_world(terrain, robot), (terrain.shape[0] // 2, terrain.shape[1] // 2, start_heading)
    if feet_at(world, base) is not None:
        return None
    start = Grid(terrain.origin, terrain.shape).to_world(np.array([*base, 0, 0, 0, 0])).astype(np.float32)
    return MapTasks(
        heights=terrain.crop_cells(*base).heights,
        goals=robot_frame_goals(start_heading // HEADINGS_PER_ABSTRACT),
        feasible=np.zeros(N_ABSTRACT_ACTIONS, bool),
        cost=np.zeros(N_ABSTRACT_ACTIONS, np.float32),
        reason=np.full(N_ABSTRACT_ACTIONS, Status.INVALID_START, np.uint8),
        start=start,
        goal=np.tile(start, (N_ABSTRACT_ACTIONS, 1)),
    )


def count_labels(labels: Labels) -> LabelCounts:
    """Counts the labels of a part."""
    kept = [tasks for tasks in labels if tasks is not None]
    if not kept:
        return LabelCounts(dropped=len(labels))
    arrays = (np.array([getattr(tasks, name) for tasks in kept]) for name in ("feasible", "cost", "reason"))
    return LabelCounts.of(*arrays, dropped=len(labels) - len(kept))


def store_shard(run: LabelRun, place: Place, shard: ShardPlan, parts: list[Labels]) -> dict[str, LabelCounts]:
    """Writes a shard from the parts with its labels to folder ``place``; returns counts by category.

    Raises:
        InputError: if the shard cannot be written.
    """
    tasks = _task_set(run, shard.maps, [labels for part in parts for labels in part])
    attributes = {
        "labels_hash": run.labels_hash,
        "labels_inputs": run.inputs_text,
        "first_map": shard.maps.start,
        "maps": len(shard.maps),
    }
    open_folder(place).write(shard.name, shard_bytes(tasks, attributes, shard.name))
    return counts_by_category(tasks)


@lru_cache(1)
def _own_code() -> str:
    return labels_code()


def _label_map(run: LabelRun, label: LabelMap, number: int) -> "MapTasks | None":
    try:
        return label(run.terrain_of(number), run.robot, run.settings, run.map_of(number)[2])
    except Exception as error:
        raise RuntimeError(f"labelling failed on {run.describe(number)}: {error}") from error


def _task_set(run: LabelRun, maps: range, labels: Labels) -> TaskSet:
    kept = [(number, tasks) for number, tasks in zip(maps, labels, strict=True) if tasks is not None]
    if not kept:
        return TaskSet.empty()
    numbers, tasks = zip(*kept, strict=True)
    category, index, heading = zip(*map(run.map_of, numbers), strict=True)
    arrays = {name: np.array(column) for name, column in zip(tasks[0]._fields, zip(*tasks, strict=True), strict=True)}
    return TaskSet(**arrays, category=category, index=index, heading=heading, seed=np.full(len(kept), run.split.seed))
