"""Long searches in turns against each guide alone: expansions, the largest multiple of the better guide's, and cost.

    python -m benchmarks.turns [--seed 1000] [--maps 8] [--pairs 16] [--area 105] [--heuristic learned] [--weight 1.25]
                               [--expansions 500000] [--out outputs/benchmarks/turns] [--page docs/heuristics.md]

Random pairs on the maps of `benchmarks.planning`; seeds from 1000 on are for development. Three searches without polish
for each pair: the manual abstraction alone, the other one alone, both in turns. A pair counts if one guide alone needs
10,000 expansions or more, and is hard if the manual one does. A search without a plan counts with the expansions that
it made.

The last line is JSON: pairs, plans for each search, geometric means of ratios with bootstrap intervals, and the largest
multiple of the better guide's expansions.
"""

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.page import shown, table, write_block
from benchmarks.planning.cases import Case, make_cases
from benchmarks.planning.maps import FIRST_DEVELOPMENT_SEED
from benchmarks.planning.runs import EXPANSIONS, FIRST_WEIGHT, planner_for
from benchmarks.planning.statistics import geometric_mean_ratio
from benchmarks.planning.summary import HARD
from hdsp.planning.heuristics import AbstractHeuristic
from hdsp.planning.query import TURN

WAYS = "manual", "alone", "turns"


def main(argv: list[str] | None = None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=FIRST_DEVELOPMENT_SEED)
    parser.add_argument("--maps", type=int, default=8)
    parser.add_argument("--pairs", type=int, default=16, help="pairs on each map")
    parser.add_argument("--area", type=float, default=105.0, help="largest map, m2")
    parser.add_argument("--heuristic", default="learned", help="beside the manual one")
    parser.add_argument("--weight", type=float, default=FIRST_WEIGHT)
    parser.add_argument("--expansions", type=int, default=EXPANSIONS, help="limit of each search")
    parser.add_argument("--out", type=Path, default=Path("outputs/benchmarks/turns"), help="folder for maps and pairs")
    parser.add_argument("--page", type=Path, help="docs page to update")
    arguments = parser.parse_args(argv)
    found: list[dict] = []
    out = arguments.out / str(arguments.seed)
    for case in make_cases(arguments.seed, arguments.maps, arguments.pairs, out, arguments.area):
        found += on_case(case, arguments)
        print(f"{case.name}: {len(found)} pairs so far", flush=True)
    settings = {key: vars(arguments)[key] for key in ("heuristic", "seed", "maps", "weight", "expansions")}
    result = {**settings, "turn": TURN, **summary(found)}
    if arguments.page:
        write_block(arguments.page, "benchmarks.turns", text(result))
    print(json.dumps(result))
    return result


def on_case(case: Case, arguments: argparse.Namespace) -> Iterator[dict]:
    """Yields the expansions and costs of all searches for each pair with a plan."""
    planners = {way: planner_for(case, "manual" if way == "manual" else arguments.heuristic) for way in WAYS}
    heuristic = planners["alone"].heuristic
    assert isinstance(heuristic, AbstractHeuristic)
    heuristic.second = None
    for pair in case.pairs:
        run: dict = {"map": case.name}
        for way, planner in planners.items():
            planner.clear()
            plan = planner.plan(pair.start, pair.goal, arguments.weight, expansions=arguments.expansions, polish=0.0)
            run[way] = plan.stats.expansions, plan.cost
        if any(np.isfinite(run[way][1]) for way in WAYS):
            yield run


def summary(runs: list[dict]) -> dict:
    """Figures over all pairs that count; None where there is no pair."""
    counted = [run for run in runs if max(run["manual"][0], run["alone"][0]) >= HARD]
    hard = [run for run in counted if run["manual"][0] >= HARD]
    result: dict = {"solvable": len(runs), "pairs": len(counted), "hard": len(hard)}
    for way in WAYS:
        result[f"{way}_plans"] = sum(bool(np.isfinite(run[way][1])) for run in counted)
    better = [min(run["manual"][0], run["alone"][0]) for run in counted]
    for name, of, over in (("hard", hard, None), ("better", counted, better)):
        for way in ("alone", "turns"):
            under = [run["manual"][0] for run in of] if over is None else over
            ratio = geometric_mean_ratio([run[way][0] for run in of], under, [run["map"] for run in of])
            result |= {f"{way}_over_{name}": ratio.mean, f"{way}_over_{name}_interval": ratio.ends}
            multiples = [run[way][0] / max(n, 1) for run, n in zip(of, under, strict=True)]
            result[f"{way}_over_{name}_largest"] = round(max(multiples), 1) if of else None
    for way in ("alone", "turns"):
        solved = [run for run in hard if np.isfinite([run[way][1], run["manual"][1]]).all()]
        maps = [run["map"] for run in solved]
        cost = geometric_mean_ratio([run[way][1] for run in solved], [run["manual"][1] for run in solved], maps)
        result |= {f"{way}_cost": cost.mean, f"{way}_cost_interval": cost.ends}
    return result


def text(result: dict) -> str:
    """Formats the result for the page."""
    head = [
        "search", "plans", "expansions over manual's, hard pairs", "largest", "over the better guide's", "largest",
        "cost over manual's, hard pairs",
    ]  # fmt: skip
    names = {"alone": f"{shown(result['heuristic'])} alone", "turns": f"turns of {result['turn']:,} expansions"}
    rows = []
    for way, name in names.items():
        ratios = [[result[f"{way}_over_{of}"], result[f"{way}_over_{of}_largest"]] for of in ("hard", "better")]
        rows.append([name, result[f"{way}_plans"], *ratios[0], *ratios[1], result[f"{way}_cost"]])
    return (
        f"{table(head, rows)}\n\n{result['solvable']} solvable pairs on up to {result['maps']} maps, seed "
        f"{result['seed']}, W = {result['weight']:g}, without polish, at most {result['expansions']:,} expansions; "
        f"{result['pairs']} pairs on which one guide alone needs {HARD:,} expansions or more, {result['hard']} of them "
        "hard: the manual one does. Ratios are geometric means."
    )


if __name__ == "__main__":
    main()
