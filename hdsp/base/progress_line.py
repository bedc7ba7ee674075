"""One line about work that takes longer than a second: rewritten on a terminal, else a new line every few seconds."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from hdsp.base.gradual import now

_SILENT = 1.0  # s without a line on a terminal, so that quick work shows none
_ON_TERMINAL, _ELSEWHERE = 0.2, 3.0  # s between two lines
_CLEARED = "\r\x1b[K"


class ProgressLine:
    """Shows the present work and its seconds; a thread writes the line, so that the work needs no calls.

    Args:
        stream: where to write; None = standard error.
        quiet: whether no progress is shown.
    """

    def __init__(self, stream: TextIO | None = None, quiet: bool = False):
        self._stream, self.quiet = stream, quiet
        self._work = self._detail = ""
        self._began, self._drawn = 0.0, False
        self._lock = threading.Lock()

    @property
    def stream(self) -> TextIO:
        return sys.stderr if self._stream is None else self._stream

    @contextmanager
    def during(self, work: str) -> Iterator[None]:
        """Shows the name of the work during a block, from its first second on."""
        if self.quiet:
            yield
            return
        self._work, self._detail, self._began = work, "", now()
        over = threading.Event()
        thread = threading.Thread(target=self._write_until, args=(over,), name="hdsp-progress", daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()
            self.clear()

    def detail(self, text: str) -> None:
        """Adds to the line how far the work is, such as ``1,000 states expanded``."""
        self._detail = text

    def say(self, text: str) -> None:
        """Writes a line that stays."""
        with self._lock:
            self._clear()
            print(text, file=self.stream, flush=True)

    def clear(self) -> None:
        """Removes the line from a terminal."""
        with self._lock:
            self._clear()

    def _write_until(self, over: threading.Event) -> None:
        terminal = self.stream.isatty()
        wait = _SILENT if terminal else _ELSEWHERE
        while not over.wait(wait):
            wait = _ON_TERMINAL if terminal else _ELSEWHERE
            parts = filter(None, (self._detail, f"{now() - self._began:.0f} s"))
            text = f"{self._work}: {', '.join(parts)}"
            with self._lock:
                self._stream_line(text, terminal)

    def _stream_line(self, text: str, terminal: bool) -> None:
        if terminal:
            print(f"{_CLEARED}{text[:79]}", end="", file=self.stream, flush=True)
            self._drawn = True
        else:
            print(text, file=self.stream, flush=True)

    def _clear(self) -> None:
        if self._drawn:
            print(_CLEARED, end="", file=self.stream, flush=True)
            self._drawn = False
