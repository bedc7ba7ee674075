"""Plans on tilted planes, up to the robot's limit and beyond.

    python -m benchmarks.slopes [--goals 30] [--seed 0] [--robot momaro] [--heuristic manual] [--weight 1.5]

A map of 6 x 6 m is one plane. Its tilt is 0, 5, 8, 10, 12 and 15 degrees, the robot's limit (the smaller of
``slope.max_pitch`` and ``slope.max_roll``), and 2 degrees beyond the limit. Larger tilts than the limit count as
beyond. Each tilt comes in eight directions. On each plane, the robot plans from one start to the same random goals with
random headings.

The last line is JSON:

- `reached`: share of goals reached, for each tilt in degrees;
- `beyond`: the same for tilts beyond the limit, the largest;
- `cost_at_10`: mean cost at 10 degrees over the mean cost on level ground, for the same goals;
- `most_at_10`: the largest ratio for one goal;
- `unrefined`: number of plans without a motion that passes its check.
"""

import argparse
import json
import math
import sys
import time

import numpy as np

from hdsp.base.errors import InputError, RefinementError
from hdsp.planning.planner import Planner
from hdsp.robot.lattice import Grid
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap

SIZE, MARGIN = 240, 0.6  # cells; m between goals and the border
START = (1.2, 3.0, 0.0)
TILTS = (0.0, 5.0, 8.0, 10.0, 12.0, 15.0)  # degrees
DIRECTIONS = tuple(math.radians(45.0 * k) for k in range(8))
BEYOND = 2.0  # degrees


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--goals", type=int, default=30, help="goals on each plane")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robot", default="momaro", help="preset or YAML file")
    parser.add_argument("--heuristic", default="manual")
    parser.add_argument("--weight", type=float, default=1.5)
    parser.add_argument("--refine", action=argparse.BooleanOptionalAction, default=True, help="also make the motions")
    arguments = parser.parse_args(argv)
    if arguments.goals < 1:
        raise InputError(f"--goals is {arguments.goals}; need at least 1")
    robot = Robot.load(arguments.robot)
    limit = math.degrees(min(robot.slope.max_pitch, robot.slope.max_roll))
    goals = random_goals(arguments.goals, arguments.seed)
    costs: dict[float, np.ndarray] = {}
    unrefined = 0
    for tilt in sorted({*TILTS, limit, limit + BEYOND}):
        began = time.perf_counter()
        found = []
        for direction in DIRECTIONS if tilt else DIRECTIONS[:1]:
            planner = Planner(plane(tilt, direction), robot, arguments.heuristic)
            plans = [planner.plan(START, goal, weight=arguments.weight) for goal in goals]
            found.append([plan.cost if plan.solved else math.inf for plan in plans])
            if arguments.refine:
                unrefined += sum(plan.solved and not carried_out(plan) for plan in plans)
        costs[tilt] = np.array(found)
        share, seconds = np.isfinite(costs[tilt]).mean(), time.perf_counter() - began
        print(f"{tilt:.2f} degrees: {share:.3f} reached, {seconds:.0f} s", file=sys.stderr, flush=True)
    reached = {f"{tilt:.6g}": float(np.isfinite(cost).mean()) for tilt, cost in costs.items() if tilt <= limit}
    above = [np.isfinite(cost).mean() for tilt, cost in costs.items() if tilt > limit]
    ratios = costs[10.0] / costs[0.0]
    both = np.isfinite(ratios)
    result = {
        "robot": robot.name,
        "limit": round(limit, 4),
        "goals": arguments.goals,
        "reached": reached,
        "beyond": float(np.max(above)),
        "cost_at_10": _rounded(costs[10.0][both].sum() / np.broadcast_to(costs[0.0], both.shape)[both].sum()),
        "most_at_10": _rounded(ratios[both].max(initial=0.0)),
        "unrefined": unrefined if arguments.refine else None,
    }
    print(json.dumps(result))
    return result


def plane(tilt: float, direction: float) -> HeightMap:
    """Plane that rises by ``tilt`` (degrees) toward ``direction`` (rad), 6 x 6 m from (0, 0)."""
    centers = Grid((0.0, 0.0), (SIZE, SIZE)).center(np.moveaxis(np.indices((SIZE, SIZE)), 0, -1))
    uphill = np.array([math.cos(direction), math.sin(direction)])
    return HeightMap((math.tan(math.radians(tilt)) * centers @ uphill).astype(np.float32))


def random_goals(count: int, seed: int) -> list[tuple[float, float, float]]:
    """Random poses (m, m, rad) on the map."""
    random = np.random.default_rng(seed)
    largest = SIZE * 0.025 - MARGIN
    places = random.uniform(MARGIN, largest, (count, 2))
    headings = random.uniform(-math.pi, math.pi, count).tolist()
    return [(x, y, heading) for (x, y), heading in zip(places.tolist(), headings, strict=True)]


def carried_out(plan) -> bool:
    """Whether a plan becomes a motion whose check finds no problem."""
    try:
        return not plan.refine().check()
    except RefinementError as error:
        print(error, file=sys.stderr, flush=True)
        return False


def _rounded(number: float) -> float | None:
    return round(float(number), 4) if np.isfinite(number) else None


if __name__ == "__main__":
    main()
