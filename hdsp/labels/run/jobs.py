"""Work of a label worker: it labels maps, counts the labels, and writes a shard.

The module is separate so that a worker imports only this module and the label function, without the scheduling code.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.storage import Place, open_folder
from hdsp.labels.counts import LabelCounts, counts_by_category
from hdsp.labels.run.splits import LabelMap, LabelRun, labels_code
from hdsp.labels.shard_index import ShardPlan
from hdsp.labels.shards import shard_bytes

if TYPE_CHECKING:
    from hdsp.labels.rules import MapTasks

Labels = list["MapTasks | None"]


def label_maps(run: LabelRun, label: LabelMap | None, code: str, numbers: Sequence[int]) -> Labels:
    """Labels maps of a split.

    Args:
        run: the split, with everything on which its labels depend.
        label: function that labels one map; None = the rule for the split.
        code: `labels_code` of the requesting process.
        numbers: map numbers.

    Raises:
        InputError: if this process has other code than the requesting process, because the shard's hash would be wrong.
        RuntimeError: if labelling fails; the message names the map.
    """
    if labels_code() != code:
        raise InputError("a worker has another version of hdsp than the process that asks it for labels")
    return [_label_map(run, label, number) for number in numbers]


def count_labels(labels: Labels) -> LabelCounts:
    """Counts the labels of a part."""
    kept = [tasks for tasks in labels if tasks is not None]
    if not kept:
        return LabelCounts(dropped=len(labels))
    feasible, cost, reason = (
        np.array([getattr(tasks, name) for tasks in kept]) for name in ("feasible", "cost", "reason")
    )
    return LabelCounts.of(feasible, cost, reason, dropped=len(labels) - len(kept))


def store_shard(run: LabelRun, place: Place, shard: ShardPlan, parts: list[Labels]) -> dict[str, LabelCounts]:
    """Writes a shard from the parts with its labels to folder ``place``; returns counts by category.

    Raises:
        InputError: if the shard cannot be written.
    """
    tasks = run.task_set(shard.maps, [labels for part in parts for labels in part])
    attributes: dict[str, str | int | float] = {
        "labels_hash": run.labels_hash,
        "labels_inputs": run.inputs_text,
        "first_map": shard.maps.start,
        "maps": len(shard.maps),
    }
    open_folder(place).write(shard.name, shard_bytes(tasks, attributes, shard.name))
    return counts_by_category(tasks)


def _label_map(run: LabelRun, label: LabelMap | None, number: int) -> "MapTasks | None":
    try:
        return run.tasks_of(number, label)
    except InputError as error:
        raise InputError(f"{run.describe(number)}: {error}") from error
    except Exception as error:
        raise RuntimeError(f"labelling failed on {run.describe(number)}: {error}") from error
