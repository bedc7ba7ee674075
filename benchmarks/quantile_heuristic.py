"""Learned heuristic at lower cost quantiles, against predicted costs: overestimates, search effort, plan cost.

    python -m benchmarks.quantile_heuristic [--model momaro] [--quantiles 0.5 0.25 0.1 0.05 0.01] [--weights 1 1.25]
                                            [--seeds 0 1 2 3 4 5] [--size 5] [--pairs 5] [--near 1]
                                            [--far 3] [--expansions 500000] [--json FILE] [--page docs/heuristics.md]

Tasks are pairs of random valid states on random arenas, `near` to `far` metres apart. The network is evaluated once per
arena; all quantiles follow from this result. Each task is planned with each heuristic and weight, and with the
geometric heuristic, whose plan at W = 1 is optimal. The benchmark prints one line per task, then one JSON line:

- `above`: quantiles of h / h* and the share above 1, over states on optimal plans (the start and `suffixes` more from
  each plan), counted as in benchmarks.inadmissibility. Tasks without a reference plan do not count.
- `rows`: for each heuristic and weight, the number of solved tasks; `expansions`: geometric mean ratio to the
  expansions with predicted costs at the same weight, over tasks solved by both; `cost_to_best`: mean and largest ratio
  to the least cost from any search, over solved tasks.
"""

import argparse
import json
import math
import sys
from pathlib import Path

import numpy as np

from benchmarks.inadmissibility import pairs, scores, spread
from benchmarks.page import table, write_block
from hdsp.abstract.abstract_costs import close_states
from hdsp.base.errors import InputError
from hdsp.learning import LearnedAbstraction, LearnedCosts
from hdsp.learning.loading import load_abstraction
from hdsp.planning.answers.plans import Plan
from hdsp.planning.heuristics import standing_states
from hdsp.planning.planner import Planner
from hdsp.robot.lattice import ABSTRACT_HEADINGS, robot_frame_goals
from hdsp.terrain.random_arenas import random_arena

PREDICTED, REFERENCE = "predicted", "geometric"


class KnownCosts:
    """Precomputed `AbstractCosts` for one map."""

    def __init__(self, edges: np.ndarray):
        self.known = edges

    def edges(self, height_map, region=None, mask=None) -> np.ndarray:
        edges = self.known.copy()
        close_states(edges, mask)
        return edges


def main(argv: list[str] | None = None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", default="momaro", help="shipped abstraction, or a folder")
    parser.add_argument("--quantiles", type=float, nargs="+", default=[0.5, 0.25, 0.1, 0.05, 0.01])
    parser.add_argument("--weights", type=float, nargs="+", default=[1.0, 1.25])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4, 5])
    parser.add_argument("--size", type=float, default=5.0, help="side of the arenas, m")
    parser.add_argument("--pairs", type=int, default=5, help="tasks per arena")
    parser.add_argument("--near", type=float, default=1.0, help="least distance between start and goal, m")
    parser.add_argument("--far", type=float, default=3.0, help="largest distance between start and goal, m")
    parser.add_argument("--suffixes", type=int, default=8, help="largest number of counted states per optimal plan")
    parser.add_argument("--least", type=float, default=0.1, help="least cost-to-go of counted states")
    parser.add_argument("--expansions", type=int, default=500_000, help="limit of each search")
    parser.add_argument("--json", type=Path, help="output file for the result")
    parser.add_argument("--page", type=Path, help="docs page to update")
    arguments = parser.parse_args(argv)
    try:
        abstraction = load_abstraction(arguments.model)
        for level in arguments.quantiles:
            abstraction.calibration.factors(level)
    except InputError as error:
        sys.exit(f"error: {error}")

    runs: list[dict] = []
    ratios: dict[str, list[np.ndarray]] = {}
    for seed in arguments.seeds:
        planners = prepared(abstraction, seed, arguments)
        drawn = pairs(planners[REFERENCE], np.random.default_rng(seed), arguments.pairs, arguments.near, arguments.far)
        for number, (start, goal) in enumerate(drawn):
            found, estimates = on_task(planners, start, goal, arguments)
            runs += [{"task": f"{seed}.{number}", **run} for run in found]
            for name, values in estimates.items():
                ratios.setdefault(name, []).append(values)
            solved = sum(run["solved"] for run in found)
            print(f"arena {seed}, task {number}: {solved} of {len(found)} searches found a plan", flush=True)
    result = {
        "model": arguments.model,
        "arenas": len(arguments.seeds),
        "expansions_limit": arguments.expansions,
        "above": {name: scores(np.concatenate(values)) for name, values in ratios.items()},
        **summary(runs),
    }
    if arguments.json:
        arguments.json.write_text(json.dumps({**result, "runs": runs}, indent=1) + "\n")
    if arguments.page:
        write_block(arguments.page, "benchmarks.quantile_heuristic", text(result))
    print(json.dumps(result))
    return result


def prepared(abstraction: LearnedAbstraction, seed: int, arguments: argparse.Namespace) -> dict[str, Planner]:
    """Returns a planner for each heuristic on one random arena; the reference comes first."""
    reference = Planner(random_arena(seed, arguments.size))
    edges = LearnedCosts(abstraction).edges(reference.terrain, mask=standing_states(reference.world))
    levels = {PREDICTED: edges} | {
        f"quantile {level:g}": at_level(abstraction, edges, level) for level in arguments.quantiles
    }
    guided = {name: Planner(reference.terrain, heuristic=KnownCosts(costs)) for name, costs in levels.items()}
    return {REFERENCE: reference, **guided}


def on_task(planners: dict[str, Planner], start, goal, arguments) -> tuple[list[dict], dict[str, np.ndarray]]:
    """Runs one search with each heuristic and weight; also returns h / h* for each heuristic.

    Ratios exist only if the reference found the optimal plan. Start and goal are states int64 [7] in lattice units.
    """
    grid = planners[REFERENCE].grid
    ends, limit = (grid.to_world(start), grid.to_world(goal)), arguments.expansions
    cheapest = planners[REFERENCE].plan(*ends, expansions=limit)
    way = None
    if cheapest.solved:
        states = np.array([grid.to_lattice(state[:3], state[3:]) for state in cheapest.states])
        way = spread(states, cheapest.action_costs, arguments.suffixes, arguments.least)
    runs, estimates = [], {}
    for name, planner in planners.items():
        for weight in arguments.weights:
            known = name == REFERENCE and weight == 1
            plan = cheapest if known else planner.plan(*ends, weight=weight, expansions=limit, polish=0)
            runs.append(run_of(name, weight, plan))
        if way is not None:
            planner.heuristic.set_goal(goal)
            estimates[name] = planner.heuristic(way[0]) / way[1]
    return runs, estimates


def run_of(heuristic: str, weight: float, plan: Plan) -> dict:
    return {
        "heuristic": heuristic, "weight": weight, "solved": plan.solved, "expansions": plan.stats.expansions,
        "cost": plan.cost if plan.solved else None,
    }  # fmt: skip


def at_level(abstraction: LearnedAbstraction, edges: np.ndarray, level: float) -> np.ndarray:
    """Converts edges [16, nx, ny, 22] from predicted costs to a cost level."""
    result = np.full_like(edges, np.inf)
    for heading in range(ABSTRACT_HEADINGS):
        flat = np.broadcast_to(abstraction.flat_costs(robot_frame_goals(heading)), edges[heading].shape)
        feasible = np.isfinite(edges[heading])
        result[heading][feasible] = abstraction.calibration.at_level(level, edges[heading][feasible], flat[feasible])
    return result


def summary(runs: list[dict]) -> dict:
    """Figures for each heuristic and weight; a task without any solution counts only as a task."""
    at = {(run["task"], run["heuristic"], run["weight"]): run for run in runs}
    tasks = list(dict.fromkeys(run["task"] for run in runs))
    solved_runs = [run for run in runs if run["solved"]]
    best = {task: min((run["cost"] for run in solved_runs if run["task"] == task), default=None) for task in tasks}
    rows = []
    for heuristic, weight in dict.fromkeys((run["heuristic"], run["weight"]) for run in runs):
        solved = [task for task in tasks if at[task, heuristic, weight]["solved"]]
        both = [task for task in solved if at[task, PREDICTED, weight]["solved"]]
        costs = [at[task, heuristic, weight]["cost"] / best[task] for task in solved]
        efforts = [
            max(at[task, heuristic, weight]["expansions"], 1) / max(at[task, PREDICTED, weight]["expansions"], 1)
            for task in both
        ]
        rows.append({
            "heuristic": heuristic, "weight": weight, "solved": len(solved), "compared": len(both),
            "expansions": round(math.exp(np.mean(np.log(efforts))), 3) if both else None,
            "cost_to_best": round(float(np.mean(costs)), 4) if costs else None,
            "largest_cost_to_best": round(max(costs), 4) if costs else None,
        })  # fmt: skip
    return {"tasks": len(tasks), "solved_by_none": sum(value is None for value in best.values()), "rows": rows}


def text(result: dict) -> str:
    """Formats the result for the page."""
    rows = [
        [
            row["heuristic"], *overestimated(result["above"].get(row["heuristic"])), f"{row['weight']:g}",
            f"{row['solved']} of {result['tasks']}", row["expansions"], row["cost_to_best"],
            row["largest_cost_to_best"],
        ]
        for row in result["rows"]
    ]  # fmt: skip
    head = [
        "costs", "states with h > h*", "h / h*: 50%", "95%", "W", "solved",
        "expansions / expansions with predicted costs", "cost / best known", "largest",
    ]  # fmt: skip
    states = max((found["n"] for found in result["above"].values()), default=0)
    counted = (
        f"Model {result['model']}; random arenas: {result['arenas']}; tasks: {result['tasks']}, "
        f"{result['solved_by_none']} without a plan from any search; states with known h*: {states}; limit per search: "
        f"{result['expansions_limit']:,} expansions."
    )
    return f"{table(head, rows)}\n\n{counted}"


def overestimated(found: dict | None) -> list:
    """Share of states above 1 and quantiles of h / h*, formatted for the page; None without data."""
    return [None] * 3 if found is None else [f"{found['above_1']:.1%}", found["q50"], found["q95"]]


if __name__ == "__main__":
    main()
