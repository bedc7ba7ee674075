"""Decision of tasks on random maps, and time per map.

    python -m benchmarks.labels_decided [--maps 200] [--seed 3] [--robot momaro] [--categories all]

The benchmark labels random maps and prints one JSON line last. The maps come in turn from the paper's nine categories
and from the categories with slopes; ``--categories paper`` or ``slopes`` takes one group alone. The line holds the
shares of tasks solved, with an invalid goal, proved infeasible, proved above the cost limit, and undecided at a search
limit (`capped_share`); the most expansions in a search; milliseconds per map, with and without maps dropped for lack of
a valid start; and tasks per second on one core.
"""

import argparse
import json
import time
from collections import Counter

from hdsp.abstract import oracle
from hdsp.detailed.search.outcome import Status
from hdsp.labels.rules import LabelSettings, label_map
from hdsp.robot.robot import Robot
from hdsp.terrain.scenes import CATEGORIES, SLOPE_CATEGORIES, TerrainSettings, random_map

_GROUPS = {"paper": CATEGORIES, "slopes": SLOPE_CATEGORIES, "all": CATEGORIES + SLOPE_CATEGORIES}
_CAPS = Status.EXPANSION_LIMIT, Status.MEMORY_LIMIT, Status.TIME_LIMIT


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--maps", type=int, default=200)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--robot", default="momaro", help="preset or YAML file")
    parser.add_argument("--categories", choices=tuple(_GROUPS), default="all")
    arguments = parser.parse_args(argv)
    categories = _GROUPS[arguments.categories]
    robot, settings, terrain = Robot.load(arguments.robot), LabelSettings(), TerrainSettings()
    expansions = count_expansions()
    reasons: Counter = Counter()
    kept, seconds = 0, 0.0
    for number in range(-len(categories), arguments.maps):  # the first maps only compile kernels
        index, category = divmod(max(number, 0), len(categories))
        category = categories[category if number >= 0 else number]
        heights = random_map(arguments.seed, category, index, terrain)
        began = time.perf_counter()
        labels = label_map(heights, robot, settings)
        if number < 0:
            continue
        seconds += time.perf_counter() - began
        if labels is not None:
            kept += 1
            reasons.update(Status(int(reason)) for reason in labels.reason)
    total = sum(reasons.values())
    result = {
        "categories": len(categories),
        "maps": arguments.maps,
        "maps_kept": kept,
        "tasks": total,
        "share_per_reason": {str(status): round(count / total, 4) for status, count in sorted(reasons.items())},
        "capped_share": sum(reasons[status] for status in _CAPS) / total,
        "most_expansions": max(expansions, default=0),
        "ms_per_map": round(1000 * seconds / arguments.maps, 1),
        "ms_per_map_kept": round(1000 * seconds / kept, 1),
        "tasks_per_s": round(total / seconds, 1),
    }
    print(json.dumps(result))
    return result


def count_expansions() -> list[int]:
    """Returns a list to which every later oracle search appends its expansions."""
    found: list[int] = []
    solve = oracle.solve

    def counted(*arguments, **options):
        result = solve(*arguments, **options)
        found.append(result.expansions)
        return result

    oracle.solve = counted
    return found


if __name__ == "__main__":
    main()
