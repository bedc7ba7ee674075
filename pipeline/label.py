"""Stage `label`: seeds -> random maps with task labels, in shards; an interrupted run continues.

python -m pipeline.label SPLIT             # labels the maps that have none yet
python -m pipeline.label SPLIT --verify    # also reads all shards and replaces damaged ones
python -m pipeline.label --prune           # lists labels that this configuration does not use, and asks
"""

from __future__ import annotations

import json
import sys
from typing import Any

from hdsp.base.files import replacing
from hdsp.base.storage import Place

from .config_types import Config
from .folders import alone
from .label_places import USED, label_run, split_place
from .stage import Folders, run_stage, write_json

VERIFY = "--verify"


def label(config: Config, folders: Folders, split: str, verify: bool = False) -> None:
    from hdsp.base.workers import ClusterSettings
    from hdsp.labels.run.split_run import label_split

    runtime, own, run = config.runtime, config.labelling, label_run(config, split)
    cluster = ClusterSettings(runtime.workers, own.scheduler, own.slurm, runtime.dashboard, runtime.memory)
    place = split_place(config, folders.outputs, split)
    result = label_split(run, place, cluster, progress=runtime.progress, verify=verify)
    write_json(folders.write("reports", "labels", f"{split}.json"), result.summary)
    write_used(folders, split, result.place)
    if result.record:  # beside the labels instead of in a report, because it differs in each run
        records = folders.write("data", "label_runs", f"{split}.jsonl")
        with alone(records.parent, f".{split}.lock"):  # two runs at once lose no line
            earlier = records.read_text(encoding="utf-8") if records.is_file() else ""
            with replacing(records) as path:
                path.write_text(f"{earlier}{json.dumps(result.record)}\n", encoding="utf-8")


def write_used(folders: Folders, split: str, place: Place) -> None:
    """Writes which labels of a split this configuration uses: the output that DVC watches."""
    from hdsp.labels.shard_index import read_index

    index = read_index(place)
    assert index is not None  # the run has completed it
    used: dict[str, Any] = {"labels_hash": index.labels_hash, "maps": index.maps, "kept": sum(index.kept)}
    write_json(folders.write("data", "labels", split, USED), used)


if __name__ == "__main__":
    if "--prune" in sys.argv:
        from .label_prune import main

        main()
    elif VERIFY in sys.argv:
        sys.argv.remove(VERIFY)
        run_stage(lambda config, folders, split: label(config, folders, split, verify=True), "label", ["split"])
    else:
        run_stage(label, "label", positional=["split"])
