"""Output of commands: results on standard output, as text or as one JSON document; the rest on standard error."""

from __future__ import annotations

import io
import json
import logging
import math
import os
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from hdsp.base.messages import one_line
from hdsp.base.progress_line import ProgressLine

#: Exit statuses of the command line; argparse ends with 2 on wrong usage.
BAD_INPUT, NO_PLAN, INTERRUPTED = 1, 3, 130


class Console:
    """Texts, JSON and progress of one command.

    Args:
        as_json: whether the result is one JSON document.
        quiet: whether progress is left out.
    """

    def __init__(self, as_json: bool = False, quiet: bool = False):
        self.as_json = as_json
        self.progress = ProgressLine(quiet=quiet)

    def tell(self, text: str) -> None:
        """Prints a line of the result; a JSON document has it in fields instead."""
        if not self.as_json:
            self.progress.clear()
            print(text)
            sys.stdout.flush()

    def document(self, fields: Mapping[str, Any]) -> None:
        """Prints the JSON document, if one was asked for."""
        if self.as_json:
            text = json.dumps(plain(fields), ensure_ascii=False, allow_nan=False)
            try:
                text.encode(sys.stdout.encoding or "utf-8")
            except UnicodeEncodeError:  # the escapes of a stream are none of JSON
                text = json.dumps(plain(fields), allow_nan=False)
            print(text)
            sys.stdout.flush()

    def warn(self, text: str) -> None:
        """Writes a line to standard error."""
        self.progress.say(text)

    def fail(self, error: object) -> None:
        """Reports bad input."""
        self.warn(f"error: {error}")
        self.document({"status": "error", "error": str(error)})

    @contextmanager
    def reporting(self) -> Iterator[None]:
        """Shows warnings and messages of the package as lines for users during a block."""
        handler = _Lines(self)
        log = logging.getLogger("hdsp")
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_, **__: self.warn(f"warning: {message}")
            log.addHandler(handler)
            try:
                yield
            finally:
                log.removeHandler(handler)


class _Lines(logging.Handler):
    """Shows messages as lines; those on compilation are progress."""

    def __init__(self, console: Console):
        super().__init__(logging.WARNING)
        self._console = console

    def emit(self, record: logging.LogRecord) -> None:
        if record.name != "hdsp" or not self._console.progress.quiet:
            self._console.warn(record.getMessage())


def plain(value: Any) -> Any:
    """Returns a value for JSON: lists for arrays, null for numbers that are not finite, names for enumerations."""
    if isinstance(value, Mapping):
        return {str(key): plain(own) for key, own in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(own) for own in value]
    if isinstance(value, Enum | Path):
        return str(value)
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def escape_unknown_letters() -> None:
    """Lets standard output and standard error escape letters that they cannot show, as in names of files."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def drop_output() -> None:
    """Keeps Python from writing to a full disk, or to a reader that has gone as in ``hdsp info FILE | head -1``."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def about_system_error(error: OSError) -> str:
    """Returns the words for users on an error of the operating system: the file and the reason."""
    names = [str(name) for name in (error.filename, error.filename2) if name is not None]
    return one_line(": ".join(filter(None, (", ".join(names), error.strerror))) or error)
