"""Grid heuristic against the geometric one at W = 1, on the tasks of the paper's arena.

    python -m benchmarks.grid_heuristic [--limit 2000000] [--grid-limit 2000000] [--iii-limit 50000000]
                                        [--scan data/arena/scanned.npz] [--tasks I VI] [--polish 2] [--json FILE]

The arena is that of the stage `plan`, with its margin: as scanned if `--scan` exists, else with its true heights. For
each task and heuristic: status, cost, expansions, base poses that the backward search settled, and processor seconds
for the heuristic of the goal and the search together. Preparation for the whole map (foothold regions) comes before.
A geometric search that ends at its limit counts with this limit, so that ratios grid / geometric are upper bounds. A
task whose grid search ends at a limit has no ratio.

The last line is JSON:

- `vi_expansions`, `vi_cost`: grid on task VI; None without a plan;
- `others_expansions`, `others_cpu`, `others_with_settled`: geometric means of grid / geometric over the tasks beside
  III and VI, for expansions, processor time, and expansions plus settled poses; `others` counts these tasks,
  `others_capped` the limits among their geometric searches;
- `iii_expansions`, `iii_cost`: grid on task III; without a plan, the cost is None;
- `iii_bound`: cost of a plan for task III (manual, W = 1.25, polished) over the lower bound from the grid search.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from pathlib import Path

import numpy as np
import yaml

from benchmarks.planning.arena import PAPER, PLANNER, SCANNED
from hdsp.detailed.search import kernel
from hdsp.detailed.search.backward import SETTLED
from hdsp.detailed.search.bounds import rounding
from hdsp.detailed.search.life_cycle import Search
from hdsp.detailed.search.outcome import Limits, Status
from hdsp.detailed.search.weighted_astar import solve
from hdsp.planning.planner import Planner
from hdsp.terrain.arenas import read_arena
from hdsp.terrain.height_map import HeightMap

WALLED, STEPPED = "VI", "III"  # tasks with a bar of their own


def main(argv: list[str] | None = None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--limit", type=int, default=2_000_000, help="expansions of a geometric search, at most")
    parser.add_argument("--grid-limit", type=int, default=2_000_000, help="expansions of a grid search, at most")
    parser.add_argument("--iii-limit", type=int, default=50_000_000, help="the same on task III")
    parser.add_argument("--scan", type=Path, default=SCANNED, help="the arena as scanned")
    parser.add_argument("--tasks", nargs="+", help="names of tasks; default: all")
    parser.add_argument("--polish", type=float, default=2.0, help="budget of the polish on task III, s")
    parser.add_argument("--json", type=Path, help="output file for the result with all searches")
    arguments = parser.parse_args(argv)

    scanned = arguments.scan.exists()
    description = yaml.safe_load(PAPER.read_text())
    terrain = HeightMap.load(arguments.scan) if scanned else read_arena(description).height_map()
    margin = yaml.safe_load(PLANNER.read_text())["margin"]
    planners = {name: Planner(terrain, "momaro", name, margin, conditioning=None) for name in ("geometric", "grid")}
    tasks = {task["name"]: (task["start"], task["goal"]) for task in description["tasks"]}
    chosen = arguments.tasks or list(tasks)
    runs = []
    for task in chosen:
        start, goal = tasks[task]
        of_grid = arguments.iii_limit if task == STEPPED else arguments.grid_limit
        for name, limit in (("geometric", arguments.limit), ("grid", of_grid)):
            run = {"task": task, "heuristic": name, **optimal_search(planners[name], start, goal, limit)}
            runs.append(run)
            print(in_words(run), flush=True)
    plan = None
    if STEPPED in chosen:
        guide = Planner(terrain, "momaro", "manual", margin, conditioning=None)
        plan = guide.plan(*tasks[STEPPED], 1.25, polish=arguments.polish)
        print(f"{STEPPED}, manual, W = 1.25, polished: {plan.status}, cost {plan.cost:.4f}", flush=True)
    result = {
        "arena": "as scanned" if scanned else "true heights",
        "limit": arguments.limit,
        "iii_limit": arguments.iii_limit,
        **summary(runs, None if plan is None or not plan.solved else plan.cost),
    }
    if arguments.json:
        arguments.json.write_text(json.dumps({**result, "runs": runs}, indent=1) + "\n")
    print(json.dumps(result))
    return {**result, "runs": runs}


def optimal_search(planner: Planner, start, goal, limit: int) -> dict:
    """Searches at W = 1 with the planner's heuristic, as the first query on the map; returns its figures.

    Args:
        planner: the planner.
        start, goal: world poses.
        limit: expansions, at most.
    """
    heuristic, world = planner.prepare().heuristic, planner.world
    begin, end = planner.grid.to_lattice(start), planner.grid.to_lattice(goal)
    solve(world, begin, end[None], heuristic.set_goal(end), limits=Limits(expansions=10))  # loads kernels
    planner.clear()
    least: list[float] = []

    def at_end(search: Search) -> None:
        found = float(kernel.least_f(world, search.store, estimate))
        least.append(found * max(0.0, 1 - rounding(world) * found) if np.isfinite(found) else found)

    began = time.process_time()
    estimate = heuristic.set_goal(end)
    result = solve(world, begin, end[None], estimate, limits=Limits(expansions=limit, time=math.inf), at_end=at_end)
    seconds = time.process_time() - began
    solved = result.status[0] == Status.SOLVED
    return {
        "status": str(result.status[0]),
        "cost": round(float(result.cost[0]), 4) if solved else None,
        "lower_bound": round(result.lower_bound if solved else least[0], 4),
        "expansions": result.expansions,
        "settled": settled(estimate),
        "memory_mb": round((result.memory + estimate.back.nbytes()) / 2**20, 1),
        "cpu_s": round(seconds, 3),
    }


def settled(*estimates) -> int:
    """Number of base poses that the backward searches behind some estimates settled."""
    return sum(int(e.back.counts[SETTLED]) for e in estimates if len(e.back.place))


def summary(runs: list[dict], iii_cost: float | None) -> dict:
    """Returns the figures of the last line.

    Args:
        runs: the searches.
        iii_cost: cost of a plan for task III; None without one.
    """
    at = {(run["task"], run["heuristic"]): run for run in runs}
    walled, stepped = at.get((WALLED, "grid")), at.get((STEPPED, "grid"))
    pairs = [
        (at[task, "grid"], at[task, "geometric"])
        for task in dict.fromkeys(run["task"] for run in runs)
        if task not in (WALLED, STEPPED) and at[task, "grid"]["status"] == "solved"
    ]

    def mean_ratio(effort) -> float | None:
        logs = [math.log(effort(grid) / effort(geometric)) for grid, geometric in pairs]
        return round(math.exp(np.mean(logs)), 4) if logs else None

    solved = walled is not None and walled["status"] == "solved"
    return {
        "vi_expansions": walled["expansions"] if solved else None,
        "vi_cost": walled["cost"] if solved else None,
        "others": len(pairs),
        "others_capped": sum(geometric["status"] != "solved" for _, geometric in pairs),
        "others_expansions": mean_ratio(lambda run: run["expansions"]),
        "others_with_settled": mean_ratio(lambda run: run["expansions"] + run["settled"]),
        # The lower limit is the clock's resolution.
        "others_cpu": mean_ratio(lambda run: max(run["cpu_s"], 1e-3)),
        "iii_expansions": None if stepped is None else stepped["expansions"],
        "iii_cost": None if stepped is None else stepped["cost"],
        "iii_bound": None if stepped is None or iii_cost is None else round(iii_cost / stepped["lower_bound"], 4),
    }


def in_words(run: dict) -> str:
    """Describes a search in one line."""
    cost = f"lower bound {run['lower_bound']}" if run["cost"] is None else f"cost {run['cost']}"
    return (
        f"{run['task']}, {run['heuristic']}: {run['status']}, {cost}, {run['expansions']:,} expansions, "
        f"{run['settled']:,} poses settled, {run['cpu_s']} CPU s, {run['memory_mb']} MB"
    )


if __name__ == "__main__":
    main()
