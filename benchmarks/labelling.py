"""Label speed: one search for all goals on a map against one search per goal, and the time for a split.

    python -m benchmarks.labelling [--maps 100] [--seed 3] [--workers 2] [--skip-separate]

Maps come from the paper's nine categories in turn; maps without a valid start are left out. Both methods use the same
rules, cost limits, lower bounds, proofs and compiled world (`build_world`), whose time is listed separately:

- shared: `hdsp.abstract.oracle.task_costs`, all 22 goals at once;
- separate: the same function for each goal alone, with its own relaxed problem, lower bounds and search.

Each call starts without stored body checks. Times in this comparison are processor seconds. `ratio` is separate over
shared. `ratio_with_world` includes the compiled world: once per map for the shared method, once per task for the
separate method, which then amounts to 22 single-action labels made from the map.

A label run (`hdsp.labels.run.split_run`) on the same maps follows, including generation and shards, on one process and
on `--workers`. `minutes_for_249194_tasks` extrapolates to the paper's training set: equally many maps, including
dropped ones, and the process start. The last line is JSON.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np

from hdsp.abstract import oracle
from hdsp.abstract.flat_table import cost_limit
from hdsp.abstract.transform import feet_at
from hdsp.detailed.search.outcome import Status
from hdsp.detailed.world.world import build_world
from hdsp.labels.run.split_run import ClusterSettings, label_split
from hdsp.labels.run.splits import LabelRun
from hdsp.robot.lattice import ABSTRACT_ACTIONS
from pipeline.config import configure
from pipeline.label_places import label_run

#: Maps in the paper's training set before maps without a valid start are dropped; 249,194 tasks remain.
MAPS = 18_000


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--maps", type=int, default=100, help="number of maps with a valid start")
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--skip-separate", action="store_true", help="only the rates of label runs")
    arguments = parser.parse_args(argv)

    run = paper_run(arguments.seed, arguments.maps)
    result = {}
    if not arguments.skip_separate:
        result |= compare(run, arguments.maps)
    for workers in (1, arguments.workers):
        with tempfile.TemporaryDirectory() as folder:
            cluster = ClusterSettings(workers, dashboard=None)
            labelled = label_split(run, Path(folder) / "labels", cluster, progress=False)
        record = labelled.record
        labelling = record["seconds"] - record["start_seconds"]
        result[f"{workers} worker{'s' if workers > 1 else ''}"] = {
            "maps_before_dropping": run.split.maps,
            "maps": labelled.summary["maps"],
            "start_s": round(record["start_seconds"], 1),
            "labelling_s": round(labelling, 1),
            "tasks_per_s": round(labelled.summary["tasks"] / labelling, 1),
            "minutes_for_249194_tasks": round((record["start_seconds"] + labelling * MAPS / run.split.maps) / 60, 1),
            "peak_memory_of_a_worker_gb": round(record["peak_memory"] / 1e9, 3),
        }
    print(json.dumps(result))
    return result


def paper_run(seed: int, maps: int) -> LabelRun:
    """A split with the paper's settings and about ``maps`` or more maps with a valid start."""
    per_category = -(-2 * maps // 9)
    split = f"labelling.splits.random={{seed: {seed}, maps_per_category: {per_category}, maps_per_shard: 45}}"
    return label_run(configure(["profile=paper", split]), "random")


def compare(run: LabelRun, maps: int) -> dict:
    """Times both methods on the first ``maps`` maps with a valid start, and compares their labels."""
    seconds = {"world": 0.0, "shared": 0.0, "separate": 0.0}
    worst, different, compared, feasible = 0.0, 0, 0, 0
    undecided = {"shared": 0, "separate": 0}
    rules = run.settings, cost_limit(run.robot, run.settings)
    warmed = False
    for number in range(run.split.maps):
        if compared == maps:
            break
        terrain = run.terrain_of(number)
        began = time.process_time()
        world = build_world(terrain, run.robot)
        start = feet_at(world, (terrain.shape[0] // 2, terrain.shape[1] // 2, run.map_of(number)[2]))
        built = time.process_time() - began
        if start is None:
            continue
        if not warmed:  # compiles
            oracle.task_costs(world, start, *rules)
            separate_costs(world, start, *rules)
            warmed, built = True, 0.0
        seconds["world"] += built
        ways = {"shared": oracle.task_costs, "separate": separate_costs}
        # The order alternates, so that neither method always finds warm caches.
        found = {}
        for name in sorted(ways, reverse=bool(compared % 2)):
            began = time.process_time()
            found[name] = ways[name](_unvisited(world), start, *rules)
            seconds[name] += time.process_time() - began
        (_, cost, reason), (_, other_cost, other_reason) = found["shared"], found["separate"]
        solved, other_solved = reason == Status.SOLVED, other_reason == Status.SOLVED
        both = solved & other_solved
        different += int((solved != other_solved).sum())
        worst = max(worst, float(np.abs(cost[both] - other_cost[both]).max(initial=0.0)))
        feasible += int(solved.sum())
        for name, (_, _, reasons) in found.items():
            undecided[name] += int((reasons == Status.EXPANSION_LIMIT).sum())
        compared += 1
    return {
        "maps": compared,
        "tasks": 22 * compared,
        "feasible_share": round(feasible / (22 * max(compared, 1)), 4),
        "world_s": round(seconds["world"], 3),
        "shared_s": round(seconds["shared"], 3),
        "separate_s": round(seconds["separate"], 3),
        "ratio": round(seconds["separate"] / seconds["shared"], 2),
        "ratio_with_world": round(
            (seconds["separate"] + 22 * seconds["world"]) / (seconds["shared"] + seconds["world"]), 2
        ),
        "feasibility_differs": different,
        "ended_by_expansion_limit": undecided,  # the limit applies per search, so these tasks may differ
        "cost_difference_max": worst,
    }


def separate_costs(world, start: np.ndarray, settings, limit: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Like `oracle.task_costs`, with a separate call for each goal."""
    found = [oracle.task_costs(_unvisited(world), start, settings, limit, action[None]) for action in ABSTRACT_ACTIONS]
    goals, cost, reason = (np.concatenate(column) for column in zip(*found, strict=True))
    return goals, cost, reason


def _unvisited(world):
    """The world without stored body checks from earlier searches."""
    return world._replace(base=np.zeros_like(world.base), level_ground=np.zeros_like(world.level_ground))


if __name__ == "__main__":
    main()
