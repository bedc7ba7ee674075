"""`python -m pipeline.scan_courses SPLIT`: labelled patches from scanned random courses, as training shards.

`simulation.splits` defines the splits. A shard holds one course's patches. Existing valid shards are kept, so an
interrupted run continues, and more courses add shards. Shards of other settings stay beside these.
"""

from __future__ import annotations

import json

from .config_types import Config
from .label import write_used
from .label_places import course_run, split_place
from .stage import Folders, run_stage


def scan_courses(config: Config, folders: Folders, split: str) -> None:
    from tqdm import tqdm

    from hdsp.base.workers import ClusterSettings
    from hdsp.labels.counts import counts_by_category
    from hdsp.labels.course_patches import simulated_courses, task_set
    from hdsp.labels.label_robots import ROBOT_HASH
    from hdsp.labels.run.label_store import LabelStore
    from hdsp.labels.shard_index import planned_shards
    from hdsp.labels.shards import shard_bytes

    run = course_run(config, split)
    digest, inputs = run.course_hash(), json.loads(json.dumps(run.inputs()))
    plans = planned_shards(run.patches.courses, 1)  # a course is one scanned map
    store = LabelStore(split_place(config, folders.outputs, split), digest, inputs, plans)
    missing = {plan.maps.start: plan for plan in store.missing(lambda line: print(f"{split}: {line}"))}
    runtime = config.runtime
    cluster = ClusterSettings(runtime.workers, dashboard=runtime.dashboard, memory=runtime.memory)
    patches = 0
    with tqdm(total=len(missing), desc=f"{split}: courses", disable=not runtime.progress) as bar:
        for course in simulated_courses(run, cluster, list(missing)):
            tasks, plan = task_set(run, [course]), missing[course.number]
            attributes: dict[str, str | int | float] = {
                "labels_hash": digest,
                ROBOT_HASH: run.robot.hash(),
                "first_map": course.number,
                "maps": 1,
            }
            store.shards.write(plan.name, shard_bytes(tasks, attributes, plan.name))
            store.add(plan, counts_by_category(tasks))
            patches += len(tasks)
            bar.set_postfix(patches=patches)
            bar.update()
    store.complete()
    write_used(folders, split, store.index)


if __name__ == "__main__":
    run_stage(scan_courses, "scan_courses", positional=["split"])
