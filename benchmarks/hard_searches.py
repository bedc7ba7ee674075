"""Hard searches with and without the grid heuristic's value: expansions, CPU time, cost and proved bounds.

    python -m benchmarks.hard_searches [--seed 1000] [--maps 8] [--pairs 16] [--heuristic manual] [--weight 1.25]
                                       [--expansions 500000] [--page docs/heuristics.md]

Random pairs on the maps of `benchmarks.planning`; seeds from 1000 on are for development. Each pair is planned twice,
without polish: by the heuristic alone, and with the grid heuristic from `HARD` expansions on. Pairs with fewer
expansions are the same in both and left out. A search without a plan or proof counts with the expansions that it made.

The last line is JSON: pairs, plans, proofs, geometric means of expansions, mean CPU seconds, and medians of
`plan.bound` for both, and the geometric mean of the cost with over the cost without where both found a plan.
"""

import argparse
import json
import math
import time
from pathlib import Path

import numpy as np

from benchmarks.page import table, write_block
from benchmarks.planning.maps import FIRST_DEVELOPMENT_SEED, maps
from benchmarks.planning.pairs import Pair, draw_pairs
from hdsp import Planner, Status
from hdsp.planning import query
from hdsp.planning.answers.plans import Plan

WAYS = {"alone": math.inf, "guided": query.HARD}


def main(argv: list[str] | None = None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=FIRST_DEVELOPMENT_SEED)
    parser.add_argument("--maps", type=int, default=8)
    parser.add_argument("--pairs", type=int, default=16, help="pairs on each map")
    parser.add_argument("--heuristic", default="manual")
    parser.add_argument("--weight", type=float, default=1.25)
    parser.add_argument("--expansions", type=int, default=500_000, help="limit of each search")
    parser.add_argument("--page", type=Path, help="docs page to update")
    arguments = parser.parse_args(argv)
    runs: list[dict[str, dict]] = []
    for number, drawn in enumerate(maps(arguments.seed, arguments.maps)):
        planner = Planner(drawn.terrain, heuristic=arguments.heuristic).prepare()
        for pair in draw_pairs(planner, arguments.pairs, np.random.SeedSequence([arguments.seed, number, 1])):
            runs += on_pair(planner, pair, arguments)
        print(f"{drawn.name}: {len(runs)} hard pairs so far", flush=True)
    result = {**{key: vars(arguments)[key] for key in ("heuristic", "seed", "maps", "weight")}, **summary(runs)}
    if arguments.page:
        write_block(arguments.page, "benchmarks.hard_searches", text(result))
    print(json.dumps(result))
    return result


def on_pair(planner: Planner, pair: Pair, arguments: argparse.Namespace) -> list[dict[str, dict]]:
    """Plans a pair in both ways; empty if it is not hard."""
    planner.plan(pair.start, pair.goal, arguments.weight, expansions=1, polish=0.0)  # costs-to-go before any clock
    found = {}
    for way, hard in WAYS.items():
        query.HARD = hard
        began = time.process_time()
        plan = planner.plan(
            pair.start, pair.goal, arguments.weight, expansions=arguments.expansions, polish=0.0, start_free=False
        )
        found[way] = figures(plan, time.process_time() - began)
        if found[way]["expansions"] < WAYS["guided"]:
            return []
    return [found]


def figures(plan: Plan, seconds: float) -> dict:
    """Figures of one plan."""
    return {
        "expansions": plan.stats.expansions,
        "cpu": seconds,
        "cost": plan.cost if plan.solved else math.inf,
        "bound": plan.bound,
        "solved": plan.solved,
        "proved": plan.status == Status.INFEASIBLE,
    }


def summary(runs: list[dict[str, dict]]) -> dict:
    """Figures over all hard pairs; None without any."""
    result: dict = {"pairs": len(runs)}
    for way in WAYS:
        of_way = [run[way] for run in runs]
        solved = [each for each in of_way if each["solved"]]
        result |= {
            f"{way}_plans": len(solved),
            f"{way}_proofs": sum(each["proved"] for each in of_way),
            f"{way}_expansions": round(_geometric_mean([each["expansions"] for each in of_way])) if runs else None,
            f"{way}_cpu": round(float(np.mean([each["cpu"] for each in of_way])), 3) if runs else None,
            f"{way}_bound": round(float(np.median([each["bound"] for each in solved])), 3) if solved else None,
        }
    ratios = [run["guided"]["cost"] / run["alone"]["cost"] for run in runs if all(run[way]["solved"] for way in WAYS)]
    return result | {"cost_ratio": round(_geometric_mean(ratios), 4) if ratios else None}


def _geometric_mean(values: list[float]) -> float:
    return float(np.exp(np.mean(np.log(np.maximum(values, 1e-9)))))


def text(result: dict) -> str:
    """Formats the result for the page."""
    head = ["search", "plans", "proofs", "expansions", "CPU s", "plan.bound"]
    names = {"alone": f"{result['heuristic']} alone", "guided": f"with the grid heuristic from {query.HARD:,}"}
    columns = ("plans", "proofs", "expansions", "cpu", "bound")
    rows = [[name, *(result[f"{way}_{column}"] for column in columns)] for way, name in names.items()]
    return (
        f"{table(head, rows)}\n\n{result['pairs']} hard pairs on {result['maps']} maps, seed {result['seed']}, "
        f"W = {result['weight']:g}, without polish. Plans cost {result['cost_ratio']} times as much as those of the "
        "heuristic alone, where both have one. Expansions are geometric means, seconds means, bounds medians."
    )


if __name__ == "__main__":
    main()
