"""Splits: their maps, the distribution of maps over shards, and everything on which the labels depend.

Map number t in a split is map ``t // categories`` of category ``t % categories``; a shard contains the labels for
consecutive maps. A label set's folder is named by a hash of everything its labels depend on, including code.
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field

from hdsp.base.extensions import TERRAIN, extension_place
from hdsp.base.messages import did_you_mean
from hdsp.base.provenance import ROOT, code_fingerprint
from hdsp.base.settings import DISTINCT, Count, Seed, checked, fault
from hdsp.labels.shard_index import ShardPlan, planned_shards
from hdsp.labels.shards import SCHEMA_VERSION
from hdsp.labels.tasks import TaskSet, columns_of
from hdsp.robot.lattice import HEADINGS_PER_ABSTRACT, PATCH_CELLS, AbstractHeading
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.patches import ROTATED_MAP_CELLS
from hdsp.terrain.scenes import (
    ALL_CATEGORIES,
    CATEGORIES,
    TerrainSettings,
    categories,
    category_number,
    is_category,
    random_map,
)
from hdsp.terrain.sensor_model import SensingSettings, sensed

if TYPE_CHECKING:
    from hdsp.labels.rules import LabelSettings, MapTasks

#: (map, robot, settings, start heading) -> labels, or None for a map that the split leaves out.
LabelMap = Callable[[HeightMap, Robot, "LabelSettings", int], "MapTasks | None"]


def _known_category(name: str) -> str:
    if not is_category(name):
        known = categories()
        raise fault("", name, f"one of {', '.join(known)}, or module:function{did_you_mean(name, known)}")
    return name


Category = Annotated[str, AfterValidator(_known_category)]


@checked
class SplitSettings:
    """Maps of a split.

    Attributes:
        seed: seed for the random maps.
        maps_per_category: map count before maps without a valid start are dropped.
        heading_residues: abstract start headings, [0, 16), used in turn. Goals in the robot frame repeat at every
            quarter turn, so [0, 1, 2, 3] covers all goals that a planner needs.
        categories: terrain categories.
        maps_per_shard: maps per shard, including maps dropped later.
        sensing: whether maps pass through the sensor model before they are labelled (`hdsp.terrain.sensor_model`).
        standable: true keeps the maps where the robot can stand at the start, false keeps the others. All tasks on the
            other maps are infeasible; a network trained without them gives arbitrary predictions there.

    Raises:
        InputError: if a number is out of range, or a category is unknown or there twice.
    """

    seed: Seed
    maps_per_category: Count
    heading_residues: Annotated[tuple[AbstractHeading, ...], Field(min_length=1)] = (0,)
    categories: Annotated[tuple[Category, ...], Field(min_length=1), DISTINCT] = CATEGORIES
    maps_per_shard: Count = 90
    sensing: bool = False
    standable: bool = True

    @property
    def maps(self) -> int:
        """Number of maps before dropping."""
        return self.maps_per_category * len(self.categories)


@dataclass(frozen=True)
class LabelRun:
    """Everything that determines the labels of a split, except the map count."""

    split: SplitSettings
    robot: Robot
    terrain: TerrainSettings
    settings: "LabelSettings"
    sensing: SensingSettings = field(default_factory=SensingSettings)

    def inputs(self) -> dict[str, Any]:
        """Plain values by name; a fingerprint represents the code."""
        split = asdict(self.split)
        del split["maps_per_category"]  # more maps add shards, but do not change existing ones
        return {
            "schema_version": SCHEMA_VERSION,
            "code": labels_code(),
            "split": split,
            "robot": self.robot.hash(),
            "terrain": asdict(self.terrain),
            "settings": asdict(self.settings),
            **({"sensing": asdict(self.sensing)} if self.split.sensing else {}),
            **({"category_code": own} if (own := category_code(self.split.categories)) else {}),
        }

    @cached_property
    def inputs_text(self) -> str:
        """`inputs` as JSON."""
        return json.dumps(self.inputs(), sort_keys=True)

    @cached_property
    def labels_hash(self) -> str:
        """SHA-256 of `inputs_text`."""
        return hashlib.sha256(self.inputs_text.encode()).hexdigest()

    def shards(self) -> list[ShardPlan]:
        """The split's planned shards, in order."""
        return planned_shards(self.split.maps, self.split.maps_per_shard)

    def map_of(self, number: int) -> tuple[str, int, int]:
        """(category, index, detailed start heading) for map ``number``."""
        index, category = divmod(number, len(self.split.categories))
        residues = self.split.heading_residues
        return self.split.categories[category], index, residues[index % len(residues)] * HEADINGS_PER_ABSTRACT

    def terrain_of(self, number: int) -> HeightMap:
        """Makes the height map with number ``number``."""
        category, index, heading = self.map_of(number)
        cells = PATCH_CELLS if heading == 0 else ROTATED_MAP_CELLS
        terrain = random_map(self.split.seed, category, index, self.terrain, cells, heading)
        if not self.split.sensing:
            return terrain
        # A separate random stream: a map has the same scene with and without sensing.
        numbers = [self.split.seed, category_number(category), index, 1]
        return sensed(terrain, self.sensing, np.random.default_rng(np.random.SeedSequence(numbers)))

    def tasks_of(self, number: int, label: "LabelMap | None" = None) -> "MapTasks | None":
        """Labels map ``number``.

        Args:
            number: map number in the split.
            label: function that labels the map; None = the split's labelling rule.

        Returns:
            The tasks, or None for a map that the split leaves out.
        """
        label = label or self._rule()
        return label(self.terrain_of(number), self.robot, self.settings, self.map_of(number)[2])

    def _rule(self) -> "LabelMap":
        from hdsp.labels import rules  # with all kernels; a process that only plans shards does not need them

        return rules.label_map if self.split.standable else rules.label_unstandable

    def task_set(self, maps: Sequence[int], labels: "Sequence[MapTasks | None]") -> TaskSet:
        """Task set for the maps in a shard, without maps that the split leaves out."""
        kept = [(number, tasks) for number, tasks in zip(maps, labels, strict=True) if tasks is not None]
        if not kept:
            return TaskSet.empty()
        numbers, tasks = zip(*kept, strict=True)
        category, index, heading = zip(*map(self.map_of, numbers), strict=True)
        return TaskSet(
            **columns_of(tasks),
            category=np.array(category),
            index=np.array(index),
            heading=np.array(heading),
            seed=np.full(len(kept), self.split.seed),
        )

    def describe(self, number: int) -> str:
        """Describes map ``number`` so that a reader can make it again."""
        return "the map with seed {}, category {}, index {}, heading {}".format(self.split.seed, *self.map_of(number))


def category_code(names: Sequence[str]) -> dict[str, str]:
    """Returns fingerprints of the code behind the categories of other packages, by category."""
    places = {name: extension_place(TERRAIN, name) for name in names}
    return {name: code_fingerprint(place) for name, place in places.items() if place and name not in ALL_CATEGORIES}


def labels_code(root: Path = ROOT) -> str:
    """Fingerprint of all code on which labels depend; ``root``: folder with another copy of the package."""
    return code_fingerprint(LabelRun.tasks_of, LabelRun.task_set, root=root)
