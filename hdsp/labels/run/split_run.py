"""Labels for all maps in a split: written in shards, by one or many processes, and resumable after any interruption.

A run keeps valid shards and makes the others; `hdsp.labels.run.splits` defines everything on which their labels depend.
"""

import json
import time
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from hdsp.base.errors import InputError
from hdsp.base.storage import Place
from hdsp.base.workers import ClusterSettings, connected, peak_memory
from hdsp.labels.counts import add_up, split_summary
from hdsp.labels.run.cluster import MAPS_PER_PART, ClusterLabelling
from hdsp.labels.run.jobs import LabelMap, count_labels, label_maps, store_shard
from hdsp.labels.run.label_store import Counts, LabelStore
from hdsp.labels.run.progress import TaskProgress
from hdsp.labels.run.splits import LabelRun, SplitSettings, labels_code
from hdsp.labels.shard_index import ShardPlan
from hdsp.robot.lattice import N_ABSTRACT_ACTIONS

__all__ = ["ClusterSettings", "LabelRun", "LabelledSplit", "SplitSettings", "label_split"]


class LabelledSplit(NamedTuple):
    """Result of a label run.

    Attributes:
        summary: counts for the split; they depend on its labels alone.
        record: statistics of this run: labelled tasks (including tasks of dropped maps), seconds, `start_seconds` (time
            until the workers were ready), tasks per second after the start, workers, and the peak memory of a worker in
            bytes. None if no shard was missing.
        place: index of the labels (`hdsp.labels.shard_index`), from which readers take exactly these maps.
    """

    summary: dict[str, Any]
    record: dict[str, Any] | None
    place: Place


def label_split(
    run: LabelRun,
    folder: Place,
    cluster: ClusterSettings | None = None,
    *,
    progress: bool = True,
    label: LabelMap | None = None,
    verify: bool = False,
) -> LabelledSplit:
    """Labels all maps of a split into shards in ``folder``; valid shards are kept.

    Args:
        run: the split, with everything on which its labels depend.
        folder: path or URL. Labels of other settings or code stay beside these (`hdsp.labels.shard_index`).
        cluster: cluster for the work; None = one process per core.
        progress: whether to show a bar and the address of Dask's dashboard.
        label: function that labels one map; None = `hdsp.labels.rules.label_map`. Several workers need a function that
            can be pickled by name.
        verify: whether to read all existing shards; otherwise those that changed since they were indexed.

    Raises:
        InputError: if the folder is not writable, the disk is full, the cluster is not available, or a map keeps ending
            its workers. Finished shards stay.
        RuntimeError: if labelling fails; the message names the map.
    """
    cluster = cluster or ClusterSettings()
    store = LabelStore(folder, run.labels_hash, json.loads(run.inputs_text), run.shards())
    name = str(folder).rstrip("/").rpartition("/")[2]
    with TaskProgress(name, total=run.split.maps, show=progress) as bar:
        missing = store.missing(bar.say, verify)
        record = _label(missing, run, label, store, cluster, bar) if missing else None
    by_category = add_up(store.complete(), run.split.categories)
    return LabelledSplit(split_summary(by_category, run.split.maps_per_category), record, store.index)


def _label(
    missing: Sequence[ShardPlan],
    run: LabelRun,
    label: LabelMap | None,
    store: LabelStore,
    cluster: ClusterSettings,
    bar: TaskProgress,
) -> dict[str, Any]:
    """Makes the missing shards and adds them to the store; returns the record."""
    files = store.shards
    maps = sum(len(shard.maps) for shard in missing)
    jobs = sum(-(-len(shard.maps) // MAPS_PER_PART) for shard in missing)
    began = time.perf_counter()
    started = began
    if cluster.scheduler is None and cluster.processes(jobs) == 1:
        bar.begin(already_done=run.split.maps - maps)
        for shard, found in _label_here(missing, run, label, files.place, bar):
            store.add(shard, found)
        peaks = [peak_memory()]
        ended = time.perf_counter()
    else:
        if files.of_one_process:
            raise InputError(f"{files.place} is seen by one process alone: need workers = 1, or another place")
        with connected(cluster, jobs) as client:
            started = time.perf_counter()
            bar.note(f"dashboard at {client.dashboard_link}" if client.dashboard_link else "no dashboard")
            bar.begin(already_done=run.split.maps - maps)
            own = cluster.scheduler is None
            for shard, found in ClusterLabelling(client, run, label, files.place, bar, own).shards(missing):
                store.add(shard, found)
            peaks = list(client.run(peak_memory).values())
            ended = time.perf_counter()
    tasks = maps * N_ABSTRACT_ACTIONS
    return {
        "tasks": tasks,
        "seconds": ended - began,
        "start_seconds": started - began,
        "tasks_per_second": tasks / (ended - started),
        "workers": len(peaks),
        "peak_memory": max(peaks),
    }


def _label_here(
    shards: Sequence[ShardPlan], run: LabelRun, label: LabelMap | None, place: str, bar: TaskProgress
) -> Iterator[tuple[ShardPlan, Counts]]:
    code = labels_code()
    for shard in shards:
        parts = []
        for number in shard.maps:
            parts.append(label_maps(run, label, code, [number]))
            bar.count(count_labels(parts[-1]))
        yield shard, store_shard(run, place, shard, parts)
