"""Labels for all maps in a split: written in shards, by one or many processes, and resumable after any interruption.

A run keeps valid shards and makes the others; `hdsp.labels.run.splits` defines everything on which their labels depend.
"""

import time
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from hdsp.base.errors import InputError
from hdsp.base.storage import Folder, Place, open_folder
from hdsp.base.workers import ClusterSettings, connected, peak_memory
from hdsp.labels.counts import LabelCounts, add_up, counts_by_category, split_summary
from hdsp.labels.run.cluster import MAPS_PER_PART, ClusterLabelling
from hdsp.labels.run.jobs import LabelMap, count_labels, label_maps, store_shard
from hdsp.labels.run.progress import TaskProgress
from hdsp.labels.run.splits import SHARD_NAME, LabelRun, ShardPlan, SplitSettings, labels_code
from hdsp.labels.shards import SUFFIX, shard_names, shard_of
from hdsp.robot.lattice import N_ABSTRACT_ACTIONS

__all__ = ["ClusterSettings", "LabelRun", "LabelledSplit", "SplitSettings", "label_split"]


class LabelledSplit(NamedTuple):
    """Result of a label run.

    Attributes:
        summary: counts for the split; they depend on its labels alone.
        record: statistics of this run: labelled tasks (including tasks of dropped maps), seconds, `start_seconds` (time
            until the workers were ready), tasks per second after the start, workers, and the peak memory of a worker in
            bytes. None if no shard was missing.
    """

    summary: dict[str, Any]
    record: dict[str, Any] | None


def label_split(
    run: LabelRun,
    folder: Place,
    cluster: ClusterSettings | None = None,
    *,
    progress: bool = True,
    label: LabelMap | None = None,
) -> LabelledSplit:
    """Labels all maps of a split into shards in ``folder``; valid shards are kept.

    Args:
        run: the split, with everything on which its labels depend.
        folder: path or URL, used for the shards only. Shards with other labels are removed. Other files that readers
            would take for shards move to a folder beside it with a name that ends in ``.foreign``.
        cluster: cluster for the work; None = one process per core.
        progress: whether to show a bar and the address of Dask's dashboard.
        label: function that labels one map; None = `hdsp.labels.rules.label_map`. Several workers need a function that
            can be pickled by name.

    Raises:
        InputError: if the folder is not writable, the disk is full, the cluster is not available, or a map keeps ending
            its workers. Finished shards stay.
        RuntimeError: if labelling fails; the message names the map.
    """
    cluster = cluster or ClusterSettings()
    files = open_folder(folder)
    files.prepare()
    shards = run.shards()
    name = str(folder).rstrip("/").rpartition("/")[2]
    with TaskProgress(name, total=run.split.maps, show=progress) as bar:
        counts = _valid_shards(files, run, shards, bar)
        missing = [shard for shard in shards if shard.name not in counts]
        record = _label(missing, run, label, files, cluster, bar, counts) if missing else None
    by_category = add_up((counts[shard.name] for shard in shards), run.split.categories)
    return LabelledSplit(split_summary(by_category, run.split.maps_per_category), record)


def _label(
    missing: Sequence[ShardPlan],
    run: LabelRun,
    label: LabelMap | None,
    files: Folder,
    cluster: ClusterSettings,
    bar: TaskProgress,
    counts: dict[str, dict[str, LabelCounts]],
) -> dict[str, Any]:
    """Makes the missing shards and adds their counts to ``counts``; returns the record."""
    maps = sum(len(shard.maps) for shard in missing)
    jobs = sum(-(-len(shard.maps) // MAPS_PER_PART) for shard in missing)
    began = time.perf_counter()
    started = began
    if cluster.scheduler is None and cluster.processes(jobs) == 1:
        bar.begin(already_done=run.split.maps - maps)
        for shard, found in _label_here(missing, run, label, files, bar):
            counts[shard.name] = found
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
                counts[shard.name] = found
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
    shards: Sequence[ShardPlan], run: LabelRun, label: LabelMap | None, files: Folder, bar: TaskProgress
) -> Iterator[tuple[ShardPlan, dict[str, LabelCounts]]]:
    code = labels_code()
    for shard in shards:
        parts = []
        for number in shard.maps:
            parts.append(label_maps(run, label, code, [number]))
            bar.count(count_labels(parts[-1]))
        yield shard, store_shard(run, files.place, shard, parts)


def _valid_shards(
    files: Folder, run: LabelRun, shards: Sequence[ShardPlan], bar: TaskProgress
) -> dict[str, dict[str, LabelCounts]]:
    """Counts by category for the existing valid shards; reports and clears away all other files."""
    planned = {shard.name: shard for shard in shards}
    counts: dict[str, dict[str, LabelCounts]] = {}
    removed: dict[str, list[str]] = {}
    names = files.names()
    for name in names:
        if name.startswith(".") and name.endswith(f".tmp{SUFFIX}"):
            removed.setdefault("left by a run that was stopped", []).append(name)
    for name in shard_names(names):
        try:
            shard = shard_of(files.read(name), name)
        except InputError as error:
            if SHARD_NAME.fullmatch(name):
                removed.setdefault(str(error), []).append(name)
            else:
                bar.say(f"moved {name} to {files.set_aside(name)}: {error}")
            continue
        expected = {"labels_hash": run.labels_hash, "maps": len(planned[name].maps) if name in planned else None}
        if all(shard.attributes.get(key) == value for key, value in expected.items()):
            counts[name] = counts_by_category(shard.tasks)
        elif SHARD_NAME.fullmatch(name):
            reason = "its labels were made with other settings, code or number of maps"
            removed.setdefault(reason, []).append(name)
        else:
            bar.say(f"moved {name} to {files.set_aside(name)}: not of this run")
    for reason, found in removed.items():
        for name in found:
            files.remove(name)
        bar.say(f"removed {', '.join(found)}: {reason}")
    return counts
