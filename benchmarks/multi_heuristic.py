"""Multi-heuristic A* against weighted A*: the price of a proved bound with an inadmissible heuristic.

    python -m benchmarks.multi_heuristic [--seeds 4] [--size 5] [--bounds 1.25 1.5 2] [--expansions 2000000]
                                         [--guides manual learned] [--arena] [--json FILE]
                                         [--page docs/guarantees.md]

Terrain is random arenas (start and goal far apart) and, with `--arena`, the paper's arena with its tasks (as scanned if
data/arena/scanned.npz exists, otherwise its true heights). For each bound W:

- `geometric`: weighted A* with the admissible heuristic and W; its bound is proved;
- `plain`: weighted A* with the manual or learned heuristic and W; no bound is proved;
- `anchored 1 x W` and `anchored W^1/2 x W^1/2`: multi-heuristic A*, W1 x W2, same guide, geometric anchor.

Times are processor seconds for the search alone. The last line is JSON with all runs and their summary. Mean ratios are
geometric, over the tasks solved by the anchored search; tasks without any solution are left out. If the geometric
search ends at the expansion limit, its ratio is a lower bound (`geometric_capped` counts these cases).
"""

import argparse
import json
import math
import time
from pathlib import Path

import numpy as np
import yaml

from benchmarks.page import shown, table, write_block
from benchmarks.search import far_apart
from hdsp.detailed.search.estimate import geometric_estimate
from hdsp.detailed.search.multi_heuristic import solve_multi
from hdsp.detailed.search.outcome import Limits, Status
from hdsp.detailed.search.weighted_astar import solve
from hdsp.planning.planner import Planner
from hdsp.terrain.arenas import read_arena
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.random_arenas import random_arena

PAPER = Path("conf/arena/paper.yaml")
SCANNED = Path("data/arena/scanned.npz")


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=4, help="number of random arenas")
    parser.add_argument("--size", type=float, default=5.0, help="side of the arenas, m")
    parser.add_argument("--bounds", type=float, nargs="+", default=[1.25, 1.5, 2.0])
    parser.add_argument("--expansions", type=int, default=2_000_000, help="limit of each search")
    parser.add_argument("--guides", nargs="+", default=["manual", "learned"], help="heuristics, as Planner takes them")
    parser.add_argument("--arena", action="store_true", help="include the paper's arena")
    parser.add_argument("--json", type=Path, help="output file for the result")
    parser.add_argument("--page", type=Path, help="docs page to update")
    arguments = parser.parse_args(argv)

    limits = Limits(expansions=arguments.expansions)
    runs = []
    for name, planners, tasks in places(arguments):
        for task, start, goal in tasks:
            found = compare(planners, start, goal, arguments.bounds, limits)
            runs += [{"place": name, "task": task, **run} for run in found]
            print(f"{name}, {task}: {len(found)} searches, {sum(run['cpu_s'] for run in found):.1f} s", flush=True)
    result = {"runs": runs, "summary": summary(runs)}
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=1) + "\n")
    if arguments.page:
        write_block(arguments.page, "benchmarks.multi_heuristic", text(result, arguments.expansions))
    print(json.dumps(result))
    return result


def places(arguments):
    """Yields, for each terrain, its name, a planner for each guide, and tasks (name, start, goal in lattice units)."""
    for seed in range(arguments.seeds):
        planners = prepared(random_arena(seed, arguments.size), arguments.guides)
        yield f"random {seed}", planners, [("far", *far_apart(planners[0], seed))]
    if arguments.arena:
        description = yaml.safe_load(PAPER.read_text())
        scanned = SCANNED.exists()
        terrain = HeightMap.load(SCANNED) if scanned else read_arena(description).height_map()
        planners = prepared(terrain, arguments.guides)
        grid = planners[0].grid
        ends = [
            (task["name"], *(grid.to_lattice(task[end]) for end in ("start", "goal"))) for task in description["tasks"]
        ]
        yield "arena, scanned" if scanned else "arena, true heights", planners, ends


def prepared(terrain, guides) -> list[Planner]:
    return [Planner(terrain, heuristic=guide).prepare() for guide in guides]


def compare(planners, start, goal, bounds, limits) -> list[dict]:
    """All searches for one task."""
    world = planners[0].world
    anchor = geometric_estimate(world, goal)
    views = {planner.heuristic.name: planner.heuristic.set_goal(goal) for planner in planners}
    solve(world, start, goal[None], anchor, limits=Limits(expansions=10))  # compiles kernels before any timing
    solve_multi(world, start, goal, anchor, [anchor], limits=Limits(expansions=10))
    runs = []
    for bound in bounds:
        result, seconds = timed(solve, world, start, goal[None], anchor, weight=bound, limits=limits)
        runs.append(run_of("geometric", None, bound, result, seconds, bound))
        for name, view in views.items():
            result, seconds = timed(
                solve, world, start, goal[None], view, weight=bound, admissible=False, limits=limits
            )
            runs.append(run_of("plain", name, bound, result, seconds, math.inf))
            for split, w1, w2 in (("1 x W", 1.0, bound), ("W^1/2 x W^1/2", math.sqrt(bound), math.sqrt(bound))):
                result, seconds = timed(
                    solve_multi, world, start, goal, anchor, [view], weight=w1, anchor_weight=w2, limits=limits
                )
                runs.append(run_of(f"anchored {split}", name, bound, result, seconds, result.bound))
    return runs


def timed(search, *arguments, **options):
    began = time.process_time()
    result = search(*arguments, **options)
    return result, time.process_time() - began


def run_of(search: str, guide: str | None, wanted: float, result, seconds: float, proved: float) -> dict:
    solved = result.status[0] == Status.SOLVED
    by = getattr(result, "expansions_by", [])
    return {
        "search": search,
        "guide": guide,
        "bound": wanted,
        "status": str(result.status[0]),
        "cost": round(float(result.cost[0]), 4) if solved else None,
        "proved": round(proved, 4) if solved and np.isfinite(proved) else None,
        "expansions": result.expansions,
        "expansions_anchor": by[0] if by else None,
        "cpu_s": round(seconds, 4),
        "memory_mb": round(result.memory / 2**20, 1),
    }


def solvable(runs: list[dict]) -> list[tuple[str, str]]:
    """Place and name of each task solved by some search."""
    return sorted({(r["place"], r["task"]) for r in runs if r["status"] == "solved"})


def summary(runs: list[dict]) -> list[dict]:
    """For each guide, bound and split: the anchored search beside the others, over all tasks."""
    at = {(r["place"], r["task"], r["search"], r["guide"], r["bound"]): r for r in runs}
    groups = sorted({(r["guide"], r["bound"], r["search"]) for r in runs if r["search"].startswith("anchored")})
    rows = []
    for guide, bound, search in groups:
        tasks = solvable(runs)
        solved = [task for task in tasks if at[*task, search, guide, bound]["status"] == "solved"]
        anchored = [at[*task, search, guide, bound] for task in solved]
        geometric = [at[*task, "geometric", None, bound] for task in solved]
        plain = [at[*task, "plain", guide, bound] for task in solved]
        rows.append({
            "guide": guide,
            "bound": bound,
            "search": search,
            "tasks": len(tasks),
            "solved": len(solved),
            "geometric_capped": sum(r["status"] != "solved" for r in geometric),
            "expansions_geometric_to_anchored": mean_ratio(geometric, anchored, "expansions"),
            "cpu_geometric_to_anchored": mean_ratio(geometric, anchored, "cpu_s"),
            "expansions_anchored_to_plain": mean_ratio(anchored, plain, "expansions"),
            "cpu_anchored_to_plain": mean_ratio(anchored, plain, "cpu_s"),
            "cost_anchored_to_plain": mean_ratio(anchored, plain, "cost"),
            "proved_mean": round(float(np.mean([r["proved"] for r in anchored])), 3) if anchored else None,
        })  # fmt: skip
    return rows


def text(result: dict, limit: int) -> str:
    """Formats the summary for the page."""
    head = [
        "guide", "bound W", "W1 x W2", "solved", "proved on average", "expansions: geometric / anchored",
        "time: geometric / anchored", "expansions: anchored / plain", "cost: anchored / plain",
    ]  # fmt: skip
    lines = []
    for row in result["summary"]:
        capped = ">= " if row["geometric_capped"] else ""
        lines.append([
            shown(row["guide"]), f"{row['bound']:g}", row["search"].removeprefix("anchored "),
            f"{row['solved']} of {row['tasks']}", row["proved_mean"],
            f"{capped}{row['expansions_geometric_to_anchored']}", f"{capped}{row['cpu_geometric_to_anchored']}",
            row["expansions_anchored_to_plain"], row["cost_anchored_to_plain"],
        ])  # fmt: skip
    tasks = {(run["place"], run["task"]) for run in result["runs"]}
    left_out = len(tasks) - len(solvable(result["runs"]))
    ends = (
        f"Each search is limited to {limit:,} expansions. The table leaves out {left_out} of {len(tasks)} tasks: no "
        "search solved them."
    )
    return f"{table(head, lines)}\n\n{ends}"


def mean_ratio(over: list[dict], under: list[dict], what: str) -> float | None:
    """Geometric mean ratio, over tasks for which both sides have this number."""
    pairs = [
        (a[what], b[what]) for a, b in zip(over, under, strict=True) if a[what] is not None and b[what] is not None
    ]
    if not pairs:
        return None
    # The lower limit is the clock's resolution.
    return round(math.exp(np.mean([math.log(max(a, 1e-4) / max(b, 1e-4)) for a, b in pairs])), 3)


if __name__ == "__main__":
    main()
