"""Command line of a stage: overrides, names that the stage needs, and Hydra's own flags."""

from __future__ import annotations

import errno
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from hdsp.base.ending import Ended, ended_by
from hdsp.base.errors import InputError
from hdsp.base.messages import one_line

from .config import CONFIG_NAME, Source, with_open_keys

#: This package's name: `pipeline` in a checkout, `hdsp_pipeline` where it is installed.
PACKAGE = Path(__file__).resolve().parent.name if __package__ in (None, "") else __package__
SWEEP = ("-m", "--multirun")
#: Hydra's flags with a value, and the field of `CommandLine` for those that this package reads itself.
_WITH_VALUE = {
    "--config-dir": "folder", "-cd": "folder", "--config-name": "name", "-cn": "name", "--cfg": "", "-c": "",
    "--package": "", "-p": "",
}  # fmt: skip
_PLAIN = ("--help", "-h", "--hydra-help", "--info", "-i", "--resolve", "--version")
#: Optional values of `--info`.
_INFO = ("all", "config", "defaults", "defaults-tree", "plugins", "searchpath")


#: Faults of a disk, which libraries report as they come.
_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EROFS)
#: Faults of a place that the user names: no rights, a file in place of a folder or the reverse, a name too long.
_PLACE = (
    errno.EACCES, errno.EPERM, errno.ENOTDIR, errno.EISDIR, errno.EEXIST, errno.ELOOP, errno.ENAMETOOLONG,
)  # fmt: skip


@contextmanager
def ends_in_one_line() -> Iterator[None]:
    """Ends the process with one line after bad input, a fault of a disk or database, or a signal (130, 143)."""
    try:
        with ended_by(signal.SIGINT, signal.SIGTERM):
            yield
    except InputError as error:
        sys.exit(f"error: {error}")
    except Ended as end:
        print(end, file=sys.stderr, flush=True)
        sys.exit(end.told())
    except Exception as error:
        if (words := _fault_of_disk(error)) is None:
            raise
        sys.exit(f"error: {words}")


def _fault_of_disk(error: BaseException | None) -> str | None:
    """The fault of a disk, place or database behind an error, in words; libraries wrap it in errors of their own."""
    is_own = True  # not an error that another one was handled for
    while error is not None:
        if is_own and isinstance(error, OSError) and error.errno in _PLACE and error.filename:
            return f"cannot use {error.filename}: {error.strerror}"
        if isinstance(error, OSError) and error.errno in _DISK:
            return f"cannot write {error.filename or 'a file'}: {error.strerror}"
        if "database or disk is full" in str(error):  # SQLite
            return "cannot write a database: database or disk is full"
        if type(error).__module__ == "sqlalchemy.exc" and (reason := getattr(error, "orig", None)) is not None:
            return f"cannot use a database: {one_line(reason)}"
        is_own = is_own and error.__cause__ is not None
        error = error.__cause__ or error.__context__
    return None


@dataclass(frozen=True)
class CommandLine:
    """A parsed command line.

    Attributes:
        arguments: names that the stage needs.
        overrides: Hydra overrides.
        source: place of the configuration.
        sweep: whether Hydra runs every combination of choices.
        flags: Hydra's flags that show something instead of a run.
    """

    arguments: tuple[str, ...]
    overrides: tuple[str, ...]
    source: Source
    sweep: bool
    flags: tuple[str, ...]

    @property
    def is_plain(self) -> bool:
        """Whether the command has neither overrides nor a configuration of its own."""
        return not self.overrides and self.source == Source()


def parse(words: Sequence[str], name: str, positional: Sequence[str] = ()) -> CommandLine:
    """Parses the words of a command.

    Args:
        words: the command line without its program.
        name: stage.
        positional: words that the stage needs, as they are named in its usage.

    Raises:
        InputError: a word is missing or unknown.
    """
    arguments, overrides, flags, own = [], [], [], {"folder": "", "name": ""}
    rest, sweep = list(words), False
    while rest:
        word = rest.pop(0)
        flag, assigned, value = word.partition("=") if word.startswith("--") else (word, "", "")
        if word in SWEEP:
            sweep = True
        elif flag in _WITH_VALUE:
            if not assigned and not rest:
                raise InputError(f"{flag} needs a value; {usage(name, positional)}")
            value = value if assigned else rest.pop(0)
            if field := _WITH_VALUE[flag]:
                own[field] = value
            else:
                flags += [flag, value]
        elif flag in _PLAIN:
            flags += [word, *([rest.pop(0)] if flag in ("--info", "-i") and rest and rest[0] in _INFO else [])]
        elif word.startswith("-"):
            raise InputError(f"unknown option {word}; {usage(name, positional)}")
        elif "=" in word or word[:1] in ("+", "~"):
            overrides.append(word)
        else:
            arguments.append(word)
    if not flags and len(arguments) != len(positional):
        raise InputError(f"cannot read {' '.join(arguments) or 'an empty command line'!r}; {usage(name, positional)}")
    source = Source(Path(own["folder"]) if own["folder"] else None, own["name"].removesuffix(".yaml") or CONFIG_NAME)
    return CommandLine(tuple(arguments), tuple(overrides), source, sweep, tuple(flags))


def usage(name: str, positional: Sequence[str] = ()) -> str:
    """Usage of a stage in one line."""
    words = " ".join([f"python -m {PACKAGE}.{name}", *(word.upper() for word in positional)])
    return f"usage: {words} [group=choice] [key=value] [--config-dir FOLDER] [--config-name NAME] [-m] [--help] ..."


def show(name: str, positional: Sequence[str], line: CommandLine) -> None:
    """Lets Hydra answer `--help`, `--cfg job`, `--info` and its other flags."""
    if {"--help", "-h"} & set(line.flags):
        print(usage(name, positional), end="\n\n")
    run_hydra(lambda config: None, name, line, line.flags)


def run_hydra(job, name: str, line: CommandLine, flags: Sequence[str] = ()) -> None:
    """Runs `job(config)` by Hydra's own main function, with the flags and overrides of a command line."""
    import hydra

    folder, more = line.source.primary()
    argv, sys.argv = sys.argv, [f"{name}.py", *flags, *more, *with_open_keys(line.overrides)]
    try:
        hydra.main(version_base=None, config_path=str(folder), config_name=line.source.name)(job)()
    finally:
        sys.argv = argv
