"""The command `hdsp map`: height maps of point clouds and of other height maps."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from hdsp.base.errors import InputError
from hdsp.base.files import writable_file
from hdsp.planning.commands.cloud_commands import POINT_FILES, add_cloud_mapping, map_clouds
from hdsp.planning.commands.command_parser import add_json, takes_file
from hdsp.planning.commands.json_documents import map_fields
from hdsp.planning.commands.map_file_commands import (
    MAP_FILES,
    about_map,
    add_map_reading,
    conditioned,
    convert_map,
    map_options,
    refuse_map_options,
)
from hdsp.planning.commands.output_files import outputs_of, refuse_overwriting
from hdsp.terrain.height_map import HeightMap, check_readable
from hdsp.terrain.map_formats import check_writable, is_map

_EXAMPLES = """examples:
  hdsp map room.las --out room.npz --picture room.png
  hdsp map front.pcd rear.pcd --box 0 -2 8 2 --out yard.h5     fused, cut
  hdsp map camera.ply --axes=z,-x,-y --units 0.001 --out lab.npz
  hdsp map elevation.bag --layer elevation --condition --out map.npz
  hdsp map --scan conf/scans/pcl_room_scan.yaml --out room.npz"""


def add_map(commands) -> None:
    """Adds the command `map`."""
    made = commands.add_parser(
        "map", help="make a height map of point clouds, or convert one", description=_map.__doc__, epilog=_EXAMPLES
    )
    files = f"{MAP_FILES}, or {POINT_FILES}; several are fused"
    takes_file(made.add_argument("files", nargs="*", metavar="FILE", help=files))
    takes_file(made.add_argument("--out", required=True, help="the map: .npz, .h5, .tif"))
    takes_file(made.add_argument("--picture", help="a PNG of the map"))
    add_json(made)
    made.add_argument("--resolution", type=float, help="m, side of a cell (default: 0.025, what the planner needs)")
    made.add_argument(
        "--condition", action="store_true", help="remove noise, spikes and small holes, and resample to 0.025 m"
    )
    add_cloud_mapping(made)
    add_map_reading(made)
    made.set_defaults(run=lambda chosen: _map(chosen, made))


def _map(chosen: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """Makes a height map of point clouds: a tilt of the sensor, ceilings and overhangs removed, small holes filled.

    A height map file is read and written in the format of --out. With --condition, the result is a map for planning.
    """
    if not chosen.files and not chosen.scan:
        raise InputError("map: no file; need a height map, point clouds, or --scan with a description")
    _check_outputs(chosen)
    if not chosen.scan and any(is_map(path) for path in chosen.files):
        with chosen.console.progress.during(f"converting {Path(chosen.files[0]).name}"):
            terrain = convert_map(chosen, parser)
        _finish(terrain, chosen)
        return
    for file in chosen.files:
        check_readable(file)
    refuse_map_options(chosen, ("resolution",))
    measured, about = map_clouds(chosen)
    with chosen.console.progress.during("writing the map"):
        terrain, done = conditioned(measured, chosen)
        terrain.save(chosen.out)
    chosen.console.tell(f"{chosen.out}: {about_map(terrain)}; {about}{done}")
    _finish(terrain, chosen)


def _check_outputs(chosen: argparse.Namespace) -> None:
    """Checks the output files and the package for the picture before any work."""
    check_writable(chosen.out)
    refuse_overwriting(outputs_of(chosen, "out", "picture"), [chosen.scan] if chosen.scan else [])
    # A height map may be converted in its place.
    refuse_overwriting(outputs_of(chosen, "picture"), chosen.files)
    writable_file(chosen.out, "map")
    if chosen.picture:
        from hdsp.viz import save_map  # noqa: F401, an extra that may be missing

        writable_file(chosen.picture, "picture", (".png",))


def _finish(terrain: HeightMap, chosen: argparse.Namespace) -> None:
    """Draws the picture, if it is wanted, and prints the JSON document."""
    files = {"out": chosen.out}
    if chosen.picture:
        from hdsp.viz import save_map

        names = ", ".join(Path(path).name for path in chosen.files) or Path(chosen.scan).stem
        title = os.fsencode(names).decode("utf-8", "replace")  # a name of a file is any bytes
        with chosen.console.progress.during("drawing the map"):
            save_map(terrain, chosen.picture, title)
        chosen.console.tell(f"{chosen.picture}: picture")
        files["picture"] = chosen.picture
    given = map_options(chosen)
    chosen.console.document({"status": "done", "map": map_fields(terrain), "options": given, "files": files})
