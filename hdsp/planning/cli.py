"""The command `hdsp`: maps from point clouds, plans on them, and what a file holds."""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.files import replacing
from hdsp.robot.robot import FEET
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.map_files import is_map
from hdsp.terrain.pointcloud import FORMATS, FloorSettings, MapSettings, fit_floor, map_points, read_points

#: Exit status where there is no plan.
NO_PLAN = 3

_POINT_FILES = f"points ({', '.join(FORMATS)}; also with .gz or .bz2)"


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line; returns the exit status. Bad input gives one line and status 1, no plan status 3."""
    chosen = _parser().parse_args(arguments)
    try:
        return chosen.run(chosen) or 0
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="hdsp", description="Hybrid driving-stepping planning.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    made = commands.add_parser("map", help="make a height map of point clouds", description=_map.__doc__)
    made.add_argument("files", nargs="+", metavar="FILE", help=f"{_POINT_FILES}; several are fused as they are")
    made.add_argument("--out", required=True, help="the map: .npz, .h5")
    made.add_argument("--picture", help="a PNG of the map")
    _add_reading(made)
    default = MapSettings()
    made.add_argument("--resolution", type=float, help="m, side of a cell (default: 0.025, what the planner needs)")
    made.add_argument(
        "--no-level", dest="level", action="store_false", help="keep z as it is: do not look for the floor"
    )
    corners = ("X_MIN", "Y_MIN", "X_MAX", "Y_MAX")
    made.add_argument("--box", nargs=4, type=float, metavar=corners, help="m; drop all points outside")
    meanings = {
        "lowest": "m above the floor; lower points are dropped",
        "highest": "m above the floor; higher points, as of a ceiling, are dropped",
        "headroom": "m; what is above a gap of this height is dropped",
        "fill": "cells; radius of the holes that are filled",
        "smooth": "m; heights that differ by less are averaged",
        "neighbours": "points with fewer others nearby are dropped",
        "near": "m; what nearby means",
    }
    for name, meaning in meanings.items():
        value = getattr(default, name)
        made.add_argument(f"--{name}", type=type(value), default=value, help=f"{meaning} (default: {value})")
    made.set_defaults(run=_map)
    _add_planning(commands.add_parser("plan", help="plan a path on a height map", description=_plan.__doc__))
    told = commands.add_parser("info", help="say what a file holds", description=_info.__doc__)
    told.add_argument("file", metavar="FILE", help=f"a height map, a shard of labels, or {_POINT_FILES}")
    _add_reading(told)
    told.set_defaults(run=_info)
    return parser


def _add_planning(parser: argparse.ArgumentParser) -> None:
    pose: dict[str, Any] = {"nargs": 3, "type": float, "required": True, "metavar": ("X", "Y", "DEGREES")}
    parser.add_argument("map", metavar="MAP", help="a height map with cells of 0.025 m: .npz, .h5")
    parser.add_argument("--start", help="base position in m, heading against the x axis", **pose)
    parser.add_argument("--goal", help="the same", **pose)
    parser.add_argument("--robot", default="momaro", help="a preset or a YAML file (default: momaro)")
    parser.add_argument(
        "--heuristic", default="manual",
        help="geometric, manual, learned (the abstraction that comes with the package) or learned:FOLDER "
        "(default: manual)",
    )  # fmt: skip
    parser.add_argument("--weight", type=float, default=1.25, help="how much speed counts, from 1 on (default: 1.25)")
    parser.add_argument(
        "--margin", type=float, default=0.0, help="m that the body keeps clear of obstacles (default: 0)"
    )
    parser.add_argument("--time", type=float, default=60.0, help="s after which the search gives up (default: 60)")
    parser.add_argument("--out", help="a CSV file of the states (m, rad) and of the actions that lead to them")
    parser.add_argument("--picture", help="a PNG of the path")
    parser.set_defaults(run=_plan)


def _add_reading(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--units", type=float, default=1.0, help="metres per unit of the file, e.g. 0.001 (default: 1)")
    parser.add_argument(
        "--axes", default="x,y,z", help="its axes that are ahead, left, up, e.g. z,-x,-y (default: x,y,z)"
    )
    tilt = np.rad2deg(FloorSettings().max_tilt)
    parser.add_argument(
        "--max-tilt", type=float, default=tilt, help=f"degrees the floor may tilt (default: {tilt:.0f})"
    )


def _map(chosen: argparse.Namespace) -> None:
    """Makes a height map of point clouds: levelled on the floor, ceilings and overhangs removed, small holes filled."""
    points = np.concatenate([_read(path, chosen) for path in chosen.files])
    picked = {field.name: getattr(chosen, field.name) for field in fields(MapSettings) if hasattr(chosen, field.name)}
    picked["box"] = tuple(picked["box"]) if picked["box"] else None
    settings = MapSettings(**picked, floor=_floor_settings(chosen))
    resolution = {} if chosen.resolution is None else {"resolution": chosen.resolution}
    mapped = map_points(points, settings, **resolution)
    terrain = HeightMap(mapped.heights, mapped.origin, mapped.resolution)
    terrain.save(chosen.out)
    print(f"{chosen.out}: {_about_map(terrain)}; of {mapped.report}")
    if chosen.picture:
        from hdsp.viz import save_map

        save_map(terrain, chosen.picture, ", ".join(Path(path).name for path in chosen.files))
        print(f"{chosen.picture}: picture")


def _plan(chosen: argparse.Namespace) -> int:
    """Plans a path and says what it does and costs, or why there is none (exit status 3)."""
    from hdsp.planning.planner import Planner

    planner = Planner(HeightMap.load(chosen.map), chosen.robot, chosen.heuristic, chosen.margin)
    start, goal = (np.array([x, y, np.deg2rad(degrees)]) for x, y, degrees in (chosen.start, chosen.goal))
    plan = planner.prepare().plan(start, goal, chosen.weight, time=chosen.time)
    print(plan.explain())
    if not plan.solved:
        return NO_PLAN
    print(f"{plan.stats.expansions:,} states expanded in {plan.stats.seconds:.2f} s")
    if chosen.out:
        with replacing(chosen.out) as temporary:
            _write_states(plan, temporary)
        print(f"{chosen.out}: {len(plan.states)} states")
    if chosen.picture:
        plan.show(chosen.picture)
        print(f"{chosen.picture}: picture")
    return 0


def _write_states(plan, path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["action", "x", "y", "heading", *FEET])
        for action, state in zip(["", *plan.actions], plan.states, strict=True):
            table.writerow([action, *(f"{value:.6g}" for value in state)])


def _info(chosen: argparse.Namespace) -> None:
    """Says what a height map, a shard of labels or a point cloud holds."""
    path = Path(chosen.file)
    if not is_map(path):
        print(_about_points(_read(path, chosen), _floor_settings(chosen)))
    elif (shard := _shard(path)) is not None:
        print(shard)
    else:
        print(_about_map(HeightMap.load(path)))


def _read(path: str | Path, chosen: argparse.Namespace) -> np.ndarray:
    # With an equals sign: --axes=-y,x,z, else the minus looks like an option.
    return read_points(path, chosen.units, tuple(name.strip() for name in chosen.axes.split(",")))


def _floor_settings(chosen: argparse.Namespace) -> FloorSettings:
    return replace(FloorSettings(), max_tilt=float(np.deg2rad(chosen.max_tilt)))


def _about_map(terrain: HeightMap) -> str:
    known = terrain.heights[np.isfinite(terrain.heights)]
    (nx, ny), (length, width) = terrain.shape, terrain.size
    text = f"height map of {nx} x {ny} cells of {terrain.resolution:g} m, {length:.2f} x {width:.2f} m from "
    text += f"({terrain.origin[0]:.2f}, {terrain.origin[1]:.2f}), {known.size / terrain.heights.size:.0%} known"
    if known.size:
        text += f", heights {known.min():.2f} to {known.max():.2f} m (median {np.median(known):.2f})"
    return text


def _about_points(points: np.ndarray, settings: FloorSettings) -> str:
    low, high = points.min(axis=0), points.max(axis=0)
    spans = ", ".join(f"{name} {a:.2f} to {b:.2f}" for name, a, b in zip("xyz", low, high, strict=True))
    text = f"{len(points)} points, {spans} m"
    try:
        floor = fit_floor(points, settings)
    except InputError as error:
        return f"{text}; {error}"
    middle = points.mean(axis=0)
    height = (floor.offset - floor.normal[:2] @ middle[:2]) / floor.normal[2]
    return f"{text}; floor at z = {height:.2f} m in the middle, tilted by {np.rad2deg(floor.tilt):.1f} degrees"


def _shard(path: Path) -> str | None:
    """About a shard; None if the file is none. A damaged shard raises InputError."""
    from hdsp.labels.shards import is_shard, read_shard

    if path.suffix != ".h5" or not path.is_file() or not is_shard(path):
        return None
    tasks, attributes = read_shard(path)
    names, counts = np.unique(tasks.category, return_counts=True)
    kinds = ", ".join(f"{count} {name}" for name, count in zip(names, counts, strict=True))
    about = "; ".join(f"{name}: {attributes[name]}" for name in ("place", "licence", "source") if name in attributes)
    text = f"shard of {len(tasks)} maps ({kinds}), {tasks.feasible.size} tasks, {int(tasks.feasible.sum())} feasible"
    return f"{text}; {about}" if about else text


if __name__ == "__main__":
    sys.exit(main())
