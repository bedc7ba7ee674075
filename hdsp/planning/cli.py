"""The command `hdsp`: maps from files, plans on them, and the contents of a file."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Sequence

from hdsp.base.errors import InputError, RefinementError
from hdsp.planning.commands.map_commands import add_info, add_map
from hdsp.planning.commands.plan_command import NO_PLAN, add_plan
from hdsp.planning.commands.warmup_command import add_warmup

__all__ = ["NO_PLAN", "main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line; returns the exit status. Bad input gives one line and status 1, no plan status 3."""
    chosen = _parser().parse_args(arguments)
    with warnings.catch_warnings():
        warnings.showwarning = _one_line
        try:
            return chosen.run(chosen) or 0
        except (InputError, RefinementError) as error:
            print(f"error: {error}", file=sys.stderr)
            return 1


def _one_line(message, category, filename, lineno, file=None, line=None) -> None:
    """Prints a warning as a line for users, without its place in the code."""
    print(f"warning: {message}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="hdsp", description="Hybrid driving-stepping planning.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for add in (add_map, add_plan, add_info, add_warmup):
        add(commands)
    return parser


if __name__ == "__main__":
    sys.exit(main())
