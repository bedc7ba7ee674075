"""Sets of labelled tasks, as the stages find them on disk."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hdsp.shards import TaskSet

#: Written by a stage that could not get its data: says why in `reason`.
ABSENT = "absent.json"


def read_set(folder: Path) -> tuple[TaskSet | None, str]:
    """The tasks of a folder of shards, or None and the reason why there are none.

    Raises:
        InputError: a shard is damaged.
    """
    from hdsp.shards import read_tasks

    if not folder.is_dir():
        return None, f"{folder} is not there yet"
    if (folder / ABSENT).is_file():
        return None, json.loads((folder / ABSENT).read_text(encoding="utf-8"))["reason"]
    return read_tasks(folder), ""
