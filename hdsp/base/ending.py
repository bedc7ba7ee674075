"""Signals that end a process: an exception in the main thread, so that files and workers are cleared away.

Library code, for example a compiler, may run for seconds without looking at signals. A process still there after
``LATEST`` ends at once, with the same line and exit status. Python's own end, which takes seconds with large
libraries, is left out, and child processes end with their parent.
"""

from __future__ import annotations

import atexit
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

#: Seconds from a signal to the end of the process at the latest.
LATEST = 1.5
#: The signal after whose line the process ends.
_TOLD: list[int] = []


class Ended(BaseException):
    """A signal asks the process to end.

    Libraries turn a ``KeyboardInterrupt`` into exit statuses of their own; this exception passes them.

    Attributes:
        number: the signal.
    """

    def __init__(self, number: int):
        super().__init__(words_of(number))
        self.number = number

    def told(self) -> int:
        """Returns the exit status, for a caller that has written the line for people and now leaves."""
        return leaving(self.number)


def words_of(number: int) -> str:
    """The line for people."""
    return "interrupted" if number == signal.SIGINT else "terminated"


def status_of(number: int) -> int:
    """Exit status after a signal by the convention of shells."""
    return 128 + number


def leaving(number: int) -> int:
    """Returns the exit status, and lets the process end without delay as soon as Python's end begins."""
    if not _TOLD:
        _TOLD.append(number)
        # Everything registered until now comes later in the order of `atexit`, and so is left out.
        atexit.register(_leave, number)
    return status_of(number)


def end_children(number: int = signal.SIGKILL) -> None:
    """Sends a signal to all processes below this one (Linux).

    The exception, `multiprocessing.resource_tracker`, clears away after others and ends by itself.
    """
    parents: dict[int, list[int]] = {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError, ValueError):
            # The name, in brackets, may hold anything.
            parent = int(entry.read_text(errors="replace").rpartition(")")[2].split()[1])
            parents.setdefault(parent, []).append(int(entry.parent.name))
    waiting = [os.getpid()]
    while waiting:
        for process in parents.get(waiting.pop(), []):
            waiting.append(process)
            with suppress(OSError):
                if b"resource_tracker" not in Path(f"/proc/{process}/cmdline").read_bytes():
                    os.kill(process, number)


def _leave(number: int) -> None:
    end_children()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(status_of(number))


@contextmanager
def ended_by(*numbers: int) -> Iterator[None]:
    """Raises ``Ended`` in the main thread when one of some signals arrives during a block.

    Ignored signals stay ignored. In other threads, which receive no signals, the block is as it is.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    former = {number: signal.getsignal(number) for number in numbers}
    heard = [number for number in numbers if former[number] is not signal.SIG_IGN]
    watch = _Watch(heard)
    try:
        for number in heard:
            signal.signal(number, watch.hear)
        yield
    except BaseException as error:
        # A library may have turned the exception into one of its own.
        if watch.heard and not isinstance(error, Ended):
            raise Ended(watch.heard) from None
        raise
    finally:
        for number in heard:
            signal.signal(number, former[number])
        watch.close()


class _Watch:
    """A thread that ends a process whose main thread does not get to its end after a signal."""

    def __init__(self, numbers: list[int]):
        self._numbers, self.heard = numbers, 0
        self._read, self._write = os.pipe()
        os.set_blocking(self._write, False)
        self._former = signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
        threading.Thread(target=self._wait, name="hdsp-ending", daemon=True).start()

    def hear(self, number: int, _frame: object) -> None:
        if self.heard:  # the end is on its way
            return
        self.heard = number
        raise Ended(number)

    def close(self) -> None:
        """Ends the watch, unless a signal came: then it watches until the process ends."""
        signal.set_wakeup_fd(self._former)
        os.close(self._write)

    def _wait(self) -> None:
        while data := os.read(self._read, 1):
            if data[0] in self._numbers:
                break
        os.close(self._read)
        if not data:
            return
        threading.Event().wait(LATEST)
        with suppress(OSError, ValueError):
            if not _TOLD:
                print(words_of(data[0]), file=sys.stderr, flush=True)
        _leave(data[0])
