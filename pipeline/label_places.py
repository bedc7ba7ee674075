"""Places of labels: the folder or URL of each split, and the labels of a configuration among those in it."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

from hdsp.base.errors import InputError
from hdsp.base.storage import Place, inside, is_folder, is_url

from .config_types import Config, is_place

if TYPE_CHECKING:
    from hdsp.labels.course_patches import PatchRun
    from hdsp.labels.run.splits import LabelRun

#: File of the label stages beside their labels: the present hash and the number of maps. Later stages depend on it.
USED = "labels.json"


def split_place(config: Config, folder: Path, split: str) -> Place:
    """Returns the folder or URL with all labels of a split, also those of other settings.

    `folder` contains data/, which always holds splits from scanned courses. Experiments that DVC runs in a copy of the
    project share the labels of the project.
    """
    destination = config.labelling.destination if split in config.labelling.splits else None
    if destination:
        return inside(destination, split)
    project = os.environ.get("DVC_ROOT")
    return (Path(project) if project and folder == Path(".") else folder) / "data" / "labels" / split


def shards_place(config: Config, folder: Path, split: str) -> Place:
    """Returns the index of a split's labels with this configuration and this code; arguments as for `split_place`.

    A split with a / in its name is a folder within `folder`, an absolute path, or a URL.

    Raises:
        InputError: the split does not exist.
    """
    from hdsp.labels.shard_index import index_place

    if is_place(split):
        return split if is_url(split) else folder / split
    place = split_place(config, folder, split)
    if split in config.simulation.splits:
        courses = course_run(config, split)
        return index_place(place, courses.course_hash(), courses.patches.courses)
    run = label_run(config, split)
    return index_place(place, run.labels_hash, run.split.maps)


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


def course_run(config: Config, split: str) -> PatchRun:
    """Returns the `PatchRun` for a split of scanned courses in the configuration.

    Raises:
        InputError: the split does not exist.
    """
    from hdsp.labels.course_patches import PatchRun

    simulation = config.simulation
    if split not in simulation.splits:
        raise InputError(f"unknown split {split!r}; simulation.splits has {', '.join(simulation.splits) or 'none'}")
    return PatchRun(
        simulation.splits[split], simulation.courses, simulation.lidar, config.robot, config.labelling.settings
    )


def not_there(place: Place) -> str:
    """Returns the reason for missing tasks at a place."""
    index = re.fullmatch(r"(?P<where>.*?(?P<split>[^/]+))/[0-9a-f]{12}/\d+-maps", str(place))
    if not index:
        return f"{place} holds no shard (*.h5)" if is_folder(place) else f"{place} is not there yet"
    where, split = index["where"], index["split"]
    makers = " or, for courses, ".join(f"`python -m pipeline.{maker} {split}`" for maker in ("label", "scan_courses"))
    return f"{where} holds no finished labels of this configuration and code; {makers} makes them"
