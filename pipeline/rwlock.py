"""`python -m pipeline.rwlock`: before `dvc repro` in `make repro`; moves half of a lock file of DVC aside.

DVC notes in ``.dvc/tmp/rwlock`` which process reads and writes which files, and writes this note in place. A machine
that stops meanwhile leaves half of a note, with which every command of DVC ends in an error. A half note locks nothing:
the process that wrote it has ended.
"""

from __future__ import annotations

import json
from pathlib import Path

PLACE = Path(".dvc", "tmp", "rwlock")


def mend(path: Path = PLACE) -> Path | None:
    """Moves a note that is no JSON to a name beside it, and returns this name; None if there is nothing to do."""
    if _is_whole(path):
        return None
    from dvc.lock import make_lock

    # DVC holds this lock while it writes the note.
    with make_lock(str(path.with_name("rwlock.lock")), tmp_dir=str(path.parent)):
        if _is_whole(path):
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


if __name__ == "__main__":
    if (aside := mend()) is not None:
        print(f"{PLACE}: half of a note, from a run that was interrupted; it lies in {aside} now")
