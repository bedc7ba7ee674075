"""Overestimation by inadmissible heuristics: h / h* over exact h*.

    python -m benchmarks.inadmissibility [--seeds 6] [--size 5] [--pairs 60] [--near 0.3] [--far 2.0]
                                         [--guides manual learned] [--json FILE] [--page docs/guarantees.md]

Pairs are random valid states on random arenas, `near` to `far` metres apart. A* (W = 1, geometric heuristic) finds the
least cost between them; pairs unsolved within `expansions` are left out and counted. Every state on an optimal path
also has an exact cost-to-go, the cost of the remaining path. Up to `suffixes` such states per pair count, spread over
the first part of the path, where the cost-to-go is at least `least`. The last line is JSON: for each heuristic,
quantiles of h / h*, the largest ratio, and the share above 1. `--page` writes these figures into the page, and the
distributions into figures/inadmissibility.png beside it.
"""

import argparse
import json
from pathlib import Path

import numpy as np

from benchmarks.page import shown, table, write_block
from hdsp.detailed.search.estimate import geometric_estimate
from hdsp.detailed.search.outcome import Limits, Status
from hdsp.detailed.search.weighted_astar import solve
from hdsp.planning.planner import Planner
from hdsp.robot.lattice import HEADINGS, cells
from hdsp.terrain.random_arenas import random_arena

QUANTILES = 0.5, 0.9, 0.95, 0.99


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=6, help="number of random arenas")
    parser.add_argument("--size", type=float, default=5.0, help="side of the arenas, m")
    parser.add_argument("--pairs", type=int, default=60, help="pairs per arena")
    parser.add_argument("--near", type=float, default=0.3, help="least distance of a pair, m")
    parser.add_argument("--far", type=float, default=2.0, help="largest distance of a pair, m")
    parser.add_argument("--suffixes", type=int, default=8, help="largest number of counted states per path")
    parser.add_argument("--least", type=float, default=0.1, help="least cost-to-go of counted states")
    parser.add_argument("--expansions", type=int, default=300_000, help="limit of each search")
    parser.add_argument("--guides", nargs="+", default=["manual", "learned"], help="heuristics, as Planner takes them")
    parser.add_argument("--json", type=Path, help="output file for the result")
    parser.add_argument("--page", type=Path, help="docs page to update")
    arguments = parser.parse_args(argv)

    names = ["geometric", *arguments.guides]
    ratios: dict[str, list[np.ndarray]] = {}
    solved = tried = 0
    for seed in range(arguments.seeds):
        terrain = random_arena(seed, arguments.size)
        planners = [Planner(terrain, heuristic=name).prepare() for name in names]
        rng = np.random.default_rng(seed)
        for start, goal in pairs(planners[0], rng, arguments.pairs, arguments.near, arguments.far):
            tried += 1
            way = least_way(planners[0], start, goal, arguments)
            if way is None:
                continue
            solved += 1
            states, to_go = way
            for planner in planners:
                planner.heuristic.set_goal(goal)
                ratios.setdefault(planner.heuristic.name, []).append(planner.heuristic(states) / to_go)
        print(f"arena {seed}: {solved} of {tried} pairs solved so far", flush=True)
    every = {name: np.concatenate(parts) for name, parts in ratios.items()}
    first = {name: np.array([part[0] for part in parts]) for name, parts in ratios.items()}
    result = {
        "arenas": arguments.seeds,
        "pairs_tried": tried,
        "pairs_solved": solved,
        "heuristics": {name: {"pairs": scores(first[name]), "with_ways": scores(every[name])} for name in every},
    }
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=1) + "\n")
    if arguments.page:
        write_block(arguments.page, "benchmarks.inadmissibility", text(result))
        draw(every, arguments.page.parent / "figures" / "inadmissibility.png")
    print(json.dumps(result))
    return result


def pairs(planner: Planner, rng, count: int, near: float, far: float):
    """Yields random valid states on neutral feet, start and goal, ``near`` to ``far`` metres apart."""
    grid, shape = planner.grid, planner.terrain.shape
    found = 0
    while found < count:
        goal = np.array([*rng.integers((0, 0), shape), rng.integers(HEADINGS), 0, 0, 0, 0])
        distance, way = cells(rng.uniform(near, far)), rng.uniform(0, 2 * np.pi)
        base = goal[:2] + np.rint(distance * np.array([np.cos(way), np.sin(way)])).astype(int)
        if not ((base >= 0) & (base < shape)).all():
            continue
        start = np.array([*base, rng.integers(HEADINGS), 0, 0, 0, 0])
        if planner.valid(grid.to_world(goal)) and planner.valid(grid.to_world(start)):
            found += 1
            yield start, goal


def least_way(planner: Planner, start, goal, arguments) -> tuple[np.ndarray, np.ndarray] | None:
    """States on an optimal path, the start first, and their costs-to-go; None if no path was found."""
    view, limits = geometric_estimate(planner.world, goal), Limits(expansions=arguments.expansions)
    result = solve(planner.world, start, goal[None], view, limits=limits)
    if result.status[0] != Status.SOLVED:
        return None
    return spread(result.paths[0].states, result.paths[0].costs, arguments.suffixes, arguments.least)


def spread(states: np.ndarray, edge_costs: np.ndarray, suffixes: int, least: float):
    """Counted states on an optimal path, as in ``least_way``; None if the whole path costs less than ``least``."""
    to_go = edge_costs[::-1].cumsum()[::-1]
    enough = int((to_go >= least).sum())
    if enough == 0:
        return None
    chosen = np.unique(np.linspace(0, enough - 1, min(enough, 1 + suffixes)).astype(int))
    return states[:-1][chosen], to_go[chosen]


def scores(ratios: np.ndarray) -> dict:
    # Costs-to-go are sums in double precision; heuristic tables have single precision.
    above = float((ratios > 1 + 1e-5).mean())
    values = {f"q{100 * q:g}": round(float(np.quantile(ratios, q)), 3) for q in QUANTILES}
    return {"n": len(ratios), **values, "max": round(float(ratios.max()), 3), "above_1": round(above, 4)}


def text(result: dict) -> str:
    """Formats the result for the page."""
    rows = []
    for name, found in result["heuristics"].items():
        for kind, label in (("pairs", "random pairs"), ("with_ways", "with states on their paths")):
            row = found[kind]
            quantiles = [row[f"q{100 * q:g}"] for q in QUANTILES]
            rows.append([shown(name), label, row["n"], *quantiles, row["max"], f"{row['above_1']:.1%}"])
    head = ["heuristic", "states", "number", *(f"{q:.0%}" for q in QUANTILES), "largest", "above 1"]
    counted = f"{result['pairs_solved']} of {result['pairs_tried']} pairs solved, {result['arenas']} random arenas."
    return f"{table(head, rows)}\n\n{counted}"


def draw(ratios: dict[str, np.ndarray], path: Path) -> None:
    """Draws the cumulative distribution of h / h* over states."""
    from hdsp.viz import style

    figure = style.figure(5.2, 3.0)
    axes = figure.add_subplot()
    for name, values in ratios.items():
        ordered = np.sort(values)
        shares = np.arange(1, len(ordered) + 1) / len(ordered)
        axes.plot(ordered, shares, color=style.METHODS[shown(name)], label=style.NAMES[shown(name)])
    axes.axvline(1, color=style.GREY, linewidth=0.8)
    axes.set_xlabel("h / h*: estimate / exact cost to go (right of the line: too much)")
    axes.set_ylabel("share of states")
    axes.set_xlim(0.5, 2)  # a few lie beyond
    axes.set_ylim(0, 1)
    axes.legend(frameon=False, loc="lower right")
    style.save(figure, path)


if __name__ == "__main__":
    main()
