"""Patches of a scanned map at valid start states, and their labels."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from hdsp.abstract.transform import feet_at
from hdsp.base.errors import InputError
from hdsp.base.provenance import ROOT, code_fingerprint
from hdsp.base.settings import Count, NotNegative, Seed, Share, checked
from hdsp.detailed.world.world import build_world
from hdsp.labels.label_robots import ROBOT_HASH
from hdsp.labels.rules import LabelSettings, MapTasks, label_map
from hdsp.labels.shards import SCHEMA_VERSION, read_shard, write_shard
from hdsp.labels.tasks import TaskSet, columns_of
from hdsp.robot.lattice import ABSTRACT_HEADINGS, HEADINGS_PER_ABSTRACT, RESOLUTION, Residue, cells, is_detailed
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.patches import ROTATED_MAP_CELLS

#: Largest number of positions and headings tried on a map.
_ATTEMPTS = 20_000
#: m; a patch of bare floor has a smaller height range.
FLAT = 0.05


@checked
class ScanPatchSettings:
    """Start states to draw from a map.

    Attributes:
        seed: seed for positions and headings. Seed, settings and map determine the result.
        count: number of patches per map, if the map has space for them.
        spacing: m, smallest distance between two positions.
        known: smallest share of known cells in a patch.
        flat: largest share of ``count`` for patches with a height range below `FLAT`. Most known ground is bare floor,
            and bare floor tells little about an abstraction.
        heading_residues: abstract headings modulo a quarter turn, as for labels; a random quarter turn is added.

    Raises:
        InputError: if a value is out of range.
    """

    seed: Seed = 0
    count: Count = 16
    spacing: NotNegative = 0.4
    known: Share = 0.5
    flat: Share = 0.25
    heading_residues: Annotated[tuple[Residue, ...], Field(min_length=1)] = (0, 1, 2, 3)


def draw_starts(terrain: HeightMap, robot: Robot, settings: ScanPatchSettings) -> np.ndarray:
    """Draws valid base states uniformly over known ground, and limits the share of bare floor.

    Args:
        terrain: height map with the detailed lattice's cell size.
        robot: the robot that must be able to stand there.
        settings: number and density of the starts.

    Returns:
        int64 [n, 3]: (ix, iy, detailed heading), in the order drawn; n <= count.

    Raises:
        InputError: if the map has another cell size.
    """
    if not is_detailed(terrain.resolution):
        raise InputError(f"patches: cells of {terrain.resolution} m; need {RESOLUTION} m")
    # Unknown cells surround the map, as in the labelled cut-out: feet keep their clearance to the border of the map.
    margin = ROTATED_MAP_CELLS // 2
    around = HeightMap(np.pad(terrain.heights, margin, constant_values=np.nan))
    world = build_world(around, robot)
    known = np.argwhere(np.isfinite(terrain.heights))
    rng = np.random.default_rng(settings.seed)
    starts: list[tuple[int, int, int]] = []
    flat = 0
    for _ in range(_ATTEMPTS if len(known) else 0):
        ix, iy = known[rng.integers(len(known))].tolist()
        residue = settings.heading_residues[len(starts) % len(settings.heading_residues)]
        heading = (int(rng.integers(4)) * ABSTRACT_HEADINGS // 4 + residue) * HEADINGS_PER_ABSTRACT
        distance = np.hypot(*(np.array(starts, int).reshape(-1, 3)[:, :2] - (ix, iy)).T)
        if (
            distance.min(initial=np.inf) < cells(settings.spacing)
            or feet_at(world, (ix + margin, iy + margin, heading)) is None
        ):
            continue
        patch = terrain.crop_cells(ix, iy, heading).heights
        if np.isfinite(patch).mean() < settings.known:
            continue
        bare = bool(np.nanmax(patch) - np.nanmin(patch) < FLAT)
        if bare and flat >= settings.flat * settings.count:
            continue
        flat += bare
        starts.append((ix, iy, heading))
        if len(starts) == settings.count:
            break
    return np.array(starts, dtype=np.int64).reshape(-1, 3)


def label_scan(
    terrain: HeightMap,
    robot: Robot,
    patches: ScanPatchSettings,
    settings: LabelSettings,
    path: str | os.PathLike,
    about: Mapping[str, str],
) -> TaskSet:
    """Labels a map's patches into a shard; a valid shard from the same inputs is kept.

    Args:
        terrain: the scan's height map.
        robot: the robot whose planner makes the labels.
        patches: start states to draw.
        settings: labelling rules.
        path: shard path.
        about: texts by name, stored in the shard; ``place`` becomes the tasks' category.

    Returns:
        the tasks; ``index`` is the patch number in the scan.
    """
    inputs = json.dumps(_inputs(terrain, robot, patches, settings, about), sort_keys=True)
    labels_hash = hashlib.sha256(inputs.encode()).hexdigest()
    if (kept := _valid(Path(path), labels_hash)) is not None:
        return kept
    tasks = labelled_patches(terrain, robot, patches, settings, about["place"])
    write_shard(path, tasks, {"labels_hash": labels_hash, ROBOT_HASH: robot.hash(), **about})
    return tasks


def labelled_patches(
    terrain: HeightMap, robot: Robot, patches: ScanPatchSettings, settings: LabelSettings, place: str
) -> TaskSet:
    """Labels patches drawn from a map; arguments and result as for `label_scan`."""
    starts = draw_starts(terrain, robot, patches)
    labels = [
        label_map(terrain.crop_cells(ix, iy, 0, ROTATED_MAP_CELLS), robot, settings, heading)
        for ix, iy, heading in starts.tolist()
    ]
    return _task_set(labels, starts, place, patches.seed)


def patches_code(root: Path = ROOT) -> str:
    """Fingerprint of all code that determines a map's patches; ``root``: folder with another copy of the package."""
    return code_fingerprint(labelled_patches, root=root)


def _inputs(terrain, robot, patches, settings, about) -> dict[str, Any]:
    heights = hashlib.sha256(terrain.heights.tobytes()).hexdigest()
    return {
        "schema_version": SCHEMA_VERSION,
        "code": patches_code(),
        "map": [heights, *terrain.shape],
        "robot": robot.to_dict(),
        "patches": asdict(patches),
        "settings": asdict(settings),
        "about": dict(about),
    }


def _valid(path: Path, labels_hash: str) -> TaskSet | None:
    try:
        shard = read_shard(path)
    except InputError:
        return None
    return shard.tasks if shard.attributes.get("labels_hash") == labels_hash else None


def _task_set(labels: list[MapTasks | None], starts: np.ndarray, place: str, seed: int) -> TaskSet:
    kept = [k for k, tasks in enumerate(labels) if tasks is not None]
    if not kept:
        return TaskSet.empty()
    return TaskSet(
        **columns_of([labels[k] for k in kept]),
        category=np.full(len(kept), place),
        index=np.array(kept),
        heading=starts[kept, 2],
        seed=np.full(len(kept), seed),
    )
