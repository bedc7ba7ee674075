"""Plans between random poses on scans of real places: motions that pass their check, or causes that the map bears out.

    python -m benchmarks.real_places [--pairs 20] [--seed 0] [--time 30] [--weight 1.25] [--heuristic manual]
                                     [--only plane_seg_ori_stairs,...] [--page docs/your-map.md]

Each scan in conf/scans becomes a map. Random poses on known ground that the robot can leave (`Planner.can_leave`) make
pairs of start and goal. The causes of an answer without a plan are checked on the map with plain code
(`tests/planning/cause_check.py`).

The last line is JSON, with one entry for each scan:

- `moved`: pairs with a plan that becomes a motion, and passes the motion's own check;
- `caused`: pairs without a plan whose causes are all there on the map, and at least one is named;
- `undecided`: pairs without a plan and without a cause, at the end of the time;
- `wrong`: all other pairs;
- `known`: share of known cells.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from benchmarks.page import table, write_block
from hdsp.base.errors import InputError, RefinementError
from hdsp.detailed.search.outcome import Status
from hdsp.planning.answers.plans import Plan
from hdsp.planning.planner import Planner
from hdsp.terrain.scans import build_map, find_files, load_scan
from tests.planning.cause_check import complaints, gap_complaints

SCANS = Path(__file__).parents[1] / "conf/scans"
ENDS = "moved", "caused", "undecided", "wrong"
_MOST_TRIALS = 100_000  # poses


def main(argv=None) -> dict:
    names = sorted(path.stem for path in SCANS.glob("*.yaml") if path.stem != "default")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=20, help="pairs of poses on each map")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--time", type=float, default=30.0, help="s for one plan")
    parser.add_argument("--weight", type=float, default=1.25)
    parser.add_argument("--heuristic", default="manual")
    parser.add_argument("--only", help="scans, separated by commas")
    parser.add_argument("--page", type=Path, help="docs page to update")
    arguments = parser.parse_args(argv)
    chosen = arguments.only.split(",") if arguments.only else names
    if unknown := [name for name in chosen if name not in names]:
        raise InputError(f"--only {unknown[0]}: need some of {', '.join(names)}")
    result: dict = {"pairs": arguments.pairs, "weight": arguments.weight, "places": {}}
    for name in chosen:
        scan = load_scan(SCANS / f"{name}.yaml")
        paths, reason = find_files(scan)
        if not paths:
            raise InputError(reason)
        planner = Planner(build_map(scan, paths), heuristic=arguments.heuristic)
        poses = poses_to_leave(planner, 2 * arguments.pairs, arguments.seed)
        counts = dict.fromkeys(ENDS, 0)
        for start, goal in zip(poses[::2], poses[1::2], strict=True):
            plan = planner.plan(start, goal, weight=arguments.weight, time=arguments.time, refinable=True)
            end = end_of(plan)
            counts[end] += 1
            if end in ("undecided", "wrong"):
                print(f"{name}, from {start} to {goal}: {end}, {plan.status}", file=sys.stderr, flush=True)
        known = float(np.isfinite(planner.terrain.heights).mean())
        result["places"][name] = counts | {"known": round(known, 4)}
        print(f"{name}: {result['places'][name]}", file=sys.stderr, flush=True)
    result |= {end: sum(place[end] for place in result["places"].values()) for end in ENDS}
    if arguments.page:
        write_block(arguments.page, "benchmarks.real_places", _page(result))
    print(json.dumps(result))
    return result


def poses_to_leave(planner: Planner, count: int, seed: int) -> list[tuple[float, float, float]]:
    """Random poses (x, y, theta) on known ground from which the robot gets away.

    Raises:
        InputError: the map has too few.
    """
    terrain, rng = planner.terrain, np.random.default_rng(seed)
    known = np.argwhere(np.isfinite(terrain.heights))
    found: list[tuple[float, float, float]] = []
    for _ in range(_MOST_TRIALS):
        x, y = np.array(terrain.origin) + (known[rng.integers(len(known))] + 0.5) * terrain.resolution
        pose = float(x), float(y), float(rng.uniform(-np.pi, np.pi))
        if planner.can_leave(pose):
            found.append(pose)
        if len(found) == count:
            return found
    raise InputError(f"{len(found)} of {_MOST_TRIALS} random poses can be left; need {count}")


def end_of(plan: Plan) -> str:
    """One of ``ENDS``."""
    if plan.solved:
        try:
            return "wrong" if plan.refine().check() else "moved"
        except RefinementError:
            return "wrong"
    gap = plan.findings.gap
    false = [words for cause in plan.causes for words in complaints(cause, plan.terrain, plan.robot)]
    if false or (gap is not None and gap_complaints(gap)):
        return "wrong"
    if plan.causes:
        return "caused"
    return "undecided" if plan.status == Status.TIME_LIMIT else "wrong"


def _page(result: dict) -> str:
    rows = [
        [name.replace("_", " "), f"{place['known']:.0%}", *(place[end] for end in ENDS)]
        for name, place in result["places"].items()
    ]
    head = ["place", "known", "motion", "cause, verified", "undecided", "wrong"]
    return f"{table(head, rows)}\n\n{result['pairs']} pairs of poses in each place, at W = {result['weight']:g}."


if __name__ == "__main__":
    main()
