"""Height map files in the command line: options for reading them, their contents in words, their conversion."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.messages import coordinates
from hdsp.planning.commands.command_parser import option_group
from hdsp.planning.commands.console import Console
from hdsp.planning.commands.json_documents import map_fields
from hdsp.robot.lattice import RESOLUTION
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.map_checks import suspicions
from hdsp.terrain.map_formats import MAP_SUFFIXES, MissingOption, map_contents

#: Formats of height maps, for help texts.
MAP_FILES = f"a height map ({', '.join(MAP_SUFFIXES)}, or the folder of a ROS 2 bag)"

_NUMBERS = {
    "scale": "metres per unit or grey step, e.g. 0.001 for millimetres",
    "offset": "m, height of its zero",
    "nodata": "value of unknown cells",
}
_NAMES = {
    "layer": "layer, band or entry with the heights",
    "topic": "bag: topic with the grid maps",
}
_READING = "reading a height map file"
_OPTIONS = ("resolution", "origin", *_NUMBERS, *_NAMES, "message")


def add_map_reading(parser: argparse.ArgumentParser) -> None:
    """Adds the options for reading height map files, except the cell size."""
    group = option_group(parser, _READING)
    group.add_argument(
        "--origin", nargs=2, type=float, metavar=("X", "Y"),
        help="array or image: m, lower corner of the first cell (default: 0 0)",
    )  # fmt: skip
    for name, meaning in _NUMBERS.items():
        group.add_argument(f"--{name}", type=float, metavar="VALUE", help=meaning)
    for name, meaning in _NAMES.items():
        group.add_argument(f"--{name}", metavar="NAME", help=meaning)
    group.add_argument("--message", type=int, metavar="N", help="bag: index of the message (default: the last)")


def map_options(chosen: argparse.Namespace) -> dict[str, Any]:
    """Keywords for `HeightMap.load` from the options that were given."""
    values = {name: getattr(chosen, name, None) for name in _OPTIONS}
    return {name: value for name, value in values.items() if value is not None}


def add_cell_size(parser: argparse.ArgumentParser) -> None:
    """Adds the cell size of files that have none."""
    option_group(parser, _READING).add_argument(
        "--resolution", type=float, metavar="M", help="array or image: m, side of a cell"
    )


#: Names in the namespace that are no options of a reader.
_COMMON = {"console", "json", "parser", "quiet", "run"}


def refuse_given(chosen: argparse.Namespace, parser: argparse.ArgumentParser, apply: tuple[str, ...], why: str) -> None:
    """Refuses options that were given but do not apply."""
    for name, value in vars(chosen).items():
        if name not in apply and name not in _COMMON and value != parser.get_default(name):
            flag = next((action.option_strings[0] for action in parser._actions if action.dest == name), name)
            hint = "; see --scale" if name == "units" and why.startswith("the height map") else ""
            raise InputError(f"option {flag} does not apply to {why}{hint}")


def convert_map(chosen: argparse.Namespace, parser: argparse.ArgumentParser) -> HeightMap:
    """Reads one height map file for ``hdsp map`` and writes it in the format of ``--out``."""
    if len(chosen.files) > 1:
        raise InputError(f"map: {len(chosen.files)} files; need one height map, or point clouds only")
    file = chosen.files[0]
    refuse_given(chosen, parser, ("files", "out", "picture", "condition", *_OPTIONS), f"the height map {file}")
    read = _read_map(file, chosen)
    terrain, done = conditioned(read, chosen)
    terrain.save(chosen.out)
    chosen.console.tell(f"{chosen.out}: {about_map(terrain)}{done}")
    tell_signs(read, chosen.console)
    return terrain


def conditioned(terrain: HeightMap, chosen: argparse.Namespace) -> tuple[HeightMap, str]:
    """The map as ``--condition`` asks, and a line on the conditioning with the break before it."""
    if not chosen.condition:
        return terrain, ""
    result, report = terrain.conditioned()
    return result, f"\nconditioned: {report}"


def _read_map(file: str, chosen: argparse.Namespace) -> HeightMap:
    """Map from a file; a cell size may be given although the file has it, or the conditioning makes it."""
    options = map_options(chosen)
    wanted = options.pop("resolution", None)
    if wanted is None:
        return HeightMap.load(file, **options)
    try:
        terrain = HeightMap.load(file, **options)
    except MissingOption:
        return HeightMap.load(file, resolution=wanted, **options)
    made = (terrain.resolution, RESOLUTION) if chosen.condition else (terrain.resolution,)
    if not any(math.isclose(wanted, side, rel_tol=1e-6) for side in made):
        raise InputError(
            f"height map {file}: option resolution does not apply: the file has its own resolution, "
            f"{terrain.resolution:g} m; --condition resamples to {RESOLUTION:g} m"
        )
    return terrain


def describe_map_file(path: Path, chosen: argparse.Namespace) -> dict[str, Any]:
    """Tells the parts of a height map file, the map in it, its frame, and signs of faults; returns them for JSON."""
    tell, contents = chosen.console.tell, map_contents(path)
    tell(contents)
    try:
        terrain = HeightMap.load(path, **map_options(chosen))
    except MissingOption as error:
        tell(f"no map yet: {error}")
        return {"contents": contents, "map": None, "missing": str(error)}
    tell(about_map(terrain))
    frame = terrain.frame
    parts = [f"frame {frame.name or 'not named'}", f"CRS {frame.crs or 'none'}"]
    if not frame.is_source:
        rows = "; ".join(
            " ".join([*(f"{value:.6g}" for value in row[:3]), coordinates(row[3:])]) for row in frame.to_source[:3]
        )
        parts.append(f"to the frame of the source by [{rows}]")
    tell(", ".join([*parts, "x, y and heights taken as metres"]))
    tell_signs(terrain, chosen.console)
    return {"contents": contents, "map": map_fields(terrain)}


def about_map(terrain: HeightMap) -> str:
    """Size, place, known share and map heights, in words."""
    known = terrain.heights[np.isfinite(terrain.heights)]
    (nx, ny), (length, width) = terrain.shape, terrain.size
    text = f"height map of {nx} x {ny} cells of {terrain.resolution:g} m, {length:.2f} x {width:.2f} m from "
    text += f"({terrain.origin[0]:.2f}, {terrain.origin[1]:.2f}), {known.size / terrain.heights.size:.0%} known"
    if known.size:
        text += f", heights {known.min():z.2f} to {known.max():z.2f} m (median {np.median(known):z.2f})"
    return text


def tell_signs(terrain: HeightMap, console: Console) -> None:
    """Tells the notes on a map, and signs of faults."""
    for note in terrain.frame.notes:
        console.tell(f"note: {note}")
    for sign in suspicions(terrain):
        console.tell(f"suspicious: {sign}")


def refuse_map_options(chosen: argparse.Namespace, apply: tuple[str, ...]) -> None:
    """Refuses options for height map files, because the files are point clouds."""
    for name in map_options(chosen):
        if name not in apply:
            raise InputError(f"option --{name} does not apply to point clouds")
