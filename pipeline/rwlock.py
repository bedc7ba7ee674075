"""`python -m pipeline.rwlock`: before `dvc repro` in `make repro`; moves half of a lock file of DVC aside.

DVC notes in ``.dvc/tmp/rwlock`` which process reads and writes which files, and writes this note in place. A machine
that stops meanwhile leaves half of a note, with which every command of DVC ends in an error. Half of a note that names
a running process stays.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

PLACE = Path(".dvc", "tmp", "rwlock")


def mend(path: Path = PLACE) -> Path | None:
    """Moves a note that is no JSON to a name beside it, and returns this name; None if it stays, or there is none."""
    if _is_whole(path):
        return None
    from dvc.lock import make_lock

    # DVC holds this lock while it writes the note.
    with make_lock(str(path.with_name("rwlock.lock")), tmp_dir=str(path.parent)):
        if _is_whole(path) or _names_a_running_process(path):
            return None
        return path.replace(path.with_name("rwlock.damaged"))


def _is_whole(path: Path) -> bool:
    try:
        json.loads(path.read_bytes())
    except FileNotFoundError:
        return True
    except ValueError:
        return False
    return True


def _names_a_running_process(path: Path) -> bool:
    import psutil

    return any(psutil.pid_exists(int(pid)) for pid in re.findall(rb'"pid": *(\d{1,9})', path.read_bytes()))


if __name__ == "__main__":
    if (aside := mend()) is not None:
        print(f"{PLACE}: half of a note, from a run that was interrupted; it lies in {aside} now")
