"""Which maps a split consists of, which shard holds which, and all that their labels depend on.

Map number t of a split is map ``t // categories`` of category ``t % categories``; a shard holds the labels of
consecutive maps. Its name contains a hash of everything its labels depend on, code included.
"""

import hashlib
import json
import re
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.provenance import code_fingerprint
from hdsp.labels.shards import SCHEMA_VERSION, SUFFIX
from hdsp.robot.lattice import ABSTRACT_HEADINGS, HEADINGS_PER_ABSTRACT, PATCH_CELLS
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import ALL_CATEGORIES, CATEGORIES, TerrainSettings, random_map
from hdsp.terrain.sensor_model import SensingSettings, sensed

if TYPE_CHECKING:
    from hdsp.labels.rules import LabelSettings

#: Raised when this module gives maps other numbers, headings or sizes; the rest of the code is hashed.
LABELS_VERSION = 1

#: Side of the map around a start that does not head along x: it holds the patch at every heading.
TURNED_MAP_CELLS = 104

#: What the names of shards of any split and any settings look like.
SHARD_NAME = re.compile(rf"\d{{5,}}-[0-9a-f]{{12}}{re.escape(SUFFIX)}")


@dataclass(frozen=True)
class SplitSettings:
    """Which maps a split consists of.

    Attributes:
        seed: of its random maps.
        maps_per_category: before those without a valid start are dropped.
        heading_residues: abstract headings, [0, 16), that maps start with in turn. Goals in the robot frame
            repeat at every quarter turn, so [0, 1, 2, 3] covers all that a planner asks for.
        categories: of terrain.
        maps_per_shard: before dropping.
        sensing: whether maps are made such as sensors see them, before they are labelled (`hdsp.terrain.sensor_model`).
        standable: which maps are kept: those at whose start the robot can stand, or (false) those where it cannot. Of
            the latter all tasks are infeasible; a network that learnt from the former alone makes something up there.

    Raises:
        InputError: for a number out of range or an unknown category.
    """

    seed: int
    maps_per_category: int
    heading_residues: tuple[int, ...] = (0,)
    categories: tuple[str, ...] = CATEGORIES
    maps_per_shard: int = 90
    sensing: bool = False
    standable: bool = True

    def __post_init__(self):
        for name, least in (("seed", 0), ("maps_per_category", 1), ("maps_per_shard", 1)):
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise InputError(f"split: {name} is {value!r}; need a whole number of at least {least}")
        object.__setattr__(self, "heading_residues", tuple(self.heading_residues))
        object.__setattr__(self, "categories", tuple(self.categories))
        if not self.heading_residues or not set(self.heading_residues) <= set(range(ABSTRACT_HEADINGS)):
            allowed = f"abstract headings, 0 to {ABSTRACT_HEADINGS - 1}"
            raise InputError(f"split: heading_residues is {list(self.heading_residues)}; need some {allowed}")
        if not self.categories or not set(self.categories) <= set(ALL_CATEGORIES):
            raise InputError(f"split: categories is {list(self.categories)}; need some of {', '.join(ALL_CATEGORIES)}")
        for name in ("sensing", "standable"):
            if not isinstance(getattr(self, name), bool):
                raise InputError(f"split: {name} is {getattr(self, name)!r}; need true or false")

    @property
    def maps(self) -> int:
        """Number of maps before dropping."""
        return self.maps_per_category * len(self.categories)


class ShardPlan(NamedTuple):
    """A shard to be: the name of its file, and the numbers of its maps."""

    name: str
    maps: range


@dataclass(frozen=True)
class LabelRun:
    """All that the labels of a split depend on, apart from the number of maps."""

    split: SplitSettings
    robot: Robot
    terrain: TerrainSettings
    settings: "LabelSettings"
    sensing: SensingSettings = field(default_factory=SensingSettings)

    def inputs(self) -> dict[str, Any]:
        """Plain values by name; the code as a fingerprint."""
        split = asdict(self.split)
        del split["maps_per_category"]  # more maps add shards and leave those that are there as they are
        if self.split.standable:  # as it was before there was a choice: shards of then still hold
            del split["standable"]
        return {
            "schema_version": SCHEMA_VERSION,
            "labels_version": LABELS_VERSION,
            "code": labels_code(),
            "split": split,
            "robot": self.robot.hash(),
            "terrain": asdict(self.terrain),
            "settings": asdict(self.settings),
            **({"sensing": asdict(self.sensing)} if self.split.sensing else {}),
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
        """The shards of the split, in order."""
        step, maps = self.split.maps_per_shard, self.split.maps
        return [
            ShardPlan(f"{k:05d}-{self.labels_hash[:12]}{SUFFIX}", range(first, min(first + step, maps)))
            for k, first in enumerate(range(0, maps, step))
        ]

    def map_of(self, number: int) -> tuple[str, int, int]:
        """(category, index, detailed start heading) of map ``number`` of the split."""
        index, category = divmod(number, len(self.split.categories))
        residues = self.split.heading_residues
        return self.split.categories[category], index, residues[index % len(residues)] * HEADINGS_PER_ABSTRACT

    def terrain_of(self, number: int) -> HeightMap:
        """The height map of map ``number``."""
        category, index, heading = self.map_of(number)
        cells = PATCH_CELLS if heading == 0 else TURNED_MAP_CELLS
        terrain = random_map(self.split.seed, category, index, self.terrain, cells, heading)
        if not self.split.sensing:
            return terrain
        # A stream of its own: the scene of a map is the same with and without.
        numbers = [self.split.seed, ALL_CATEGORIES.index(category), index, 1]
        return sensed(terrain, self.sensing, np.random.default_rng(np.random.SeedSequence(numbers)))

    def describe(self, number: int) -> str:
        """Names map ``number``, so that it can be made again."""
        return "the map with seed {}, category {}, index {}, heading {}".format(self.split.seed, *self.map_of(number))


def labels_code() -> str:
    """Fingerprint of the code that labels depend on."""
    return code_fingerprint(["hdsp.labels.rules", "hdsp.terrain.scenes"])
