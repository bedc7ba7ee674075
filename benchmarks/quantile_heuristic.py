"""The learned heuristic with lower quantiles of cost, against costs as the network says: search effort and plan cost.

    python -m benchmarks.quantile_heuristic [--model momaro] [--quantiles 0.05 0.5] [--seeds 0 1 2] [--size 4] ...

On random arenas, between two states far from each other. For each arena the network is asked once; quantiles follow
from its answer. Prints a line for each search, then one JSON line: for each heuristic the searches that found a plan,
mean expansions and mean cost relative to the costs as the network says (over arenas where both were solved), and
`cost_to_best`: mean ratio to the cheapest plan of any search on that arena, the geometric reference at W = 1 among them
if it ends within the limit. `start_to_best`: what the heuristic says at the start, relative to that plan; above 1 it
overestimates there.
"""

import argparse
import json
import sys
import time

import numpy as np

from benchmarks.search import far_apart
from hdsp.abstract.costs import close_states
from hdsp.arena import ArenaSettings, random_arena
from hdsp.errors import InputError
from hdsp.heuristics import standing_states
from hdsp.lattice import ABSTRACT_HEADINGS, robot_frame_goals
from hdsp.learning import LearnedAbstraction, LearnedCosts
from hdsp.planner import Planner
from hdsp.pretrained import load_abstraction

AS_SAID = "network"


class KnownCosts:
    """`AbstractCosts` of one map that were computed before."""

    def __init__(self, edges: np.ndarray):
        self.known = edges

    def edges(self, height_map, region=None, mask=None) -> np.ndarray:
        edges = self.known.copy()
        close_states(edges, mask)
        return edges


def main(argv: list[str] | None = None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", default="momaro", help="one that comes with the package, or a folder")
    parser.add_argument("--quantiles", type=float, nargs="+", default=[0.05, 0.5])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--size", type=float, default=4.0, help="side of the arenas, m")
    parser.add_argument("--weight", type=float, default=1.0)
    parser.add_argument("--expansions", type=int, default=300_000, help="limit of each search")
    arguments = parser.parse_args(argv)
    try:
        abstraction = load_abstraction(arguments.model)
        for level in arguments.quantiles:
            abstraction.calibration.factors(level)
    except InputError as error:
        sys.exit(f"error: {error}")
    runs = [run for seed in arguments.seeds for run in on_arena(abstraction, seed, arguments)]
    result = {"model": arguments.model, "weight": arguments.weight, "arenas": len(arguments.seeds), **summary(runs)}
    print(json.dumps(result))
    return result


def on_arena(abstraction: LearnedAbstraction, seed: int, arguments: argparse.Namespace) -> list[dict]:
    """One search with each heuristic."""
    reference = Planner(random_arena(seed, arguments.size, ArenaSettings(blocks=2, least_free_share=0.1)))
    start, goal = far_apart(reference, seed)
    edges = LearnedCosts(abstraction).edges(reference.terrain, mask=standing_states(reference.world))
    levels = {AS_SAID: edges} | {f"q{level:g}": at_level(abstraction, edges, level) for level in arguments.quantiles}
    planners = {name: Planner(reference.terrain, heuristic=KnownCosts(costs)) for name, costs in levels.items()}
    runs = []
    for name, planner in {**planners, "geometric": reference}.items():
        weight = 1.0 if planner is reference else arguments.weight
        ends = (reference.grid.to_world(state) for state in (start, goal))
        began = time.process_time()
        plan = planner.plan(*ends, weight=weight, expansions=arguments.expansions)
        seconds = time.process_time() - began
        runs.append({
            "seed": seed, "heuristic": name, "solved": plan.solved, "cost": plan.cost,
            "expansions": plan.stats["expansions"], "seconds": seconds,
            "start": float(planner.heuristic(start[None])[0]),
        })  # fmt: skip
        print(f"arena {seed}, {name}: {plan.status}, cost {plan.cost:.4f}, {plan.stats['expansions']} expansions")
    return runs


def at_level(abstraction: LearnedAbstraction, edges: np.ndarray, level: float) -> np.ndarray:
    """Edges [16, nx, ny, 22] of costs as the network says, at a level of cost."""
    result = np.full_like(edges, np.inf)
    for heading in range(ABSTRACT_HEADINGS):
        flat = np.broadcast_to(abstraction.flat_costs(robot_frame_goals(heading)), edges[heading].shape)
        feasible = np.isfinite(edges[heading])
        result[heading][feasible] = abstraction.calibration.at_level(level, edges[heading][feasible], flat[feasible])
    return result


def summary(runs: list[dict]) -> dict:
    """Figures of each heuristic; means over no arena are None."""
    names = list(dict.fromkeys(run["heuristic"] for run in runs))
    by_name = {name: {run["seed"]: run for run in runs if run["heuristic"] == name} for name in names}
    best = {seed: min(by_name[name][seed]["cost"] for name in names) for seed in by_name[AS_SAID]}
    result = {}
    for name in names:
        solved = {seed: run for seed, run in by_name[name].items() if run["solved"]}
        both = [(run, by_name[AS_SAID][seed]) for seed, run in solved.items() if by_name[AS_SAID][seed]["solved"]]
        result[name] = {
            "solved": len(solved),
            "expansions": mean([run["expansions"] / said["expansions"] for run, said in both]),
            "cost": mean([run["cost"] / said["cost"] for run, said in both]),
            "cost_to_best": mean([run["cost"] / best[seed] for seed, run in solved.items()]),
            "start_to_best": mean(
                [run["start"] / best[seed] for seed, run in by_name[name].items() if np.isfinite(best[seed])]
            ),
            "cpu_seconds": mean([run["seconds"] for run in solved.values()]),
        }
    return result


def mean(values: list[float]) -> float | None:
    return round(float(np.mean(values)), 4) if values else None


if __name__ == "__main__":
    main()
