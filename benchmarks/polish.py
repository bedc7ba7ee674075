"""Polish of found plans: cost before and after over the proved optimum, expansions and CPU time.

    python -m benchmarks.polish [--seeds 20] [--test] [--size 5] [--pairs 4] [--near 1] [--far 4] [--heuristic manual]
                                [--weights 1 1.25 1.5 2] [--hard 10000] [--expansions 3000000]
                                [--page docs/heuristics.md]

Tasks are pairs of random valid states on random arenas, `near` to `far` metres apart. Development seeds begin at 1000;
`--test` takes the seeds from 0 on. The optimum comes from A* with the geometric heuristic and W = 1, which looks only
for plans below the best known cost; where it ends at its limit, the best known cost counts instead. A task is hard if
the search at the smallest weight needs `hard` expansions.

The last line is JSON. For each weight: number of plans, mean and largest cost above the optimum before and after the
polish (also for hard tasks alone), the same after a polish whose sweeps trust no heuristic, means of expansions in
search and polish, CPU seconds of both polishes in the mean, and the share of plans that the polish made cheaper.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np

from benchmarks.inadmissibility import pairs
from benchmarks.page import table, write_block
from hdsp.planning import polish as polishing
from hdsp.planning.planner import Planner
from hdsp.planning.polish import DEFAULT, SWEEPS
from hdsp.terrain.random_arenas import random_arena

#: First seed of development; the seeds before it are for tests.
DEVELOPMENT = 1000


def main(argv: list[str] | None = None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20, help="number of arenas")
    parser.add_argument("--test", action="store_true", help="take the test seeds instead of those of development")
    parser.add_argument("--size", type=float, default=5.0, help="side of the arenas, m")
    parser.add_argument("--pairs", type=int, default=4, help="tasks per arena")
    parser.add_argument("--near", type=float, default=1.0, help="least distance between start and goal, m")
    parser.add_argument("--far", type=float, default=4.0, help="largest distance between start and goal, m")
    parser.add_argument("--heuristic", default="manual")
    parser.add_argument("--weights", type=float, nargs="+", default=[1.0, 1.25, 1.5, 2.0])
    parser.add_argument("--hard", type=int, default=10_000, help="expansions of a hard task")
    parser.add_argument("--expansions", type=int, default=3_000_000, help="limit of each search")
    parser.add_argument("--page", type=Path, help="docs page to update")
    arguments = parser.parse_args(argv)
    runs = []
    for seed in range(arguments.seeds) if arguments.test else range(DEVELOPMENT, DEVELOPMENT + arguments.seeds):
        runs += on_arena(seed, arguments)
        print(f"arena {seed}: {len(runs)} plans so far", flush=True)
    result = {
        "heuristic": arguments.heuristic,
        "seeds": "test" if arguments.test else "development",
        "arenas": arguments.seeds,
        "tasks": len({run["task"] for run in runs}),
        "proved": len({run["task"] for run in runs if run["proved"]}),
        "rows": [row(weight, [run for run in runs if run["weight"] == weight]) for weight in arguments.weights],
    }
    if arguments.page:
        write_block(arguments.page, "benchmarks.polish", text(result))
    print(json.dumps(result))
    return result


def on_arena(seed: int, arguments: argparse.Namespace) -> list[dict]:
    """Plans each task of one arena at each weight, without and with polish."""
    guided = Planner(random_arena(seed, arguments.size), heuristic=arguments.heuristic).prepare()
    reference = Planner(guided.terrain)
    runs = []
    drawn = pairs(reference, np.random.default_rng(seed), arguments.pairs, arguments.near, arguments.far)
    for number, states in enumerate(drawn):
        start, goal = (guided.grid.to_world(state) for state in states)
        guided.plan(start, goal, expansions=1)  # loads kernels before any measurement
        found = []
        for weight in arguments.weights:
            plain, plain_seconds = timed(guided, start, goal, weight, 0.0, arguments.expansions)
            polished, seconds = timed(guided, start, goal, weight, DEFAULT, arguments.expansions)
            polishing.SWEEPS = tuple(sweep._replace(trust=0.0) for sweep in SWEEPS)
            exact, exact_seconds = timed(guided, start, goal, weight, DEFAULT, arguments.expansions)
            polishing.SWEEPS = SWEEPS
            if plain.solved:
                found.append({
                    "task": f"{seed}.{number}", "weight": weight, "before": plain.cost, "after": polished.cost,
                    "exact": exact.cost,
                    "expansions": plain.stats.expansions, "polish_expansions": polished.stats.polish_expansions,
                    "cpu": seconds - plain_seconds, "exact_cpu": exact_seconds - plain_seconds,
                })  # fmt: skip
        if not found:
            continue
        best = min(min(run["after"], run["exact"]) for run in found)
        optimum = reference.plan(start, goal, 1.0, cost=best * (1 + 1e-6), expansions=arguments.expansions)
        hard = found[0]["expansions"] >= arguments.hard
        least = min(best, optimum.cost)
        runs += [run | {"least": least, "proved": optimum.solved, "hard": hard} for run in found]
    return runs


def timed(planner: Planner, start, goal, weight: float, polish: float, expansions: int):
    """Returns a plan and its CPU seconds, without knowledge from earlier queries."""
    planner.clear()
    began = time.process_time()
    plan = planner.plan(start, goal, weight, polish=polish, expansions=expansions)
    return plan, time.process_time() - began


def row(weight: float, runs: list[dict]) -> dict:
    """Figures for one weight; costs above the optimum are shares."""
    hard = [run for run in runs if run["hard"]]
    return {
        "weight": weight, "plans": len(runs), "hard": len(hard),
        **{f"{when}_{name}": value for when in WHEN for name, value in above(runs, when).items()},
        **{f"hard_{when}": above(hard, when)["mean"] for when in WHEN},
        "expansions": round(float(np.mean([run["expansions"] for run in runs]))),
        "polish_expansions": round(float(np.mean([run["polish_expansions"] for run in runs]))),
        "polish_cpu": round(float(np.mean([run["cpu"] for run in runs])), 3),
        "exact_cpu": round(float(np.mean([run["exact_cpu"] for run in runs])), 3),
        "cheaper": round(float(np.mean([run["after"] < run["before"] for run in runs])), 3),
    }  # fmt: skip


def above(runs: list[dict], when: str) -> dict:
    """Mean and largest cost above the optimum; None without runs."""
    shares = [run[when] / run["least"] - 1 for run in runs]
    return {
        "mean": round(float(np.mean(shares)), 4) if shares else None,
        "largest": round(max(shares), 4) if shares else None,
    }


def text(result: dict) -> str:
    """Formats the result for the page."""
    head = [
        "W", "plans", "above the optimum: before", "largest", "after", "largest", "exact sweeps only", "largest",
        "hard: before", "after", "exact only", "expansions of the search", "of the polish", "CPU s of the polish",
        "exact only",
    ]  # fmt: skip
    rows = [
        [
            f"{r['weight']:g}", r["plans"], *(share(r[name]) for name in SHARES), f"{r['expansions']:,}",
            f"{r['polish_expansions']:,}", r["polish_cpu"], r["exact_cpu"],
        ]
        for r in result["rows"]
    ]  # fmt: skip
    counted = (
        f"Heuristic {result['heuristic']}; random arenas: {result['arenas']}, {result['seeds']} seeds; tasks: "
        f"{result['tasks']}, {result['proved']} with a proved optimum, the others against the best known cost."
    )
    return f"{table(head, rows)}\n\n{counted}"


#: Plans of a task: without polish, with it, and with sweeps that trust no heuristic.
WHEN = "before", "after", "exact"
SHARES = (*(f"{when}_{name}" for when in WHEN for name in ("mean", "largest")), *(f"hard_{when}" for when in WHEN))


def share(value: float | None) -> str | None:
    return None if value is None else f"{value:+.1%}"


if __name__ == "__main__":
    main()
