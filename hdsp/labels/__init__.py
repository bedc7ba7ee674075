"""Labels: tasks labelled by the detailed planner, their files, and the evaluation of abstractions.

- `rules`: labels of one map; `reasons`: why a task is infeasible
- `tasks`, `shards`: labelled tasks as arrays, and as files
- `counts`: counts of labels
- `published_tasks`: the authors' published labels
- `scan_patches`, `course_patches`: labelled patches of scans and of simulated courses; `scan_sets`: folders of scans
- `evaluation`: agreement between an abstraction and labels
- `run`: labels of a split, on one process or a cluster

Importing this package loads none of its modules; the first use of a name loads its module.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hdsp.labels.counts import LabelCounts
    from hdsp.labels.course_patches import CoursePatchSettings, PatchRun, ScannedCourse, simulated_courses
    from hdsp.labels.evaluation import evaluate_set, predict
    from hdsp.labels.published_tasks import export_tasks, find_published, import_tasks, read_published, write_published
    from hdsp.labels.reasons import LabelReason, label_reasons
    from hdsp.labels.rules import LabelSettings, MapTasks, label_map, label_unstandable
    from hdsp.labels.scan_patches import ScanPatchSettings, label_scan
    from hdsp.labels.scan_sets import ScanFolder, read_scan_folder
    from hdsp.labels.shards import Shard, is_shard, read_shard, read_shards, read_tasks, write_shard
    from hdsp.labels.tasks import REASON_UNKNOWN, TaskSet

__all__ = [
    "REASON_UNKNOWN",
    "CoursePatchSettings",
    "LabelCounts",
    "LabelReason",
    "LabelSettings",
    "MapTasks",
    "PatchRun",
    "ScanFolder",
    "ScanPatchSettings",
    "ScannedCourse",
    "Shard",
    "TaskSet",
    "evaluate_set",
    "export_tasks",
    "find_published",
    "import_tasks",
    "is_shard",
    "label_map",
    "label_reasons",
    "label_scan",
    "label_unstandable",
    "predict",
    "read_published",
    "read_scan_folder",
    "read_shard",
    "read_shards",
    "read_tasks",
    "simulated_courses",
    "write_published",
    "write_shard",
]

#: Module of each public name.
_MODULES = {
    "REASON_UNKNOWN": "tasks",
    "CoursePatchSettings": "course_patches",
    "LabelCounts": "counts",
    "LabelReason": "reasons",
    "LabelSettings": "rules",
    "MapTasks": "rules",
    "PatchRun": "course_patches",
    "ScanFolder": "scan_sets",
    "ScanPatchSettings": "scan_patches",
    "ScannedCourse": "course_patches",
    "Shard": "shards",
    "TaskSet": "tasks",
    "evaluate_set": "evaluation",
    "export_tasks": "published_tasks",
    "find_published": "published_tasks",
    "import_tasks": "published_tasks",
    "is_shard": "shards",
    "label_map": "rules",
    "label_reasons": "reasons",
    "label_scan": "scan_patches",
    "label_unstandable": "rules",
    "predict": "evaluation",
    "read_published": "published_tasks",
    "read_scan_folder": "scan_sets",
    "read_shard": "shards",
    "read_shards": "shards",
    "read_tasks": "shards",
    "simulated_courses": "course_patches",
    "write_published": "published_tasks",
    "write_shard": "shards",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
