"""Stage `published`: the authors' labels as a test set; without them, a note with reason and remedy."""

from __future__ import annotations

from .config_types import Config
from .stage import Folders, run_stage, write_json
from .task_sets import ABSENT, remove_results

SHARD = "published.h5"


def published(config: Config, folders: Folders) -> None:
    from hdsp.labels.published_tasks import find_published, import_tasks

    folder = folders.write("data", "published")
    remove_results(folder, SHARD)
    source, reason = find_published(config.runtime.data_dir)
    if source is None:
        print(f"skipped: {reason}")
        write_json(folder / ABSENT, {"reason": reason})
        return
    tasks = import_tasks(source, folder / SHARD)
    print(f"{len(tasks)} maps, {tasks.feasible.size} tasks from {source.name}")


if __name__ == "__main__":
    run_stage(published, "published")
