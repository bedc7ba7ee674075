"""The commands `hdsp map` and `hdsp info`: height maps from files, and the contents of a file."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from hdsp.base.errors import InputError
from hdsp.planning.commands.cloud_commands import (
    POINT_FILES,
    about_cloud,
    add_cloud_mapping,
    add_cloud_reading,
    map_clouds,
)
from hdsp.planning.commands.map_file_commands import (
    MAP_FILES,
    about_map,
    add_cell_size,
    add_map_reading,
    conditioned,
    convert_map,
    describe_map_file,
    map_options,
    refuse_given,
)
from hdsp.terrain.height_map import HeightMap, check_readable
from hdsp.terrain.map_formats import check_writable, is_map


def add_map(commands) -> None:
    """Adds the command `map`."""
    made = commands.add_parser(
        "map", help="make a height map of point clouds, or convert one", description=_map.__doc__
    )
    made.add_argument("files", nargs="*", metavar="FILE", help=f"{MAP_FILES}, or {POINT_FILES}; several are fused")
    made.add_argument("--out", required=True, help="the map: .npz, .h5, .tif")
    made.add_argument("--picture", help="a PNG of the map")
    made.add_argument("--resolution", type=float, help="m, side of a cell (default: 0.025, what the planner needs)")
    made.add_argument(
        "--condition", action="store_true", help="remove noise, spikes and small holes, and resample to 0.025 m"
    )
    add_cloud_mapping(made)
    add_map_reading(made)
    made.set_defaults(run=lambda chosen: _map(chosen, made))


def add_info(commands) -> None:
    """Adds the command `info`."""
    told = commands.add_parser("info", help="say what a file holds", description=_info.__doc__)
    told.add_argument("file", metavar="FILE", help=f"{MAP_FILES}, a shard of labels, or {POINT_FILES}")
    add_cloud_reading(told)
    add_map_reading(told)
    add_cell_size(told)
    told.set_defaults(run=lambda chosen: _info(chosen, told))


def _map(chosen: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """Makes a height map of point clouds: a tilt of the sensor, ceilings and overhangs removed, small holes filled.

    A height map file is read and written in the format of --out. With --condition, the result is a map for planning.
    """
    if not chosen.files and not chosen.scan:
        raise InputError("map: no file; need a height map, point clouds, or --scan with a description")
    if not chosen.scan and any(is_map(path) for path in chosen.files):
        _picture(convert_map(chosen, parser), chosen)
        return
    for file in chosen.files:
        check_readable(file)
    _refuse_map_options(chosen, ("resolution",))
    check_writable(chosen.out)
    measured, about = map_clouds(chosen)
    terrain, done = conditioned(measured, chosen)
    terrain.save(chosen.out)
    print(f"{chosen.out}: {about_map(terrain)}; {about}{done}")
    _picture(terrain, chosen)


def _picture(terrain: HeightMap, chosen: argparse.Namespace) -> None:
    if chosen.picture:
        from hdsp.viz import save_map

        save_map(terrain, chosen.picture, ", ".join(Path(path).name for path in chosen.files) or Path(chosen.scan).stem)
        print(f"{chosen.picture}: picture")


def _info(chosen: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """Says what a height map, a shard of labels or a point cloud holds, and what looks wrong."""
    path = Path(chosen.file)
    check_readable(path)
    if not is_map(path):
        _refuse_map_options(chosen, ())
        print(about_cloud(path, chosen))
    elif (shard := _shard(path)) is not None:
        print(shard)
    else:
        refuse_given(chosen, parser, ("file", *map_options(chosen)), f"the height map {path}")
        describe_map_file(path, chosen)


def _refuse_map_options(chosen: argparse.Namespace, apply: tuple[str, ...]) -> None:
    for name in map_options(chosen):
        if name not in apply:
            raise InputError(f"option --{name} does not apply to point clouds")


def _shard(path: Path) -> str | None:
    """About a shard; None if the file is none. A damaged shard raises InputError."""
    from hdsp.labels.shards import is_shard, read_shard

    if path.suffix.lower() != ".h5" or not path.is_file() or not is_shard(path):
        return None
    tasks, attributes = read_shard(path)
    names, counts = np.unique(tasks.category, return_counts=True)
    kinds = ", ".join(f"{count} {name}" for name, count in zip(names, counts, strict=True))
    about = "; ".join(f"{name}: {attributes[name]}" for name in ("place", "licence", "source") if name in attributes)
    text = f"shard of {len(tasks)} maps ({kinds}), {tasks.feasible.size} tasks, {int(tasks.feasible.sum())} feasible"
    return f"{text}; {about}" if about else text
