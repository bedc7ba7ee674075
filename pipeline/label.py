"""Stage `label`: seeds -> random maps with task labels, in shards; an interrupted run continues."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from hdsp.base.errors import InputError
from pipeline.config_types import Config
from pipeline.stage import Folders, run_stage, write_json

if TYPE_CHECKING:
    from hdsp.labels.run.splits import LabelRun


def label(config: Config, folders: Folders, split: str) -> None:
    from hdsp.base.workers import ClusterSettings
    from hdsp.labels.run.split_run import label_split

    runtime, own = config.runtime, config.labelling
    cluster = ClusterSettings(runtime.workers, own.scheduler, own.slurm, runtime.dashboard, runtime.memory)
    place = shards_place(config, folders.outputs, split)
    result = label_split(label_run(config, split), place, cluster, progress=runtime.progress)
    write_json(folders.write("reports", "labels", f"{split}.json"), result.summary)
    if result.record:  # beside the labels instead of in a report, because it differs in each run
        with folders.write("data", "label_runs", f"{split}.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps(result.record) + "\n")


def shards_place(config: Config, folder: Path, split: str) -> str | Path:
    """Returns the folder or URL with a split's shards.

    `folder` contains data/, which always holds splits from scanned courses.
    """
    destination = config.labelling.destination if split in config.labelling.splits else None
    return f"{destination.rstrip('/')}/{split}" if destination else folder / "data" / "labels" / split


def label_run(config: Config, split: str) -> LabelRun:
    """Returns the `LabelRun` for a split in the configuration.

    Raises:
        InputError: the split does not exist, or a setting is wrong.
    """
    from hdsp.labels.run.splits import LabelRun

    own = config.labelling
    splits = own.splits
    if split not in splits:
        raise InputError(f"unknown split {split!r}; labelling.splits has {', '.join(splits)}")
    return LabelRun(splits[split], config.robot, config.terrain, own.settings, own.sensing)


if __name__ == "__main__":
    run_stage(label, "label", positional=["split"])
