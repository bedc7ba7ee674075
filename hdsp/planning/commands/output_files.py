"""Outputs of commands: each at its own place, none in place of an input."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from hdsp.base.errors import InputError
from hdsp.learning.loading import presets as shipped_abstractions
from hdsp.robot.robot import Robot

#: Suffixes of the files in a folder of a bag or an abstraction.
_IN_FOLDERS = (".db3", ".mcap", ".yaml", ".json", ".safetensors")

#: A path without links, or a file's number.
_Name = str | tuple[int, int]


class OutputFile(NamedTuple):
    """A file or folder to write, and the option with its name."""

    option: str
    path: str


def outputs_of(chosen: argparse.Namespace, *names: str) -> list[OutputFile]:
    """Returns the outputs of those options, by name, that are given."""
    return [OutputFile(f"--{name}", path) for name in names if (path := getattr(chosen, name))]


def planning_inputs(chosen: argparse.Namespace) -> list[str]:
    """Returns the files and folders behind a plan; presets, hub repositories and other names are none."""
    kind, _, abstraction = chosen.heuristic.partition(":")
    paths = [chosen.map, getattr(chosen, "truth", None)]
    if chosen.robot not in Robot.presets():
        paths.append(chosen.robot)
    if kind == "learned" and abstraction not in shipped_abstractions():
        paths.append(abstraction)
    return [path for path in paths if path and os.path.exists(path)]


def refuse_overwriting(outputs: Iterable[OutputFile], inputs: Iterable[str | os.PathLike]) -> None:
    """Refuses outputs in place of an input or of each other, also under other names for one file.

    Args:
        outputs: all outputs.
        inputs: files and folders to read.

    Raises:
        InputError: an output is an input, or shares its place or folder with another output.
    """
    read = {name for path in inputs for file in _files_of(path) for name in _names(file)}
    taken: dict[_Name, OutputFile] = {}
    above: dict[_Name, OutputFile] = {}
    for output in outputs:
        names, folders = _names(output.path), _folders_above(output.path)
        told = f"{output.option} {output.path}:"
        if not read.isdisjoint(names):
            raise InputError(f"{told} the command reads this file; need another name")
        formers = [*(taken.get(name) for name in (*names, *folders)), *(above.get(name) for name in names)]
        if former := next(filter(None, formers), None):
            raise InputError(f"{told} {former.option} {former.path} is at the same place; need another name")
        taken |= dict.fromkeys(names, output)
        above |= dict.fromkeys(folders, output)


def _files_of(path: str | os.PathLike) -> list[str]:
    """A file itself; a folder with its inputs."""
    found = [os.fspath(path)]
    with suppress(OSError):
        found += [entry.path for entry in os.scandir(found[0]) if entry.name.lower().endswith(_IN_FOLDERS)]
    return found


def _names(path: str) -> set[_Name]:
    """The path without links, and an existing file's number, which all its hard links share."""
    names: set[_Name] = {os.path.realpath(path)}
    with suppress(OSError):
        found = os.stat(path)
        names.add((found.st_dev, found.st_ino))
    return names


def _folders_above(path: str) -> list[str]:
    """All folders above the path without links."""
    return [str(folder) for folder in Path(os.path.realpath(path)).parents]
