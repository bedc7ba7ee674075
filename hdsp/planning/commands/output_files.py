"""Outputs of commands: each at its own place, none in place of an input."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import NamedTuple

from hdsp.base.errors import InputError

#: Suffixes of the files in a folder of a bag or an abstraction.
_IN_FOLDERS = (".db3", ".mcap", ".yaml", ".json", ".safetensors")


class OutputFile(NamedTuple):
    """A file or folder to write, and the option with its name."""

    option: str
    path: str


def outputs_of(chosen: argparse.Namespace, *names: str) -> list[OutputFile]:
    """Returns the outputs of those options, by name, that are given."""
    return [OutputFile(f"--{name}", path) for name in names if (path := getattr(chosen, name))]


def planning_inputs(chosen: argparse.Namespace) -> list[str]:
    """Returns the files and folders behind a plan."""
    folder = chosen.heuristic.partition(":")[2]
    return [path for path in (chosen.map, chosen.robot, folder, getattr(chosen, "truth", None)) if path]


def refuse_overwriting(outputs: Sequence[OutputFile], inputs: Iterable[str | os.PathLike]) -> None:
    """Refuses outputs in place of an input or of each other, also under other names for one file.

    Args:
        outputs: all outputs.
        inputs: files and folders to read; preset names do not matter.

    Raises:
        InputError: an output is an input, or shares its place or folder with another output.
    """
    read = {name for path in inputs for file in _files_of(path) for name in _names(file)}
    for number, (option, path) in enumerate(outputs):
        if not read.isdisjoint(_names(path)):
            raise InputError(f"{option} {path}: the command reads this file; need another name")
        for former in outputs[:number]:
            if not _apart(path, former.path):
                there = f"{former.option} {former.path} is at the same place"
                raise InputError(f"{option} {path}: {there}; need another name")


def _files_of(path: str | os.PathLike) -> list[str]:
    """A file itself; a folder with its inputs."""
    found = [os.fspath(path)]
    with suppress(OSError):
        found += [entry.path for entry in os.scandir(found[0]) if entry.name.lower().endswith(_IN_FOLDERS)]
    return found


def _names(path: str) -> set[str | tuple[int, int]]:
    """The path without links, and an existing file's number, which all its hard links share."""
    names: set[str | tuple[int, int]] = {os.path.realpath(path)}
    with suppress(OSError):
        found = os.stat(path)
        names.add((found.st_dev, found.st_ino))
    return names


def _apart(one: str, other: str) -> bool:
    """Whether two outputs are different files, and none lies in the other's future folder."""
    places = [os.path.realpath(path) for path in (one, other)]
    return _names(one).isdisjoint(_names(other)) and os.path.commonpath(places) not in places
