"""Faults at the n-th moment of a run's writes: a file is opened, synced or renamed, a database commits.

Python tells of each change of a file by an audit event, also in libraries. The state before the first moment is
"before a file"; between a file's opening and its next moment lie its contents; behind its renaming is the next moment.
"""

from __future__ import annotations

import errno
import json
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

#: Kinds of faults: the process is killed; killed with a half of the contents of its last file; the disk is full, or
#: fails.
KINDS = ("kill", "torn", "ENOSPC", "EIO")
#: Audit events that change files, and the place of a folder's descriptor among their arguments.
_CHANGES = {"os.rename": 2, "os.remove": 1, "os.mkdir": 2, "os.rmdir": 1, "os.link": 2, "os.symlink": None}
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND


@dataclass
class Writes:
    """Counts the moments of all writes to a folder; a fault happens at one of them.

    Attributes:
        folder: files elsewhere do not count.
        at: number of the moment from 1; 0: no fault.
        kind: what happens then.
        events: name of each moment so far.
    """

    folder: Path
    at: int = 0
    kind: str = "kill"
    events: list[str] = field(default_factory=list)
    _last: str = ""

    def moment(self, event: str, path: str = "") -> None:
        self.events.append(event)
        if len(self.events) == self.at:
            if self.kind in ("kill", "torn"):
                if self.kind == "torn" and os.path.isfile(self._last):
                    os.truncate(self._last, os.path.getsize(self._last) // 2)
                os.kill(os.getpid(), signal.SIGKILL)
            number = getattr(errno, self.kind)
            raise OSError(number, os.strerror(number), path or None)
        if event == "open":
            self._last = path

    def numbers(self, kind: str) -> list[int]:
        """The moments at which a kind of fault may happen, after a run without faults."""
        if kind == "kill":
            return list(range(1, len(self.events) + 1))
        if kind == "torn":
            return [n + 2 for n, event in enumerate(self.events[:-1]) if event == "open"]
        return [n + 1 for n, event in enumerate(self.events) if event not in ("os.remove", "os.rmdir", "end")]

    def hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        """Counts an audit event that changes a file of the folder."""
        if event == "open":
            path, flags = arguments[0], arguments[2]
            at = None if not isinstance(flags, int) or not flags & _WRITING else self._inside(path, -1)
        elif event in _CHANGES:
            place = _CHANGES[event]
            at = self._inside(arguments[0], -1 if place is None else arguments[place])
        else:
            return
        if at is not None:
            self.moment(event, at)

    def _inside(self, path: Any, folder: int) -> str | None:
        if not isinstance(path, str | bytes | os.PathLike):
            return None
        name = os.fsdecode(path)
        if folder not in (-1, None) and not os.path.isabs(name):
            name = os.path.join(os.readlink(f"/proc/self/fd/{folder}"), name)
        name = os.path.abspath(name)
        return name if f"{name}{os.sep}".startswith(f"{self.folder}{os.sep}") else None


_counting: list[Writes] = []
_hooked: list[bool] = []


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    if _counting and (event == "open" or event in _CHANGES):
        _counting[-1].hear(event, arguments)


@contextmanager
def counted(writes: Writes) -> Iterator[None]:
    """Counts the writes of this process during a block."""
    if not _hooked:  # a fork inherits the hook
        sys.addaudithook(_hook)
        _hooked.append(True)
    sync = os.fsync

    def synced(descriptor: int) -> None:
        if writes._inside(os.readlink(f"/proc/self/fd/{descriptor}"), -1):
            writes.moment("fsync")
        sync(descriptor)

    os.fsync = synced
    _counting.append(writes)
    try:
        with _commits(writes):
            yield
            writes.moment("end")
    finally:
        _counting.pop()
        os.fsync = sync


@contextmanager
def _commits(writes: Writes) -> Iterator[None]:
    """Counts the commits of databases; SQLite itself writes their files."""
    if "sqlalchemy" not in sys.modules:
        yield
        return
    from sqlalchemy import event
    from sqlalchemy.engine import Engine
    from sqlalchemy.exc import OperationalError

    def commit(_connection: Any) -> None:
        try:
            writes.moment("commit")
        except OSError as error:
            raise OperationalError("COMMIT", None, Exception("database or disk is full")) from error

    event.listen(Engine, "commit", commit)
    try:
        yield
    finally:
        event.remove(Engine, "commit", commit)


def run_apart(stage: Callable[[], object], writes: Writes, heard: Path) -> int:
    """Runs a stage in a copy of this process, with its output in a file; ``writes`` gets its events.

    Returns:
        Exit status, negative for a signal.
    """
    return begun_apart(stage, writes, heard)()


def begun_apart(stage: Callable[[], object], writes: Writes, heard: Path) -> Callable[[], int]:
    """Begins as ``run_apart``; the returned function waits for the end."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        status = 1
        try:
            os.close(read)
            output = os.open(heard, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(output, 1)
            os.dup2(output, 2)
            sys.stdout = sys.stderr = os.fdopen(output, "w", buffering=1)
            with counted(writes):
                stage()
            status = 0
        except SystemExit as end:
            print(end.code if isinstance(end.code, str) else "", file=sys.stderr)
            status = end.code if isinstance(end.code, int) else 1
        except BaseException as error:
            print(f"{type(error).__name__}: {error}", file=sys.stderr)
        finally:
            sys.stderr.flush()
            os.write(write, json.dumps(writes.events).encode())
            os._exit(status)
    os.close(write)

    def wait() -> int:
        with os.fdopen(read) as pipe:
            writes.events[:] = json.loads(pipe.read() or "[]")
        _, status = os.waitpid(child, 0)
        return os.waitstatus_to_exitcode(status)

    return wait
