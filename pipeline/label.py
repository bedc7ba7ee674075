"""Stage `label`: seeds -> random maps with the labels of their tasks, in shards that an interrupted run continues."""

from __future__ import annotations

from omegaconf import DictConfig

from hdsp.errors import InputError
from pipeline.config import plain, settings
from pipeline.stage import Folders, run_stage, write_json


def label(config: DictConfig, folders: Folders, split: str) -> None:
    from hdsp.labelling import LabelSettings
    from hdsp.labelling_run import SplitSettings, label_split
    from hdsp.robot import Robot
    from hdsp.terrain import TerrainSettings

    splits = config.labelling.splits
    if split not in splits:
        raise InputError(f"unknown split {split!r}; labelling.splits has {', '.join(splits)}")
    summary = label_split(
        settings(SplitSettings, splits[split], f"labelling.splits.{split}"),
        Robot.load(plain(config.robot)),
        settings(TerrainSettings, config.terrain, "terrain"),
        settings(LabelSettings, config.labelling.settings, "labelling.settings"),
        folders.write("data", "labels", split),
        workers=config.runtime.workers,
        progress=config.runtime.progress,
    )
    write_json(folders.write("reports", "labels", f"{split}.json"), summary)


if __name__ == "__main__":
    run_stage(label, "label", positional=["split"])
