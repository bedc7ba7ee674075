"""The commands `hdsp map` and `hdsp info`: height maps from files, and the contents of a file."""

from __future__ import annotations

import argparse
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from hdsp.base.errors import InputError
from hdsp.planning.map_file_commands import (
    MAP_FILES,
    about_map,
    add_cell_size,
    add_map_reading,
    convert_map,
    describe_map_file,
    map_options,
    refuse_given,
)
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.map_formats import check_writable, is_map
from hdsp.terrain.pointcloud import FORMATS, FloorSettings, MapSettings, fit_floor, map_points, read_points

_POINT_FILES = f"points ({', '.join(FORMATS)}; also with .gz or .bz2)"


def add_map(commands) -> None:
    """Adds the command `map`."""
    made = commands.add_parser(
        "map", help="make a height map of point clouds, or convert one", description=_map.__doc__
    )
    made.add_argument("files", nargs="+", metavar="FILE", help=f"{MAP_FILES}, or {_POINT_FILES}; several are fused")
    made.add_argument("--out", required=True, help="the map: .npz, .h5, .tif")
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
    add_map_reading(made)
    made.set_defaults(run=lambda chosen: _map(chosen, made))


def add_info(commands) -> None:
    """Adds the command `info`."""
    told = commands.add_parser("info", help="say what a file holds", description=_info.__doc__)
    told.add_argument("file", metavar="FILE", help=f"{MAP_FILES}, a shard of labels, or {_POINT_FILES}")
    _add_reading(told)
    add_map_reading(told)
    add_cell_size(told)
    told.set_defaults(run=lambda chosen: _info(chosen, told))


def _add_reading(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--units", type=float, default=1.0, help="metres per unit of the file, e.g. 0.001 (default: 1)")
    parser.add_argument(
        "--axes", default="x,y,z", help="its axes that are ahead, left, up, e.g. z,-x,-y (default: x,y,z)"
    )
    tilt = np.rad2deg(FloorSettings().max_tilt)
    parser.add_argument(
        "--max-tilt", type=float, default=tilt, help=f"degrees the floor may tilt (default: {tilt:.0f})"
    )


def _map(chosen: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """Makes a height map of point clouds: levelled on the floor, ceilings and overhangs removed, small holes filled.

    A height map file is read and written in the format of --out.
    """
    if any(is_map(path) for path in chosen.files):
        _picture(convert_map(chosen, parser), chosen)
        return
    _refuse_map_options(chosen, ("resolution",))
    check_writable(chosen.out)
    points = np.concatenate([_read(path, chosen) for path in chosen.files])
    picked = {field.name: getattr(chosen, field.name) for field in fields(MapSettings) if hasattr(chosen, field.name)}
    picked["box"] = tuple(picked["box"]) if picked["box"] else None
    settings = MapSettings(**picked, floor=_floor_settings(chosen))
    resolution = {} if chosen.resolution is None else {"resolution": chosen.resolution}
    mapped = map_points(points, settings, **resolution)
    terrain = HeightMap(mapped.heights, mapped.origin, mapped.resolution)
    terrain.save(chosen.out)
    print(f"{chosen.out}: {about_map(terrain)}; of {mapped.report}")
    _picture(terrain, chosen)


def _picture(terrain: HeightMap, chosen: argparse.Namespace) -> None:
    if chosen.picture:
        from hdsp.viz import save_map

        save_map(terrain, chosen.picture, ", ".join(Path(path).name for path in chosen.files))
        print(f"{chosen.picture}: picture")


def _info(chosen: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """Says what a height map, a shard of labels or a point cloud holds, and what looks wrong."""
    path = Path(chosen.file)
    if not is_map(path):
        _refuse_map_options(chosen, ())
        print(_about_points(_read(path, chosen), _floor_settings(chosen)))
    elif (shard := _shard(path)) is not None:
        print(shard)
    else:
        refuse_given(chosen, parser, ("file", *map_options(chosen)), f"the height map {path}")
        describe_map_file(path, chosen)


def _refuse_map_options(chosen: argparse.Namespace, apply: tuple[str, ...]) -> None:
    for name in map_options(chosen):
        if name not in apply:
            raise InputError(f"option --{name} does not apply to point clouds")


def _read(path: str | Path, chosen: argparse.Namespace) -> np.ndarray:
    # With an equals sign: --axes=-y,x,z, else the minus looks like an option.
    return read_points(path, chosen.units, tuple(name.strip() for name in chosen.axes.split(",")))


def _floor_settings(chosen: argparse.Namespace) -> FloorSettings:
    return replace(FloorSettings(), max_tilt=float(np.deg2rad(chosen.max_tilt)))


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
