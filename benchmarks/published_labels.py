"""Our labels against the authors' published labels, task by task.

    python -m benchmarks.published_labels FILE [--robot momaro] [--expansions 100000] [--tasks MAP ...]

FILE has the authors' text format, complete or in part. The benchmark prints one line per map, then one JSON line:
feasibility agreement and mean absolute cost error (over tasks that both judge feasible) on all maps and on flat,
driving and stairs maps, the largest error on flat maps, the share of tasks per search status, and seconds.

Map numbers in the authors' file decide the terrain kind, flat, driving or stairs (``hdsp.labels.published_tasks``).
"""

import argparse
import json
import time
from collections import Counter

import numpy as np

from hdsp.detailed.search.outcome import Status
from hdsp.labels.published_tasks import read_published, terrain_kind
from hdsp.labels.rules import LabelSettings, label_map
from hdsp.robot.lattice import ABSTRACT_ACTIONS
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file")
    parser.add_argument("--robot", default="momaro", help="preset or YAML file")
    parser.add_argument("--expansions", type=int, default=LabelSettings.max_expansions, help="limit of each search")
    parser.add_argument("--tasks", type=int, nargs="*", metavar="MAP", help="evaluate these maps only; print tasks")
    arguments = parser.parse_args(argv)
    robot = Robot.load(arguments.robot)
    settings = LabelSettings(max_expansions=arguments.expansions)
    published = read_published(arguments.file)
    scores: dict[str, list] = {}
    reasons: Counter = Counter()
    seconds = 0.0
    for i in range(len(published.index)):
        number = int(published.index[i])
        if arguments.tasks and number not in arguments.tasks:
            continue
        terrain = HeightMap(published.heights[i])
        began = time.perf_counter()
        ours = label_map(terrain, robot, settings)
        seconds += time.perf_counter() - began
        feasible = np.zeros(22, bool) if ours is None else ours.feasible
        cost = np.zeros(22) if ours is None else ours.cost
        reason = np.full(22, Status.INVALID_START) if ours is None else ours.reason
        both = feasible & published.feasible[i]
        agree = feasible == published.feasible[i]
        error = abs(cost - published.cost[i])[both]
        kind = terrain_kind(number)
        scores.setdefault(kind, []).append((agree, error))
        reasons.update(str(Status(int(r))) for r in reason)
        print(f"map {number:2d} {kind:8s} agreement {agree.sum():2d}/22, cost error {mean(error):.5f}")
        if arguments.tasks:
            print_tasks(published.feasible[i], published.cost[i], feasible, cost, reason)
    result = summary(scores)
    total = sum(reasons.values())
    result["ended"] = {name: round(count / total, 4) for name, count in sorted(reasons.items())}
    result["seconds"] = round(seconds, 2)
    print(json.dumps(result))
    return result


def summary(scores: dict[str, list]) -> dict:
    everything = [pair for pairs in scores.values() for pair in pairs]
    result = score(everything)
    for kind in ("flat", "driving", "stairs"):
        result[kind] = score(scores.get(kind, []))
    flat_errors = [float(error.max()) for _, error in scores.get("flat", []) if len(error)]
    result["flat"]["cost_error_max"] = max(flat_errors, default=None)
    return result


def score(pairs: list) -> dict:
    if not pairs:
        return {"maps": 0, "feasibility_agreement": None, "cost_mae": None}
    return {
        "maps": len(pairs),
        "feasibility_agreement": round(float(np.concatenate([agree for agree, _ in pairs]).mean()), 5),
        "cost_mae": round(mean(np.concatenate([error for _, error in pairs])), 6),
    }


def mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else 0.0


def print_tasks(published_feasible, published_cost, feasible, cost, reason) -> None:
    for action, pf, pc, f, c, r in zip(
        ABSTRACT_ACTIONS, published_feasible, published_cost, feasible, cost, reason, strict=True
    ):
        theirs, our = (f"{pc:.6f}" if pf else "inf"), (f"{c:.6f}" if f else "inf")
        print(f"   {action!s:12s} published {theirs:>9s}  ours {our:>9s}  {Status(int(r))}")


if __name__ == "__main__":
    main()
