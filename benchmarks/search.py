"""Detailed search speed on a 10 x 10 m map: expansions per second, bytes per state, ratio to the textbook twin.

    python -m benchmarks.search [--size 10] [--expansions 500000] [--repeats 3] [--seed 0] [--large [30000000]]
                                [--before REVISION]

Geometric heuristic, W = 1, one core. The last line is JSON. `expansions_per_s` comes from the fastest of `repeats`
runs. `bytes_per_state` is the search's whole memory at its end per seen state: states, directory, hash table, open
list, and reserve for growth; `bytes_per_state_open_list` is the open list's part. `ratio_to_twin` compares the time per
expansion with plain Python (tests/naive.py) on the same map and start.

With `--large`, one search with 30 million expansions (or as many as asked) adds `rate_30m`, in million expansions per
processor second, and `bytes_per_state` is from this search: most of its states have feet off neutral and lie in the
hash table. `--before` runs the same search with another revision of this repository, each in its own process, and adds
`before_over_now`, the ratio of their processor times.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from hdsp.base.errors import InputError
from hdsp.detailed.search.estimate import geometric_estimate
from hdsp.detailed.search.outcome import Limits, Status
from hdsp.detailed.search.weighted_astar import solve
from hdsp.planning.planner import Planner
from hdsp.robot.lattice import HEADINGS
from hdsp.terrain.random_arenas import random_arena
from tests.naive import Naive, dijkstra

LARGE = 30_000_000  # expansions


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=float, default=10.0, help="side of the map, m")
    parser.add_argument("--expansions", type=int, default=500_000)
    parser.add_argument("--twin-expansions", type=int, default=1000)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--large", type=int, nargs="?", const=LARGE, help="a large search too: a minute and 0.6 GB")
    parser.add_argument("--before", metavar="REVISION", help="git revision to compare the large search with")
    parser.add_argument("--only-large", action="store_true", help="only the large search")
    arguments = parser.parse_args(argv)

    planner = Planner(random_arena(arguments.seed, arguments.size))
    start, goal = far_apart(planner, arguments.seed)
    view = geometric_estimate(planner.world, goal)

    def run(expansions):
        return solve(planner.world, start, goal, view, limits=Limits(expansions=expansions), paths=False)

    run(1000)  # compile
    if arguments.only_large:
        result = _large(run, arguments.large or LARGE)
        print(json.dumps(result))
        return result
    # The expansion limit ends each search; the time for store growth counts.
    results = [run(arguments.expansions) for _ in range(arguments.repeats)]
    best = min(results, key=lambda result: result.seconds / result.expansions)

    twin = Naive(planner.terrain.heights, planner.robot)
    twin_start = tuple(start.tolist())
    dijkstra(twin, twin_start, most=arguments.twin_expansions)  # fills the twin's terrain cache, unmeasured
    began = time.perf_counter()
    settled = len(dijkstra(twin, twin_start, most=arguments.twin_expansions).cost)
    twin_seconds = (time.perf_counter() - began) / settled

    result = {
        "map_cells": list(planner.terrain.shape),
        "expansions": best.expansions,
        "seen": best.seen,
        "status": str(best.status[0]),
        "seconds": round(best.seconds, 3),
        "expansions_per_s": round(best.expansions / best.seconds),
        "bytes_per_state": round(best.memory / best.seen, 1),
        "bytes_per_state_open_list": round(best.open_memory / best.seen, 1),
        "twin_expansions_per_s": round(1 / twin_seconds),
        "ratio_to_twin": round(twin_seconds * best.expansions / best.seconds),
    }
    if arguments.large:
        result |= _large(run, arguments.large)
        if arguments.before is not None:
            before, now = (_rate_at(revision, arguments) for revision in (arguments.before, None))
            result["before_over_now"] = round(now / before, 2)
    print(json.dumps(result))
    return result


def _large(run, expansions: int) -> dict:
    """Speed and memory of one search."""
    began = time.process_time()
    result = run(expansions)
    rate = result.expansions / (time.process_time() - began)
    return {"rate_30m": round(1e-6 * rate, 3), "bytes_per_state": round(result.memory / result.seen, 1)}


def _rate_at(revision: str | None, arguments: argparse.Namespace) -> float:
    """Speed of the large search with the code of a git revision, None = the working tree."""
    here = Path(__file__).resolve().parents[1]
    if revision is None:
        return _rate_in(here, arguments)
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        subprocess.run(["git", "-C", here, "worktree", "add", "--detach", tree, revision], check=True)
        try:
            return _rate_in(tree, arguments)
        finally:
            subprocess.run(["git", "-C", here, "worktree", "remove", "--force", tree], check=True)


def _rate_in(tree: Path, arguments: argparse.Namespace) -> float:
    task = ["--size", arguments.size, "--seed", arguments.seed, "--large", arguments.large, "--only-large"]
    command = [sys.executable, __file__, *(str(word) for word in task)]
    environment = os.environ | {"PYTHONPATH": str(tree)}
    output = subprocess.run(command, env=environment, cwd=tree, check=True, stdout=subprocess.PIPE, text=True).stdout
    return json.loads(output.splitlines()[-1])["rate_30m"]


def far_apart(planner: Planner, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns two distant valid states on neutral feet, int64 [7] each; the first is not locked in."""
    rng = np.random.default_rng(seed)
    states = []
    while len(states) < 40:
        state = np.array([*rng.integers((0, 0), planner.terrain.shape), rng.integers(HEADINGS), 0, 0, 0, 0])
        if planner.valid(planner.grid.to_world(state)):
            states.append(state)
    at = np.array(states)[:, :2]
    distance = np.hypot(*np.moveaxis(at[:, None] - at[None], -1, 0))
    for pair in np.argsort(-distance, axis=None):
        start, goal = (states[i] for i in np.unravel_index(pair, distance.shape))
        view = geometric_estimate(planner.world, goal)
        tried = solve(planner.world, start, goal, view, limits=Limits(expansions=5000), paths=False)
        if tried.status == [Status.EXPANSION_LIMIT]:
            return start, goal
    raise InputError(f"seed {seed}: every start on this map is locked in")


if __name__ == "__main__":
    main()
