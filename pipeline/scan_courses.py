"""`python -m pipeline.scan_courses SPLIT`: labelled patches from scanned random courses, as training shards.

`simulation.splits` defines the splits. A shard holds one course's patches. Existing valid shards are kept, so an
interrupted run continues, and more courses add shards.
"""

from __future__ import annotations

from pathlib import Path

from hdsp.base.errors import InputError
from pipeline.config_types import Config
from pipeline.stage import Folders, run_stage


def scan_courses(config: Config, folders: Folders, split: str) -> None:
    from tqdm import tqdm

    from hdsp.base.workers import ClusterSettings
    from hdsp.labels.course_patches import PatchRun, simulated_courses, task_set
    from hdsp.labels.shards import SUFFIX, write_shard

    splits = config.simulation.splits
    if split not in splits:
        raise InputError(f"unknown split {split!r}; simulation.splits has {', '.join(splits) or 'none'}")
    run = PatchRun(
        splits[split],
        config.simulation.courses,
        config.simulation.lidar,
        config.robot,
        config.labelling.settings,
    )
    digest = run.course_hash()
    paths = {
        index: folders.write("data", "labels", split, f"{index:05d}-{digest[:12]}{SUFFIX}")
        for index in range(run.patches.courses)
    }
    _remove_others(set(paths.values()))
    missing = [index for index, path in paths.items() if not _is_valid(path, digest)]
    runtime = config.runtime
    cluster = ClusterSettings(runtime.workers, dashboard=runtime.dashboard, memory=runtime.memory)
    maps = 0
    with tqdm(total=len(missing), desc=f"{split}: courses", disable=not runtime.progress) as bar:
        for course in simulated_courses(run, cluster, missing):
            tasks = task_set(run, [course])
            write_shard(paths[course.number], tasks, {"labels_hash": digest, "maps": len(tasks)})
            maps += len(tasks)
            bar.set_postfix(patches=maps)
            bar.update()


def _is_valid(path: Path, digest: str) -> bool:
    from hdsp.labels.shards import read_shard

    try:
        return read_shard(path).attributes.get("labels_hash") == digest
    except InputError:
        return False


def _remove_others(wanted: set[Path]) -> None:
    """Removes shards for courses outside the split or with another hash; other files stay."""
    from hdsp.labels.run.splits import SHARD_NAME

    for path in next(iter(wanted)).parent.iterdir():
        if SHARD_NAME.fullmatch(path.name) and path not in wanted:
            print(f"removed {path}: not of these courses, or made with other code or settings")
            path.unlink()


if __name__ == "__main__":
    run_stage(scan_courses, "scan_courses", positional=["split"])
