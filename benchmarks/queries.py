"""First queries and updates in the paper's arena, where edges are evaluated as far as a query needs them.

    python -m benchmarks.queries

The last line is JSON. All times are processor seconds over all threads. `first_query_cpu_s` is the median over the
arena's goals, each with a new planner, at W = 1.25, without the compilation of the terrain; `share_evaluated` is the
median share of the states at which the robot can stand whose edges the query evaluated. `update_cpu_s` and
`manual_update_cpu_s` are medians over changes, learned and manual: a block of 30 cm appears beside the way, and the
last query follows again.
"""

import json
from statistics import median

import numpy as np

WEIGHT = 1.25
BLOCK, HEIGHT = 12, 0.1  # cells along a side, m
CHANGES = 5


def main() -> dict:
    result = measured()
    print(json.dumps({key: round(value, 4) for key, value in result.items()}))
    return result


def measured() -> dict:
    """Times and shares by their keys."""
    from hdsp.planning.planner import Planner
    from hdsp.terrain.arenas import read_arena
    from pipeline.config import configure

    arena = configure([]).arena
    terrain = read_arena(arena).height_map()
    tasks = [(task.start, task.goal) for task in arena.tasks]

    def planner(heuristic: str) -> Planner:
        return Planner(terrain, heuristic=heuristic, conditioning=None)

    planner("learned").plan(*tasks[-1], weight=WEIGHT)  # compiles
    seconds, shares = [], []
    for ends in tasks:
        new = planner("learned")
        seconds.append(cpu(lambda new=new, ends=ends: new.plan(*ends, weight=WEIGHT)))
        shares.append(new.heuristic.evaluated)
    return {
        "first_query_cpu_s": median(seconds),
        "share_evaluated": median(shares),
        "update_cpu_s": median(updates(planner("learned"), terrain, tasks[0])),
        "manual_update_cpu_s": median(updates(planner("manual"), terrain, tasks[0])),
    }


def updates(planner, terrain, ends) -> list[float]:
    """Processor seconds for each change of the map: one more block stands beside the way of the last plan."""
    from hdsp.terrain.height_map import HeightMap

    plan = planner.plan(*ends, weight=WEIGHT, polish=0.0)
    first = planner.grid.to_lattice(ends[0])[:2]
    way = planner.grid.cell(plan.states[:, :2])
    far = way[np.hypot(*(way - first).T) > 4 * BLOCK]
    places = far[np.linspace(0, len(far) - 4 * BLOCK, CHANGES + 1).astype(int)] + 2 * BLOCK
    heights, seconds = terrain.heights, []
    for x, y in places.tolist():
        heights = heights.copy()
        heights[x : x + BLOCK, y : y + BLOCK] += np.float32(HEIGHT)

        def changed(heights=heights):
            planner.update(HeightMap(heights, terrain.origin))
            planner.plan(*ends, weight=WEIGHT, polish=0.0)

        seconds.append(cpu(changed))
    return seconds[1:]  # the first change compiles


def cpu(compute) -> float:
    from benchmarks.edges import timed

    return timed(compute)[1]


if __name__ == "__main__":
    main()
