"""The command `hdsp info`: a file's contents, a robot or a trained abstraction."""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.yaml_files import read_yaml
from hdsp.learning.loading import load_abstraction, presets, robot_of
from hdsp.planning.commands.cloud_commands import POINT_FILES, about_cloud, add_cloud_reading
from hdsp.planning.commands.command_parser import add_json, takes_words
from hdsp.planning.commands.map_file_commands import (
    MAP_FILES,
    add_cell_size,
    add_map_reading,
    describe_map_file,
    map_options,
    refuse_given,
    refuse_map_options,
)
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import check_readable
from hdsp.terrain.map_formats import is_map

_EXAMPLES = """examples:
  hdsp info elevation.bag              layers, size, frame, what looks wrong
  hdsp info room.las --units 0.001     extents, inclination of the floor
  hdsp info momaro                     a robot; momaro-klamt2019: an abstraction
  hdsp info labels/train/00000.h5 --json"""


def add_info(commands) -> None:
    """Adds the command `info`."""
    told = commands.add_parser("info", help="say what a file holds", description=_info.__doc__, epilog=_EXAMPLES)
    subject = told.add_argument(
        "file",
        metavar="FILE",
        help=f"{MAP_FILES}, a shard of labels, {POINT_FILES}, a YAML file of a robot, a scan or an arena, the folder "
        f"of an abstraction, or one of {', '.join(sorted({*Robot.presets(), *presets()}))}",
    )
    takes_words(subject, "subject", sorted({*Robot.presets(), *presets()}))
    add_json(told)
    add_cloud_reading(told.add_argument_group("reading a point cloud"))
    add_map_reading(told)
    add_cell_size(told)
    told.set_defaults(run=lambda chosen: _info(chosen, told))


def _info(chosen: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """Says what a height map, a point cloud, a shard of labels, a robot or a trained abstraction holds, and what looks
    wrong.
    """
    path = Path(chosen.file)
    with chosen.console.progress.during(f"reading {path.name}"):
        kind, fields = _described(path, chosen, parser)
    chosen.console.document({"status": "done", "kind": kind, "file": chosen.file, **fields})


def _described(
    path: Path, chosen: argparse.Namespace, parser: argparse.ArgumentParser
) -> tuple[str, Mapping[str, Any]]:
    """Tells about a file; returns its kind, and fields for JSON."""
    tell = chosen.console.tell
    named = not os.path.exists(path) and chosen.file in {*Robot.presets(), *presets()}
    if named or path.suffix.lower() in (".yaml", ".yml") or os.path.isfile(path / "config.json"):
        refuse_given(chosen, parser, ("file",), chosen.file)
        kind, words, fields = _settings(chosen.file, path)
    elif is_map(path):
        shard = _shard(path)
        if shard is None:
            refuse_given(chosen, parser, ("file", *map_options(chosen)), f"the height map {path}")
            return "height map", describe_map_file(path, chosen)
        kind, (words, fields) = "labels", shard
    elif not os.path.exists(path) and not path.suffix:
        known = ", ".join(sorted({*Robot.presets(), *presets()}))
        raise InputError(f"{chosen.file}: no such file, and none of the robots and abstractions {known}")
    else:
        check_readable(path)
        refuse_map_options(chosen, ())
        words = about_cloud(path, chosen)
        kind, fields = "point cloud", {"words": words.split("; ")}
    tell(words)
    return kind, fields


def _settings(name: str, path: Path) -> tuple[str, str, Mapping[str, Any]]:
    """About a robot, an abstraction, a scan or an arena."""
    if os.path.isdir(path) or (name in presets() and name not in Robot.presets()):
        return "abstraction", *_abstraction(name)
    values = {} if not os.path.isfile(path) else read_yaml(path, "settings").values
    if isinstance(values, Mapping) and "files" in values:
        from hdsp.terrain.scans import load_scan

        scan = load_scan(path)
        words = f"scan {scan.name}: {scan.place}, {len(scan.files)} files, licence {scan.licence}, {scan.source}"
        return "scan", words, {"name": scan.name, "place": scan.place, "licence": scan.licence, "source": scan.source}
    if isinstance(values, Mapping) and "wall_height" in values:
        from hdsp.terrain.arenas import read_arena

        arena = read_arena(values)
        obstacles = len(arena.scene.obstacles)
        words = f"arena of {arena.size:g} x {arena.size:g} m with {obstacles} obstacles, walls among them"
        return "arena", words, {"size": arena.size, "obstacles": obstacles}
    return "robot", *_robot(Robot.load(name))


def _robot(robot: Robot) -> tuple[str, Mapping[str, Any]]:
    feet, drive, step, slope = robot.feet, robot.drive, robot.step, robot.slope
    length, width = 2 * feet.neutral_x, 2 * feet.neutral_y
    if step.max_length:
        steps = f"up to {step.max_length:g} m long and {step.max_height:g} m high"
    else:
        steps = "none"
    fitting = [name for name in presets() if robot_of(name) == robot.name]
    ways = "in all directions" if drive.sideways else "ahead and back"
    lines = [
        f"robot {robot.name}",
        f"feet: a rectangle of {length:g} x {width:g} m, each {feet.offset_min:g} to {feet.offset_max:g} m along it",
        f"wheels: pass edges of {drive.highest_edge:g} m, drive {ways}",
        f"turns: {'on the spot' if robot.turn.on_the_spot else f'arcs of at least {robot.turn.radius:g} m'}",
        f"steps: {steps}",
        f"slopes: {math.degrees(slope.max_pitch):.0f} degrees ahead, {math.degrees(slope.max_roll):.0f} across",
        f"abstractions that come with the package: {', '.join(fitting) or 'none'}",
    ]
    return "\n".join(lines), {"name": robot.name, "abstractions": fitting, "values": robot.to_dict()}


def _abstraction(name: str) -> tuple[str, Mapping[str, Any]]:
    found = load_abstraction(name)
    robot = found.provenance.robot or "an unknown robot"
    shown = {key: value for key, value in sorted(found.metrics.items()) if "/" in key and key.count("/") == 1}
    lines = [
        f"trained abstraction for {robot}: {found.model.architecture}",
        f"costs for planning: {'predicted' if found.predicts_planning_cost else 'from label costs'}; edges are open "
        f"from a probability of {found.edges_threshold:g}",
        *(f"{key}: {value:.4g}" for key, value in shown.items()),
    ]
    fields = {
        "robot": found.provenance.robot,
        "architecture": found.model.architecture,
        "labels_hash": found.provenance.labels_hash,
        "edges_threshold": found.edges_threshold,
        "metrics": found.metrics,
        "model": found.model.to_dict(),
    }
    return "\n".join(lines), fields


def _shard(path: Path) -> tuple[str, Mapping[str, Any]] | None:
    """About a shard; None if the file is none. A damaged shard raises InputError."""
    from hdsp.labels.shards import is_shard, read_shard

    if path.suffix.lower() != ".h5" or not os.path.isfile(path) or not is_shard(path):
        return None
    tasks, attributes = read_shard(path)
    names, counts = np.unique(tasks.category, return_counts=True)
    kinds = ", ".join(f"{count} {name}" for name, count in zip(names, counts, strict=True))
    about = "; ".join(f"{name}: {attributes[name]}" for name in ("place", "licence", "source") if name in attributes)
    text = f"shard of {len(tasks)} maps ({kinds}), {tasks.feasible.size} tasks, {int(tasks.feasible.sum())} feasible"
    fields = {
        "maps": len(tasks),
        "categories": dict(zip(names.tolist(), counts.tolist(), strict=True)),
        "tasks": tasks.feasible.size,
        "feasible": int(tasks.feasible.sum()),
        "attributes": attributes,
    }
    return (f"{text}; {about}" if about else text), fields
