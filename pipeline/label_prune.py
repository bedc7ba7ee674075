"""`python -m pipeline.label --prune`: labels that the configuration does not use, listed and then removed.

A list of all label sets comes first. On a terminal, a question follows; elsewhere `--yes` removes them. Labels of
several configurations in one place are kept by `--keep`: `--keep 3fa9c2d41b7e`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hdsp.base.errors import InputError
from hdsp.base.storage import Place

from .config import configure, plain, read_params
from .config_types import Config
from .label_places import course_run, label_run, split_place
from .stage import Folders

if TYPE_CHECKING:
    from hdsp.labels.run.set_listing import StoredSet

#: Names of differing settings in a line of the list.
_SHOWN = 3


def main(argv: Sequence[str] | None = None) -> None:
    """Runs the command; overrides are those of the stage."""
    parser = argparse.ArgumentParser(prog="python -m pipeline.label", description=__doc__.splitlines()[0])
    parser.add_argument("--prune", action="store_true", required=True)
    parser.add_argument("--yes", action="store_true", help="remove without a question")
    parser.add_argument("--keep", action="append", default=[], metavar="SET", help="name of a label set that stays")
    parser.add_argument("overrides", nargs="*", metavar="key=value")
    arguments = parser.parse_args(argv)
    try:
        config = configure(arguments.overrides) if arguments.overrides else read_params()
        folders = Folders(Path(config.runtime.inputs), Path(config.runtime.outputs or "."))
        prune(config, folders, arguments.yes, arguments.keep)
    except InputError as error:
        sys.exit(f"error: {error}")


def prune(config: Config, folders: Folders, confirmed: bool = False, kept: Sequence[str] = ()) -> None:
    """Lists all label sets; removes those of other configurations after a confirmation."""
    from hdsp.labels.run.set_listing import stored_sets

    unused: list[StoredSet] = []
    leftovers: list[StoredSet] = []
    for split in (*config.labelling.splits, *config.simulation.splits):
        place = split_place(config, folders.outputs, split)
        sets = stored_sets(place)
        if not sets:
            continue
        mine, inputs = _used(config, split)
        for stored in sets:
            name = str(stored.place).rpartition("/")[2]
            is_used = mine.startswith(name) or name in kept
            print(f"{'keep  ' if is_used else 'remove'} {_line(place, name, stored, inputs)}")
            (leftovers if is_used else unused).append(stored)
    unfinished = [stored for stored in leftovers if stored.leftovers]
    for stored in unfinished:
        print(f"remove {len(stored.leftovers)} unfinished files of killed runs in {stored.place}")
    if not unused and not unfinished:
        print("nothing to remove")
    elif confirmed or _agreed(sum(stored.size for stored in unused)):
        for stored in unused:
            stored.remove()
        for stored in unfinished:
            stored.remove_leftovers()
        print(f"removed {len(unused)} label sets")


def _used(config: Config, split: str) -> tuple[str, Mapping[str, Any]]:
    """Hash and inputs of the labels that the configuration uses."""
    if split in config.simulation.splits:
        courses = course_run(config, split)
        return courses.course_hash(), courses.inputs()
    run = label_run(config, split)
    return run.labels_hash, run.inputs()


def _line(place: Place, name: str, stored: StoredSet, inputs: Mapping[str, Any]) -> str:
    maps = f"{max(stored.maps):,} maps" if stored.maps else "unfinished"
    differing = stored.differs_in(plain(inputs))
    more = f" and {len(differing) - _SHOWN} more" if len(differing) > _SHOWN else ""
    other = f"; other {', '.join(differing[:_SHOWN])}{more}" if differing else ""
    return f"{place}/{name}: {maps}, {stored.shards:,} shards, {stored.size / 1e6:,.1f} MB{other}"


def _agreed(size: int) -> bool:
    if not sys.stdin.isatty():
        print(f"nothing is removed yet: add --yes to remove {size / 1e6:,.1f} MB")
        return False
    return input(f"remove {size / 1e6:,.1f} MB? [y/N] ").strip().lower() in ("y", "yes")
