"""Roles of labelled maps in an experiment: training, selection of the epoch, evaluation. A map has one role."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

from hdsp.base.settings import fault
from hdsp.base.storage import is_url
from hdsp.labels.course_patches import CoursePatchSettings
from hdsp.labels.run.splits import SplitSettings

if TYPE_CHECKING:
    from .config_types import Config

#: Name of the set that selects the epoch: `trainer.val_splits` together.
SELECTION = "val"


class Use(NamedTuple):
    """Maps in a role.

    Attributes:
        key: place in the configuration.
        value: value there.
        role: `training`, `selection` or `evaluation`.
        place: folder or URL with the labels.
        settings: of a split whose maps are made here, with their key; None = nothing is known about the maps.
    """

    key: str
    value: str
    role: str
    place: str
    settings: tuple[str, SplitSettings | CoursePatchSettings] | None


def check_roles(config: Config) -> None:
    """Checks that no map is in two roles, as far as settings tell.

    Raises:
        PydanticCustomError: two roles share a folder or a split, or their splits repeat each other's maps; or a set
            takes the name of another one.
    """
    trainer = config.trainer
    if trainer.selection.set != SELECTION:
        need = f"{SELECTION} (trainer.val_splits); sets in evaluation.watched choose no epoch"
        raise fault("trainer.selection.set", trainer.selection.set, need)
    for first, second in combinations(_uses(config), 2):
        if first.role != second.role:
            _check_apart(first, second)
    taken = {SELECTION, *trainer.splits, *trainer.val_splits}
    for number, name in enumerate(config.evaluation.watched):
        if name in taken:
            need = f"a set with another name than {', '.join(sorted(taken))}, which the training uses itself"
            raise fault(f"evaluation.watched[{number}]", name, need)
    for name, courses in config.simulation.splits.items():
        if courses.seed == config.simulation.patches.seed:
            need = "another seed than simulation.patches, whose courses it would repeat"
            raise fault(f"simulation.splits.{name}.seed", courses.seed, need)


def _uses(config: Config) -> Iterator[Use]:
    for role, key in (("training", "splits"), ("selection", "val_splits")):
        for number, name in enumerate(getattr(config.trainer, key)):
            yield _of_split(config, f"trainer.{key}[{number}]", name, role)
    for name, entry in config.evaluation.sets.items():
        key = f"evaluation.sets.{name}"
        if entry.split is not None:
            yield _of_split(config, f"{key}.split", entry.split, "evaluation")
        else:
            kind, inputs = ("tasks", config.runtime.inputs) if entry.tasks is not None else ("scans", "")
            yield Use(f"{key}.{kind}", entry.place, "evaluation", _place(inputs, entry.place), None)


def _of_split(config: Config, key: str, name: str, role: str) -> Use:
    random, courses = config.labelling.splits, config.simulation.splits
    folder = "data/labels" if config.labelling.destination is None or name in courses else config.labelling.destination
    if name in courses:
        settings: tuple[str, SplitSettings | CoursePatchSettings] | None = f"simulation.splits.{name}", courses[name]
    else:
        settings = (f"labelling.splits.{name}", random[name]) if name in random else None
    place = _place(config.runtime.inputs, name if settings is None else f"{folder.rstrip('/')}/{name}")
    return Use(key, name, role, place, settings)


def _place(inputs: str, place: str) -> str:
    return place.rstrip("/") if is_url(place) else os.path.abspath(os.path.join(inputs, place))


def _check_apart(first: Use, second: Use) -> None:
    one, other = f"{first.place}/", f"{second.place}/"
    if one.startswith(other) or other.startswith(one):
        need = f"other maps than {first.key}, which are there for {first.role}"
        raise fault(second.key, second.value, need)
    if first.settings is not None and second.settings is not None and _repeat(first.settings[1], second.settings[1]):
        key, settings = second.settings
        need = f"another seed than {first.settings[0]} ({first.role}), whose maps it would repeat for {second.role}"
        raise fault(f"{key}.seed", settings.seed, need)


def _repeat(one: SplitSettings | CoursePatchSettings, other: SplitSettings | CoursePatchSettings) -> bool:
    """Whether two splits have scenes in common: a scene is a function of seed, category and index."""
    if isinstance(one, SplitSettings) and isinstance(other, SplitSettings):
        shared = set(one.categories) & set(other.categories)
        # A split has the maps where the robot can stand, or the others. Sensing may turn one kind into the other.
        complementary = one.standable != other.standable and not (one.sensing or other.sensing)
        return one.seed == other.seed and bool(shared) and not complementary
    return type(one) is type(other) and one.seed == other.seed
