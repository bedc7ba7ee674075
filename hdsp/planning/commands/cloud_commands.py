"""Point clouds on the command line: the options, maps of clouds and scans, and the contents of a cloud."""

from __future__ import annotations

import argparse
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hdsp.base.errors import InputError
from hdsp.planning.commands.command_parser import takes_file
from hdsp.planning.commands.output_files import outputs_of, refuse_overwriting
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.map_frame import MapFrame
from hdsp.terrain.pointcloud import FORMATS, FloorSettings, MapSettings, describe_points, map_points, read_points

POINT_FILES = f"points ({', '.join(FORMATS)}; also with .gz or .bz2)"
_AXES = "x,y,z"
_UPRIGHT = 90.0  # degrees
#: Fields of `MapSettings` that are options of the same name.
_MEANINGS = {
    "lowest": "m above the ground; lower points are dropped",
    "highest": "m above the ground; higher points, as of a ceiling, are dropped",
    "headroom": "m; points above a gap of this height are dropped",
    "fill": "cells; radius of the holes that are filled",
    "smooth": "m; heights that differ by less are averaged",
    "neighbours": "points with fewer others nearby are dropped",
    "near": "m; distance to a point nearby",
}


class MadeMap(NamedTuple):
    """A map with a phrase on its making."""

    terrain: HeightMap
    about: str


def add_cloud_reading(parser: Any) -> None:
    """Adds the options for reading a cloud: units, axes, tilt."""
    parser.add_argument(
        "--units", type=float, help="metres per unit of the file, e.g. 0.001 (default: by the CRS in LAS files, else 1)"
    )
    parser.add_argument(
        "--axes", help=f"the file's axes that are ahead, left, up, e.g. z,-x,-y (default: {_AXES}, checked)"
    )
    parser.add_argument(
        "--max-tilt",
        type=float,
        help="degrees; level the cloud on its floor, tilted by at most so much (default: remove a tilt of the sensor, "
        "keep slopes)",
    )


def add_cloud_mapping(parser: argparse.ArgumentParser) -> None:
    """Adds the options for a map of clouds: a description of a scan, levelling, cuts, filling."""
    group = parser.add_argument_group("making a map of point clouds")
    takes_file(
        group.add_argument(
            "--scan", metavar="YAML", help="a description of a scan, as in conf/scans, in place of options"
        )
    )
    add_cloud_reading(group)
    group.add_argument(
        "--no-level", dest="level", action="store_false", help="keep z as it is: do not look for the floor"
    )
    corners = ("X_MIN", "Y_MIN", "X_MAX", "Y_MAX")
    group.add_argument("--box", nargs=4, type=float, metavar=corners, help="m, after levelling; drop points outside")
    default = MapSettings()
    for name, meaning in _MEANINGS.items():
        value = getattr(default, name)
        group.add_argument(f"--{name}", type=type(value), default=value, help=f"{meaning} (default: {value})")


def map_clouds(chosen: argparse.Namespace) -> MadeMap:
    """Makes a map of point files, fused as they are, or of a described scan.

    Raises:
        InputError: if a file cannot be read, or its points make no map.

    Warns:
        UserWarning: if another axis than z may be up.
    """
    if chosen.scan:
        return _map_scan(chosen)
    if not chosen.level and chosen.max_tilt is not None:
        raise InputError("--no-level keeps z, and --max-tilt levels; need one of them")
    floor, clouds = floor_settings(chosen), []
    for number, path in enumerate(chosen.files, 1):
        with chosen.console.progress.during(f"reading {Path(path).name} ({number} of {len(chosen.files)})"):
            clouds.append(read_cloud(path, chosen))
    points = np.concatenate(clouds)
    settings = MapSettings(
        **{name: getattr(chosen, name) for name in _MEANINGS},
        box=tuple(chosen.box) if chosen.box else None,
        level=False if not chosen.level else None if chosen.max_tilt is None else True,
        floor=floor,
        check_up=chosen.axes is None,
    )
    resolution = {} if chosen.resolution is None else {"resolution": chosen.resolution}
    with chosen.console.progress.during(f"making a map of {len(points):,} points"):
        mapped = map_points(points, settings, **resolution)
    for doubt in mapped.report.doubts:
        warnings.warn(doubt, stacklevel=2)
    frame = MapFrame(to_source=mapped.to_source, notes=mapped.report.notes)
    terrain = HeightMap(mapped.heights, mapped.origin, mapped.resolution, frame)
    return MadeMap(terrain, f"of {mapped.report}")


def _map_scan(chosen: argparse.Namespace) -> MadeMap:
    from hdsp.terrain.scans import build_map, find_files, load_scan

    scan = load_scan(chosen.scan)
    paths = [Path(path) for path in chosen.files]
    if not paths:
        paths, reason = find_files(scan, beside=Path(chosen.scan).parent)
        if not paths:
            raise InputError(reason)
    refuse_overwriting(outputs_of(chosen, "out", "picture"), paths)
    with chosen.console.progress.during(f"making the map of scan {scan.name}"):
        terrain = build_map(scan, paths)
    return MadeMap(terrain, "; ".join([f"scan {scan.name}: {scan.place}", *terrain.frame.notes]))


def about_cloud(path: str | Path, chosen: argparse.Namespace) -> str:
    """Lines on a cloud: its extents, faults, and the result of `hdsp map`."""
    return describe_points(read_cloud(path, chosen), floor_settings(chosen), level=chosen.max_tilt is not None)


def read_cloud(path: str | Path, chosen: argparse.Namespace) -> np.ndarray:
    """Points of a file with the chosen units and axes."""
    # With an equals sign: --axes=-y,x,z, else the minus looks like an option.
    return read_points(path, chosen.units, tuple(name.strip() for name in (chosen.axes or _AXES).split(",")))


def floor_settings(chosen: argparse.Namespace) -> FloorSettings:
    """Settings for the floor with the chosen tilt."""
    if chosen.max_tilt is None:
        return FloorSettings()
    if not 0 < chosen.max_tilt <= _UPRIGHT:
        raise InputError(f"--max-tilt is {chosen.max_tilt:g}; need more than 0, and at most {_UPRIGHT:g} degrees")
    return replace(FloorSettings(), max_tilt=float(np.deg2rad(chosen.max_tilt)))
