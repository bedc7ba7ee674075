"""Searches with a proved bound: geometric, grid, and multi-heuristic A* with a guide and the grid anchor.

    python -m benchmarks.multi_heuristic [--tasks 200] [--per-arena 5] [--seed 0] [--size 5] [--bounds 1.25 1.5 2]
                                         [--expansions 3000000] [--guides manual] [--json FILE]
                                         [--page docs/guarantees.md] [--out outputs/benchmarks/bounds]

Tasks are random pairs on random arenas (`benchmarks.planning.pairs`), up to `per-arena` on each; pairs that the planner
proves infeasible are left out. The feet at both ends are as the planner chooses them. Development seeds begin at 1000.
For each bound W:

- `geometric`, `grid`: weighted A* with this heuristic and W, as in `plan(weight=W)`; its bound is proved;
- `plain`: weighted A* with the guide and W; no bound is proved;
- `anchored 1 x W` and `anchored W^1/2 x W^1/2`: multi-heuristic A*, W1 x W2, as in `plan(weight=W1, anchor_weight=W2)`.

Times are processor seconds for the heuristics of the goal and the search, each as the first query on its map. The
preparation for the whole map comes before. Expansions leave out the base poses that backward searches settle; a column
adds them. Ratios geometric / other are geometric means over all tasks that one of the two solves, with intervals by
bootstrap over arenas. A search that ends at its limit counts with its effort up to there, so these ratios depend on the
limit; for the times on the tasks that both solve, it only decides which tasks these are.

Searches are kept under ``--out``, one file for each arena. A run goes on where the last one stopped, and repeats
searches whose code has changed. `python -m benchmarks.planning --bounds TASKS` takes the same figures.

The last line is JSON with these ratios and their intervals: `bound_W_expansions`, `bound_W_with_settled` and
`bound_W_time` for the anchored search with the first guide and equal shares, `bound_W_grid_expansions` and so on for
`grid`. `bound_W_time_both` and its kind are over the tasks that both searches solve.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.grid_heuristic import settled
from benchmarks.page import shown, table, write_block
from benchmarks.planning.cases import write_json
from benchmarks.planning.pairs import draw_pairs
from benchmarks.planning.statistics import Interval, geometric_mean_ratio
from hdsp.base.provenance import code_fingerprint
from hdsp.detailed.search.multi_heuristic import solve_multi
from hdsp.detailed.search.outcome import Limits, SearchResult, Status
from hdsp.detailed.search.weighted_astar import solve
from hdsp.planning.heuristics import GeometricHeuristic, GridHeuristic
from hdsp.planning.planner import Planner
from hdsp.terrain.random_arenas import random_arena

#: Time for a plan or a proof that a pair is infeasible, s.
PROOF_SECONDS = 10.0
#: Folder for results.
OUT = Path("outputs/benchmarks/bounds")
#: The anchored search of the JSON keys.
EQUAL_SHARES = "anchored W^1/2 x W^1/2"
#: Names of ratios in rows and keys, and the effort behind each.
EFFORTS = {
    "expansions": lambda run: run["expansions"],
    "with_settled": lambda run: run["expansions"] + run["settled"],
    "time": lambda run: max(run["cpu_s"], 1e-4),  # the clock's resolution
}


def main(argv: list[str] | None = None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tasks", type=int, default=200, help="number of tasks")
    parser.add_argument("--per-arena", type=int, default=5, help="tasks on each arena")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first arena")
    parser.add_argument("--size", type=float, default=5.0, help="side of the arenas, m")
    parser.add_argument("--bounds", type=float, nargs="+", default=[1.25, 1.5, 2.0])
    parser.add_argument("--expansions", type=int, default=3_000_000, help="limit of each search")
    parser.add_argument("--guides", nargs="+", default=["manual"], help="heuristics, as Planner takes them")
    parser.add_argument("--json", type=Path, help="output file for the result with all searches")
    parser.add_argument("--page", type=Path, help="docs page to update")
    parser.add_argument("--out", type=Path, default=OUT, help="folder for results")
    arguments = parser.parse_args(argv)

    whole = measure(
        arguments.tasks, arguments.seed, arguments.bounds, arguments.out, per_arena=arguments.per_arena,
        size=arguments.size, expansions=arguments.expansions, guides=arguments.guides,
    )  # fmt: skip
    if arguments.json:
        arguments.json.write_text(json.dumps(whole, indent=1) + "\n")
    if arguments.page:
        write_block(arguments.page, "benchmarks.multi_heuristic", text(whole))
    print(json.dumps({name: value for name, value in whole.items() if name not in ("summary", "runs")}))
    return whole


def measure(
    tasks: int,
    seed: int,
    bounds: Sequence[float],
    out: Path = OUT,
    *,
    per_arena: int = 5,
    size: float = 5.0,
    expansions: int = 3_000_000,
    guides: Sequence[str] = ("manual",),
) -> dict:
    """Measures all searches on as many tasks, on arenas of ``size`` m from ``seed`` on.

    Returns:
        The ratios by their keys, `summary` with a row for each search, and `runs`.
    """
    runs: list[dict] = []
    found, arena = 0, seed
    while found < tasks:
        options = {"per_arena": per_arena, "size": size, "bounds": list(bounds), "expansions": expansions,
                   "guides": list(guides)}  # fmt: skip
        kept = _arena_runs(arena, min(per_arena, tasks - found), out, options)
        runs += kept
        found += len({run["task"] for run in kept})
        print(f"random {arena}: {found} tasks, {sum(run['cpu_s'] for run in runs):.1f} CPU s so far", flush=True)
        arena += 1
    rows = summary(runs)
    return {
        "tasks": found,
        "solved_by_some": len(solvable(runs)),
        "arenas": arena - seed,
        "first_seed": seed,
        "size": size,
        "limit": expansions,
        "guides": list(guides),
        **keys(rows, guides[0]),
        "summary": rows,
        "runs": runs,
    }


def _arena_runs(seed: int, tasks: int, out: Path, options: dict) -> list[dict]:
    """Runs of up to ``tasks`` tasks on one arena, made now or kept from an earlier run of the same code."""
    path = out / f"arena_{seed}.json"
    version = f"{code_fingerprint(Planner.__module__)} {tasks} {json.dumps(options)}"
    if path.is_file() and (kept := json.loads(path.read_text()))["version"] == version:
        return kept["runs"]
    terrain, limits = random_arena(seed, options["size"]), Limits(expansions=options["expansions"], time=math.inf)
    planners = [Planner(terrain, heuristic=guide).prepare() for guide in options["guides"]]
    runs: list[dict] = []
    for pair in draw_pairs(planners[0], options["per_arena"], np.random.SeedSequence([seed, 1])):
        tried = planners[0].plan(
            pair.start, pair.goal, 2.0, polish=0, expansions=options["expansions"], time=PROOF_SECONDS
        )
        if tried.status == Status.INFEASIBLE or len({run["task"] for run in runs}) == tasks:
            continue
        ends = (planners[0].grid.to_lattice(end[:3], end[3:]) for end in tried.ends)
        compared = compare(planners, *ends, options["bounds"], limits)
        runs += [{"place": f"random {seed}", "task": pair.key, **run} for run in compared]
    write_json(path, {"version": version, "runs": runs})
    return runs


def compare(planners: list[Planner], start: np.ndarray, goal: np.ndarray, bounds: list[float], limits: Limits):
    """Returns all searches for one task; start and goal in lattice units."""
    runs = []
    for planner in planners:
        world, guide = planner.world, planner.heuristic
        geometric, grid = GeometricHeuristic(world), GridHeuristic(world)
        grid.prepare()

        def weighted(heuristic, weight, limits=limits, world=world):
            view = heuristic.set_goal(goal)
            result = solve(
                world, start, goal[None], view, weight=weight, admissible=heuristic.admissible, reopen=False,
                limits=limits,
            )  # fmt: skip
            return result, settled(view)

        def anchored(weight, anchor_weight, limits=limits, world=world, guide=guide, grid=grid):
            anchor, view = grid.set_goal(goal), guide.set_goal(goal)
            result = solve_multi(
                world, start, goal, anchor, [view], weight=weight, anchor_weight=anchor_weight, limits=limits
            )
            return result, settled(anchor)

        weighted(guide, 1.5, Limits(expansions=10))  # loads kernels before any measurement
        anchored(1.5, 1.5, Limits(expansions=10))
        for bound in bounds:
            root = math.sqrt(bound)
            if planner is planners[0]:
                for heuristic in (geometric, grid):
                    runs.append(run_of(heuristic.name, None, bound, planner, weighted, heuristic, bound))
            runs.append(run_of("plain", guide.name, bound, planner, weighted, guide, bound))
            runs.append(run_of("anchored 1 x W", guide.name, bound, planner, anchored, 1.0, bound))
            runs.append(run_of(EQUAL_SHARES, guide.name, bound, planner, anchored, root, root))
    return runs


def run_of(search: str, guide: str | None, wanted: float, planner: Planner, call, *options) -> dict:
    """Measures one search as the first query on its map; ``call`` returns its result and the settled poses."""
    planner.clear()
    began = time.process_time()
    result, poses = call(*options)
    seconds = time.process_time() - began
    return {
        "search": search,
        "guide": guide,
        "bound": wanted,
        **ended(result),
        "expansions": result.expansions,
        "settled": poses,
        "cpu_s": round(seconds, 4),
    }


def ended(result: SearchResult) -> dict:
    solved = result.status[0] == Status.SOLVED
    return {
        "status": str(result.status[0]),
        "cost": round(float(result.cost[0]), 4) if solved else None,
        "proved": round(result.bound, 4) if solved and np.isfinite(result.bound) else None,
    }


def solvable(runs: list[dict]) -> dict[tuple[str, str], float]:
    """Least cost of a plan for each task (place and name) that some search solved."""
    best: dict[tuple[str, str], float] = {}
    for run in runs:
        if run["status"] == "solved":
            task = run["place"], run["task"]
            best[task] = min(best.get(task, math.inf), run["cost"])
    return best


def summary(runs: list[dict]) -> list[dict]:
    """For each bound, search and guide: its effort beside that of the geometric search with the same bound."""
    at = {(r["bound"], r["search"], r["guide"], r["place"], r["task"]): r for r in runs}
    best = solvable(runs)
    rows = []
    for bound, search, guide in dict.fromkeys((r["bound"], r["search"], r["guide"]) for r in runs):
        own = [at[bound, search, guide, *task] for task in best]
        base = [at[bound, "geometric", None, *task] for task in best]
        solved = [run for run in own if run["status"] == "solved"]
        pairs = [(a, b) for a, b in zip(base, own, strict=True) if "solved" in (a["status"], b["status"])]
        places = [b["place"] for _, b in pairs]
        ratios = {
            name: geometric_mean_ratio([effort(a) for a, _ in pairs], [effort(b) for _, b in pairs], places)
            for name, effort in EFFORTS.items()
        }
        both = [(a, b) for a, b in pairs if a["status"] == b["status"]]
        ratios["time_both"] = geometric_mean_ratio(
            *([EFFORTS["time"](pair[k]) for pair in both] for k in range(2)), [b["place"] for _, b in both]
        )
        rows.append({
            "bound": bound,
            "search": search,
            "guide": guide,
            "tasks": len(best),
            "solved": len(solved),
            "compared": len(pairs),
            "geometric_solved": sum(a["status"] == "solved" for a, _ in pairs),
            **ratios,
            "proved_mean": mean([run["proved"] for run in solved if run["proved"] is not None]),
            "cost_to_best": mean([run["cost"] / best[run["place"], run["task"]] for run in solved]),
        })  # fmt: skip
    return rows


def mean(values: list[float]) -> float | None:
    return round(float(np.mean(values)), 3) if values else None


def keys(rows: list[dict], guide: str) -> dict:
    """Returns the ratios of the last line, each with its interval."""
    found = {}
    for row in rows:
        chosen = {("grid", None): "grid_", (EQUAL_SHARES, guide): ""}.get((row["search"], row["guide"]))
        if chosen is not None:
            for name in (*EFFORTS, "time_both"):
                found[f"bound_{row['bound']:g}_{chosen}{name}"] = row[name].mean
                found[f"bound_{row['bound']:g}_{chosen}{name}_interval"] = row[name].ends
    return found


def text(result: dict) -> str:
    """Formats the summary for the page."""
    head = [
        "bound W", "search", "solved", "proved on average", "expansions: geometric / this",
        "with settled poses", "CPU time", "CPU time, both solve", "cost over the least found",
    ]  # fmt: skip
    lines = []
    for row in result["summary"]:
        name = row["search"] if row["guide"] is None else f"{shown(row['guide'])}, {row['search']}"
        compared = row["search"] != "geometric"
        lines.append([
            f"{row['bound']:g}", name, f"{row['solved']} of {row['tasks']}", row["proved_mean"],
            *(in_words(row[effort]) if compared else None for effort in (*EFFORTS, "time_both")),
            None if row["cost_to_best"] is None else f"{100 * (row['cost_to_best'] - 1):+.1f}%",
        ])  # fmt: skip
    ends = (
        f"Tasks: {result['tasks']} on {result['arenas']} random arenas of {result['size']:g} x {result['size']:g} m, "
        f"seeds from {result['first_seed']}; {result['solved_by_some']} of them solved by some search, the others are "
        f"left out. Each search is limited to {result['limit']:,} expansions. In brackets: 95 % intervals."
    )
    return f"{table(head, lines)}\n\n{ends}"


def in_words(ratio: Interval) -> str | None:
    return None if ratio.mean is None else f"{ratio.mean:.3g} ({ratio.low:.3g} to {ratio.high:.3g})"


if __name__ == "__main__":
    main()
