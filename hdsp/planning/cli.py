"""The command `hdsp`: maps from files, plans on them, and a file's contents."""

from __future__ import annotations

import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import metadata

from hdsp.base.ending import Ended, ended_by
from hdsp.base.errors import InputError, RefinementError
from hdsp.planning.commands.command_parser import CommandParser
from hdsp.planning.commands.completion_command import add_completion
from hdsp.planning.commands.console import (
    BAD_INPUT,
    INTERRUPTED,
    NO_PLAN,
    Console,
    about_system_error,
    drop_output,
    escape_unknown_letters,
)
from hdsp.planning.commands.drive_command import add_drive
from hdsp.planning.commands.info_command import add_info
from hdsp.planning.commands.lab_command import add_lab
from hdsp.planning.commands.map_commands import add_map
from hdsp.planning.commands.plan_command import add_plan
from hdsp.planning.commands.view_command import add_demo, add_view
from hdsp.planning.commands.warmup_command import add_warmup

__all__ = ["NO_PLAN", "command_parser", "main"]

_EXAMPLES = """examples:
  hdsp map room.las --out room.npz --picture room.png
  hdsp plan room.npz --start 1 2 0 --goal 4 3 90 --picture plan.png
  hdsp info room.npz

exit status: 0 done, 1 bad input, 2 wrong usage, 3 no plan, 4 drive failed,
130 interrupted, 143 terminated"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line; returns the exit status.

    Bad input gives one line and status 1, wrong usage status 2, no plan status 3, an interrupt status 130, SIGTERM
    status 143.
    """
    escape_unknown_letters()
    try:
        try:
            return _run(arguments)
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        pass
    except OSError as error:  # of standard output itself
        with suppress(OSError):
            print(f"error: standard output: {about_system_error(error)}", file=sys.stderr)
    drop_output()
    return BAD_INPUT


def _run(arguments: Sequence[str] | None) -> int:
    """Runs the command line without a look at the reader of its output."""
    parser = command_parser()
    chosen, unknown = parser.parse_known_args(arguments)
    if unknown:
        chosen.parser.refuse_unknown(unknown)
    chosen.console = console = Console(getattr(chosen, "json", False), chosen.quiet)
    with console.reporting():
        try:
            with ended_by(signal.SIGTERM):
                return chosen.run(chosen) or 0
        except (InputError, RefinementError) as error:
            console.fail(error)
        except MemoryError:
            console.fail("there is not enough memory")
        except KeyboardInterrupt:
            console.warn("interrupted")
            return INTERRUPTED
        except Ended as end:
            console.warn(str(end))
            return end.told()
        except BrokenPipeError:
            raise
        except OSError as error:
            console.fail(about_system_error(error))
    return BAD_INPUT


def command_parser() -> CommandParser:
    """Returns the parser with all commands."""
    parser = CommandParser(prog="hdsp", description="Hybrid driving-stepping planning.", epilog=_EXAMPLES)
    parser.add_argument("--version", action="version", version=f"hdsp {version()}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for add in (add_map, add_plan, add_drive, add_view, add_demo, add_info, add_lab, add_warmup):
        add(commands)
    add_completion(commands, parser)
    for command in commands.choices.values():
        command.add_argument("--quiet", action="store_true", help="show no progress")
        command.set_defaults(parser=command)
    return parser


def version() -> str:
    """Returns the version of the installed package."""
    try:
        return metadata.version("hdsp")
    except metadata.PackageNotFoundError:  # run from a source folder
        return "unknown: not installed"


if __name__ == "__main__":
    sys.exit(main())
