"""Faults at the n-th moment of a run's writes: before a file, after its contents, after it took its name."""

from __future__ import annotations

import errno
import json
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from hdsp.base import files

#: Kinds of faults.
KINDS = ("kill", "ENOSPC", "EIO")
#: Values that differ from run to run.
VOLATILE = ("seconds", "begun", "begun_at", "created", "time", "stamp")


@dataclass
class Writes:
    """Counts the moments of all writes; a fault happens at one of them.

    Attributes:
        at: number of the moment from 1; 0: no fault.
        kind: what happens then.
        count: moments so far.
    """

    at: int = 0
    kind: str = "kill"
    count: int = 0

    def moment(self) -> None:
        self.count += 1
        if self.count != self.at:
            return
        if self.kind == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        number = getattr(errno, self.kind)
        raise OSError(number, os.strerror(number))


@contextmanager
def counted(writes: Writes) -> Iterator[None]:
    """Counts the writes through ``hdsp.base.files.replacing`` during a block, in all modules that know it."""
    original = files.replacing

    @contextmanager
    def replacing(path: str | os.PathLike) -> Iterator[Path]:
        if writes.kind == "kill":
            writes.moment()
        with original(path) as temporary:
            yield temporary
            writes.moment()
        if writes.kind == "kill":
            writes.moment()

    known = [module for module in sys.modules.values() if getattr(module, "replacing", None) is original]
    for module in known:
        module.replacing = replacing
    try:
        yield
    finally:
        for module in known:
            module.replacing = original


def run_apart(stage: Callable[[], object], writes: Writes, heard: Path) -> tuple[int, int]:
    """Runs a stage in a copy of this process, with its output in a file.

    Returns:
        Exit status, negative for a signal, and the number of moments of writes.
    """
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        status = 1
        try:
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
            os.write(write, str(writes.count).encode())
            os._exit(status)
    os.close(write)
    with os.fdopen(read) as pipe:
        count = pipe.read()
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status), int(count or writes.at)


def contents(folder: Path) -> dict[str, object]:
    """Contents of all files in a folder by name, JSON without values that differ from run to run."""
    found: dict[str, object] = {}
    for path in sorted(folder.rglob("*")):
        # Records of a run: its times, and the folders in its command line.
        if path.is_file() and path.suffix != ".jsonl" and not {"seconds", ".hydra"} & set(path.parts):
            name = str(path.relative_to(folder))
            found[name] = _lasting(json.loads(path.read_text())) if path.suffix == ".json" else path.read_bytes()
    return found


def _lasting(value: object) -> object:
    if isinstance(value, dict):
        return {key: _lasting(own) for key, own in value.items() if key not in VOLATILE}
    return [_lasting(own) for own in value] if isinstance(value, list) else value
