"""Label runs: splits, shards, workers and progress.

- `split_run`: labels all maps of a split into shards, resumable
- `splits`: maps and shards of a split, and the hash of its labels
- `label_store`: shards and index of a label set, and which of them are valid
- `set_listing`: all label sets of a split, to be listed and removed
- `label_summary`: counts, shares and costs of a labelled split, and reasons for dropped maps
- `cluster`, `jobs`: the scheduling side and the worker side of a run on Dask; `progress`: its bar

Importing this package loads none of its modules, so a worker loads only its own side.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hdsp.labels.run.cluster import ClusterLabelling
    from hdsp.labels.run.label_store import LabelStore
    from hdsp.labels.run.label_summary import describe_labels
    from hdsp.labels.run.progress import TaskProgress
    from hdsp.labels.run.set_listing import StoredSet, stored_sets
    from hdsp.labels.run.split_run import LabelledSplit, label_split
    from hdsp.labels.run.splits import LabelRun, SplitSettings

__all__ = [
    "ClusterLabelling",
    "LabelRun",
    "LabelStore",
    "LabelledSplit",
    "SplitSettings",
    "StoredSet",
    "TaskProgress",
    "describe_labels",
    "label_split",
    "stored_sets",
]

#: Module of each public name.
_MODULES = {
    "ClusterLabelling": "cluster",
    "LabelRun": "splits",
    "LabelStore": "label_store",
    "LabelledSplit": "split_run",
    "SplitSettings": "splits",
    "StoredSet": "set_listing",
    "TaskProgress": "progress",
    "describe_labels": "label_summary",
    "label_split": "split_run",
    "stored_sets": "set_listing",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
