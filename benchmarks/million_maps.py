"""Labels and a streamed epoch at the scale of a million maps: memory, restarts, rates, and what ten million need.

    python -m benchmarks.million_maps --maps 1000000 --workers 2 [--page docs/pipeline.md]
    python -m benchmarks.million_maps --maps 20000        # minutes

True labels take nearly all the time, so only `--recorded` maps are labelled truly; their rate is printed. The label run
then has a stand-in for the detailed planner, which gives these labels again, map by map, and never drops a map. All the
rest is that of a true run: workers, shards, index, restarts. Each part works in its own process:

1. `label_split` on a tenth of the maps, and on all of them. The second run is killed (SIGKILL) in its middle and
   started again. `restart_s` is the time from the start of a process to the list of missing shards, after the kill and
   when nothing is missing; the larger counts. `restart_cpu_s` is the same in processor time, `load` the number of
   processes that wanted a core meanwhile (mean over a minute).
2. One epoch of a small network, streamed from the shards. It is killed in the middle and started again; `resume_s` is
   the time from the start of the process to its first batch, `maps_per_s` the rate afterwards.

`memory_gb` is the largest peak of a process. `ten_million` extrapolates along lines through the measured points of a
tenth and of all maps; `true_core_hours` counts the true labels, `epoch_hours` the small network. The last line is JSON;
`--page` writes the figures into the page.
"""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.page import table, write_block
from hdsp.base.files import replacing
from hdsp.base.workers import peak_memory
from hdsp.labels.run.split_run import ClusterSettings, label_split
from hdsp.labels.run.splits import LabelRun
from hdsp.labels.shard_index import SHARDS, read_index
from hdsp.labels.shards import read_tasks
from pipeline.config import configure
from pipeline.label_places import label_run

TEN_MILLION = 10_000_000
#: A network whose epoch costs little beside the reading.
NETWORK = {
    "architecture": "compact",
    "encoding": {"reference": "base", "channels": ["height"]},
    "options": {"widths": [4, 4], "blocks": [0, 0], "map_features": 2, "hidden": 16},
}
VALIDATION_MAPS = 90


@dataclass(frozen=True)
class RecordedRun(LabelRun):
    """A label run whose labels are those of recorded maps, again and again."""

    recorded: str = ""

    def inputs(self) -> dict[str, Any]:
        return {**super().inputs(), "recorded": Path(self.recorded).name}

    def tasks_of(self, number: int, label=None):
        category, index, _ = self.map_of(number)
        known = recorded_labels(self.recorded)
        of_category = known.get(category) or [row for rows in known.values() for row in rows]
        return of_category[index % len(of_category)]


@cache
def recorded_labels(place: str) -> dict[str, list]:
    """Recorded labels by category; each process reads them once."""
    from hdsp.labels.rules import MapTasks

    tasks = read_tasks(place)
    arrays, found = tasks.arrays(), defaultdict(list)
    for k, category in enumerate(tasks.category.tolist()):
        found[category].append(MapTasks(**{name: arrays[name][k] for name in MapTasks._fields}))
    return dict(found)


def main(argv=None) -> dict[str, Any]:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--maps", type=int, default=1_000_000)
    parser.add_argument("--recorded", type=int, default=450, help="maps that are labelled truly")
    parser.add_argument("--workers", type=int, default=2, help="processes of the label run")
    parser.add_argument("--readers", type=int, default=1, help="processes that read shards for the training")
    parser.add_argument("--maps-per-shard", type=int, default=90)
    parser.add_argument("--folder", type=Path, help="place for the shards, which are removed afterwards")
    parser.add_argument("--page", type=Path, help="docs page to update")
    parser.add_argument("--part", choices=PARTS, help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    page = vars(arguments).pop("page")
    if arguments.part:
        result = PARTS[arguments.part](arguments)
        print(json.dumps(result))
        return result
    folder = Path(tempfile.mkdtemp(dir=arguments.folder, prefix="million_maps-"))
    arguments.folder = folder
    try:
        result = measured(arguments)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    print(json.dumps(result))
    if page:
        write_block(page, "benchmarks.million_maps", text(result))
    return result


def text(result: dict[str, Any]) -> str:
    """Formats the result for the page."""
    far, memory = result["ten_million"], result["memory_by_process_gb"]
    grown, epoch = result["memory_growth_in_the_epoch_gb"], round(result["maps"] / result["maps_per_s"] / 3600, 2)
    rows = [
        ["memory of the label run, GB", memory["label"], max(memory["label"], far["memory_gb"])],
        ["memory of the training, GB", memory["train"], f"grew by {grown} in the epoch"],
        ["restart of the labels, processor s", result["restart_cpu_s"], far["restart_cpu_s"]],
        [f"restart of the labels, s at a load of {result['load']:.1f}", result["restart_s"], ""],
        ["restart of the epoch until its first batch, s", result["resume_s"], ""],
        ["an epoch of the small network, hours", epoch, far["epoch_hours"]],
        ["true labels, core hours", "", far["true_core_hours"]],
        ["disk, GB", result["disk_gb"], far["disk_gb"]],
    ]
    rates = (
        f"The epoch read {result['maps_per_s']:,.0f} maps per second, and the stand-in's labels were written at "
        f"{result['shards_of_stand_in_maps_per_s']:,.0f} maps per second; one core labels "
        f"{result['true_labels_maps_per_s_and_core']:,.1f} maps truly per second, {os.cpu_count()} cores were there."
    )
    head = ["", f"{result['maps']:,} maps", "ten million, extrapolated"]
    return f"{table(head, rows)}\n\n{rates}"


def measured(arguments: argparse.Namespace) -> dict[str, Any]:
    """Runs all parts in processes of their own."""
    truly = in_process(arguments, "truly")
    tenth = argparse.Namespace(**{**vars(arguments), "maps": arguments.maps // 10})
    few = in_process(tenth, "label")
    shards = arguments.maps // arguments.maps_per_shard
    killed_in_process(arguments, "label", lambda: written_shards(arguments.folder) > shards / 2)
    after_kill = in_process(arguments, "label")
    again = in_process(arguments, "label")
    again_few = in_process(tenth, "label")
    progress = arguments.folder / "progress.json"
    killed_in_process(arguments, "train", lambda: seen_batches(progress) > arguments.maps / BATCH / 2)
    trained = in_process(arguments, "train")
    size = sum(path.stat().st_size for path in arguments.folder.rglob("*.h5"))
    restarts = [after_kill["restart_s"], again["restart_s"]]
    memory = {"label": after_kill["memory_gb"], "train": trained["memory_gb"], "worker": after_kill["worker_gb"]}
    points = arguments.maps // 10, arguments.maps
    return {
        "maps": arguments.maps,
        "maps_per_s": trained["maps_per_s"],
        "memory_gb": max(memory.values()),
        "restart_s": max(restarts),
        "restart_cpu_s": max(after_kill["restart_cpu_s"], again["restart_cpu_s"]),
        "load": max(after_kill["load"], again["load"]),
        "resume_s": trained["resume_s"],
        "memory_by_process_gb": memory,
        "memory_growth_in_the_epoch_gb": trained["growth_gb"],
        "restart_after_kill_s": restarts[0],
        "restart_of_a_tenth_cpu_s": again_few["restart_cpu_s"],
        "shards_of_stand_in_maps_per_s": after_kill["maps_per_s"],
        "true_labels_maps_per_s_and_core": truly["maps_per_s"],
        "disk_gb": round(size / 1e9, 3),
        "ten_million": {
            "restart_cpu_s": along_a_line(points, (again_few["restart_cpu_s"], again["restart_cpu_s"])),
            "memory_gb": along_a_line(points, (few["memory_gb"], again["memory_gb"])),
            "disk_gb": round(size / arguments.maps * TEN_MILLION / 1e9, 1),
            "epoch_hours": round(TEN_MILLION / trained["maps_per_s"] / 3600, 2),
            "true_core_hours": round(TEN_MILLION / truly["maps_per_s"] / 3600, 1),
        },
    }


def along_a_line(at: tuple[int, int], values: tuple[float, float]) -> float:
    """Value at ten million maps on the line through two points; it never falls below the measured ones."""
    slope = (values[1] - values[0]) / (at[1] - at[0])
    return round(max(values[1] + slope * (TEN_MILLION - at[1]), *values), 2)


def command(arguments: argparse.Namespace, part: str) -> list[str]:
    options = {name.replace("_", "-"): value for name, value in vars(arguments).items() if name != "part"}
    flags = [text for name, value in options.items() for text in (f"--{name}", str(value))]
    return [sys.executable, "-m", "benchmarks.million_maps", *flags, "--part", part]


def in_process(arguments: argparse.Namespace, part: str) -> dict[str, Any]:
    """The result of a part in a new process."""
    done = subprocess.run(command(arguments, part), stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def killed_in_process(arguments: argparse.Namespace, part: str, reached) -> None:
    """Starts a part, and kills its process and those below it once a condition holds."""
    process = subprocess.Popen(command(arguments, part), stdout=subprocess.DEVNULL, start_new_session=True)
    try:
        while not reached():
            if process.poll() is not None:
                raise SystemExit(f"error: {part} ended before it could be killed; try more --maps")
            time.sleep(0.2)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def written_shards(folder: Path) -> int:
    pools = list(folder.glob(f"labels/*/{SHARDS}"))
    return sum(len(os.listdir(part)) for pool in pools for part in pool.iterdir())


def seen_batches(progress: Path) -> int:
    return json.loads(progress.read_text())["batches"] if progress.is_file() else 0


def since_start() -> float:
    """Seconds since this process began."""
    import psutil

    return time.time() - psutil.Process().create_time()


def truly(arguments: argparse.Namespace) -> dict[str, Any]:
    """Labels maps with the detailed planner; the rate leaves out the first shard, which compiles."""
    per_category = -(-arguments.recorded // 9)
    settings = f"{{maps_per_category: {per_category}, maps_per_shard: {max(9, arguments.recorded // 10)}}}"
    run = label_run(configure([f"labelling.splits.train={{seed: 1, heading_residues: [0], {settings[1:]}"]), "train")
    cluster = ClusterSettings(1, dashboard=None)
    began = time.perf_counter()
    label_split(run, arguments.folder / "recorded", cluster, progress=False)
    return {"maps_per_s": round(run.split.maps / (time.perf_counter() - began), 2)}


def stand_in(arguments: argparse.Namespace) -> RecordedRun:
    per_category = -(-arguments.maps // 9)
    split = f"{{seed: 1, maps_per_category: {per_category}, maps_per_shard: {arguments.maps_per_shard}}}"
    run = label_run(configure([f"labelling.splits.train={split}"]), "train")
    (index,) = (arguments.folder / "recorded").glob("*/*-maps")
    return RecordedRun(run.split, run.robot, run.terrain, run.settings, run.sensing, str(index))


def label(arguments: argparse.Namespace) -> dict[str, Any]:
    """Labels with the stand-in, after what is there."""
    from hdsp.labels.run.label_store import LabelStore

    known: list[tuple[float, float]] = []
    find = LabelStore.missing

    def noted(store, *options):
        missing = find(store, *options)
        known.append((since_start(), time.process_time()))
        return missing

    LabelStore.missing = noted  # type: ignore[method-assign]
    cluster = ClusterSettings(arguments.workers, dashboard=None)
    result = label_split(stand_in(arguments), arguments.folder / "labels", cluster, progress=False)
    record = result.record or {}
    return {
        "restart_s": round(known[0][0], 2),
        "restart_cpu_s": round(known[0][1], 2),
        "load": round(os.getloadavg()[0], 1),
        "memory_gb": round(peak_memory() / 1e9, 3),
        "worker_gb": round(record.get("peak_memory", 0) / 1e9, 3),
        "maps_per_s": round(record.get("tasks_per_second", 0) / 22, 1),
    }


#: Maps in a batch of the training.
BATCH = 64


def train(arguments: argparse.Namespace) -> dict[str, Any]:
    """One epoch of the small network, after the last checkpoint."""
    import lightning.pytorch as pl

    from hdsp.learning import train as train_network

    class Watch(pl.Callback):
        def __init__(self):
            self.first = self.began = self.memory = None
            self.batches, self.seen = 0, 0.0

        def on_train_batch_start(self, trainer, module, batch, index):
            if self.first is None:
                self.first, self.began = since_start(), time.perf_counter()

        def on_train_batch_end(self, trainer, module, outputs, batch, index):
            self.batches += 1
            if self.batches == 50:
                self.memory = peak_memory()
            self.seconds = time.perf_counter() - self.began
            if time.perf_counter() > self.seen + 1:
                self.seen = time.perf_counter()
                with replacing(arguments.folder / "progress.json") as temporary:
                    temporary.write_text(json.dumps({"batches": index}))

    watch = Watch()
    run = stand_in(arguments)
    place = next(place for place in arguments.folder.glob(f"labels/*/{run.split.maps}-maps"))
    assert read_index(place) is not None
    validation = read_tasks(run.recorded)[:VALIDATION_MAPS]
    config = {
        "model": NETWORK,
        "trainer": {
            "epochs": 1,
            "batch": {"by": "map", "size": BATCH},
            "optimizer": {"name": "adamw", "lr": 1e-3},
            "losses": {"rule": "constant"},
            "selection": {"metric": "feasibility_accuracy"},
            "checkpoint_minutes": 0.02,
        },
        "hardware": {"accelerator": "cpu", "precision": "32", "threads": 1, "readers": arguments.readers},
    }
    work = arguments.folder / "training"
    result = train_network(config, [place], {"val": validation}, work, callbacks=[watch], quiet=True)
    assert result.maps == run.split.maps and np.isfinite(result.metrics["loss/feasibility"])
    return {
        "maps_per_s": round(watch.batches * BATCH / watch.seconds, 1),
        "memory_gb": round(peak_memory() / 1e9, 3),
        "growth_gb": round((peak_memory() - watch.memory) / 1e9, 3),
        "resume_s": round(watch.first, 2),
    }


PARTS = {"truly": truly, "label": label, "train": train}

if __name__ == "__main__":
    from benchmarks import million_maps  # workers know classes of this module by its name alone

    million_maps.main()
