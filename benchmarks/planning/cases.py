"""Cases of the planning benchmark: a map with its pairs, kept in a folder with all results for them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.planning.maps import maps
from benchmarks.planning.pairs import Pair, draw_pairs, map_key
from hdsp.base.files import replacing
from hdsp.planning.planner import Planner
from hdsp.terrain.height_map import HeightMap

CASE = "case.json"
MAP = "map.npz"
_PAIRS_STREAM = 1  # the seeds of the pairs differ from those of the map


@dataclass(frozen=True)
class Case:
    """A map and pairs of poses on it, in a folder.

    Attributes:
        folder: for the map, the pairs, and all results.
        name, kind: of the map.
        size: m.
        map_key: hash of the map.
        pairs: starts and goals.
        robot: name of a preset.
    """

    folder: Path
    name: str
    kind: str
    size: tuple[float, float]
    map_key: str
    pairs: tuple[Pair, ...]
    robot: str = "momaro"

    def terrain(self) -> HeightMap:
        return HeightMap.load(self.folder / MAP)


def make_cases(
    seed: int, count: int, pairs: int, out: Path, area: float = np.inf, robot: str = "momaro"
) -> Iterator[Case]:
    """Draws maps and pairs, and writes each case into a folder of ``out``; leaves out maps larger than ``area``, m2."""
    for number, made in enumerate(maps(seed, count)):
        if np.prod(made.terrain.size) > area:
            continue
        planner = Planner(made.terrain, robot)
        drawn = draw_pairs(planner, pairs, np.random.SeedSequence([seed, number, _PAIRS_STREAM]))
        size = tuple(round(float(side), 3) for side in planner.terrain.size)
        folder = out / made.name.replace(" ", "_")
        case = Case(folder, made.name, made.kind, size, map_key(planner.terrain), tuple(drawn), robot)
        with replacing(folder / MAP) as temporary:
            planner.terrain.save(temporary)
        write_json(folder / CASE, {
            "name": case.name, "kind": case.kind, "size": list(case.size), "map_key": case.map_key,
            "robot": robot, "pairs": [asdict(pair) for pair in drawn],
        })  # fmt: skip
        yield case


def read_case(folder: Path) -> Case:
    """Reads a case that ``make_cases`` wrote."""
    values = json.loads((folder / CASE).read_text())
    pairs = tuple(
        Pair(**{**pair, "start": tuple(pair["start"]), "goal": tuple(pair["goal"])}) for pair in values["pairs"]
    )
    size, robot = tuple(values["size"]), values.get("robot", "momaro")
    return Case(folder, values["name"], values["kind"], size, values["map_key"], pairs, robot)


def write_json(path: Path, values) -> None:
    """Writes a file, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(values, indent=1) + "\n")
