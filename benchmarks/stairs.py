"""Real stairs: shares of random staircases that the robot climbs, proves impossible, or leaves undecided.

    python -m benchmarks.stairs [--count 200] [--seed 0] [--robot momaro] [--heuristic manual] [--weight 1.25]
                                [--page docs/climbing.md]

Rise 0.15 to 0.20 m, tread 0.25 to 0.32 m, flights of 2, 3, 4 and 8 steps, up and down. Every second task is straight;
in the others, staircase, start and goal are turned by up to 15 degrees each. Stairs fill the whole width of the map,
and a task leads from the floor before them to the landing behind them, or back. The robot faces the direction of
travel.

One JSON line comes last. `climbed` is the share of tasks with a plan that the robot can carry out, `proved` the share
with status `infeasible` and without refused steps, `undecided` the rest. `climbed_of_easy` counts rises up to 0.18 m
with treads from 0.28 m on. `refined` is the share of climbed tasks whose motion passes its own check; `refused` counts
tasks with steps that could not be carried out. `reasons` counts the explanations of tasks without a plan, without their
numbers. `--page` writes a table into the page.
"""

import argparse
import json
import math
import re
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.page import table, write_block
from hdsp.base.errors import RefinementError
from hdsp.detailed.search.outcome import Status
from hdsp.planning.answers.plans import Plan
from hdsp.planning.planner import Planner
from hdsp.robot.lattice import cells, metres, rotation
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.obstacles import Scene, Staircase

STEPS = 2, 3, 4, 8
RISE, TREAD = (0.15, 0.2), (0.25, 0.32)  # m
EASY_RISE, EASY_TREAD = 0.18, 0.28  # m
ANGLE = math.radians(15)
AWAY = 0.95  # m, from the base to the first and the last riser: all feet stand before or behind the stairs
ENDS = "climbed", "proved", "undecided"
_SIDE, _END = 1.2, 0.75  # m, of the map beside and beyond start and goal
_ASIDE = 0.1  # m, largest lateral offset of the start
_FAR = 20.0  # m, beyond every map


class Task(NamedTuple):
    """A staircase and the way over it; lengths in m, angles in rad, relative to the direction of travel."""

    steps: int
    rise: float
    tread: float
    up: bool
    yaw: float  # direction of ascent in the map
    start_turn: float
    goal_turn: float
    aside: float  # of the start, to the left
    phase: float  # of the first riser, along the ascent: its place in a cell of the map

    @property
    def straight(self) -> bool:
        return self.yaw == self.start_turn == self.goal_turn == 0

    @property
    def easy(self) -> bool:
        return self.rise <= EASY_RISE and self.tread >= EASY_TREAD

    def run(self) -> float:
        """Distance from the first to the last riser."""
        return (self.steps - 1) * self.tread

    def terrain(self) -> HeightMap:
        """The staircase with floor and landing; the first riser is at the origin of the world, except for its phase."""
        ends = (-AWAY - _END, self.run() + AWAY + _END)
        corners = np.array([(x, y) for x in ends for y in (-_SIDE, _SIDE)]) @ rotation(self.yaw).T
        low, high = corners.min(axis=0), corners.max(axis=0)
        shape, centre = np.ceil(cells(high - low)).astype(int), np.floor(cells(-low)).astype(int)
        x, y = (float(v) for v in rotation(self.yaw) @ (self.phase, 0.0))
        stairs = Staircase(x, y, self.yaw, self.steps, self.rise, self.tread, width=_FAR, depth=_FAR)
        return Scene((stairs,)).rasterise(tuple(shape.tolist()), tuple(centre.tolist()))

    def poses(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """World poses (x, y, theta) at start and goal."""
        below, above = -AWAY, self.run() + AWAY
        first, last = (below, above) if self.up else (above, below)
        theta = self.yaw if self.up else self.yaw + math.pi
        return self._pose(first, self.aside, theta + self.start_turn), self._pose(last, 0.0, theta + self.goal_turn)

    def _pose(self, along: float, left: float, theta: float) -> tuple[float, float, float]:
        x, y = rotation(self.yaw) @ (along, left)
        return float(x), float(y), theta


def random_tasks(seed: int, count: int) -> Iterator[Task]:
    """Yields random tasks; a task depends on seed and number alone."""
    for number in range(count):
        rng = np.random.default_rng((seed, number))
        angles = rng.uniform(-ANGLE, ANGLE, 3) if number % 2 else np.zeros(3)
        yield Task(
            steps=int(rng.choice(STEPS)),
            rise=float(rng.uniform(*RISE)),
            tread=float(rng.uniform(*TREAD)),
            up=bool(rng.random() < 0.5),
            yaw=float(angles[0]),
            start_turn=float(angles[1]),
            goal_turn=float(angles[2]),
            aside=float(rng.uniform(-_ASIDE, _ASIDE)),
            phase=float(rng.uniform(0, metres(1.0))),
        )


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robot", default="momaro", help="preset or YAML file")
    parser.add_argument("--heuristic", default="manual")
    parser.add_argument("--weight", type=float, default=1.25)
    parser.add_argument("--expansions", type=int, default=20_000_000)
    parser.add_argument("--page", type=Path, help="docs page to update")
    arguments = parser.parse_args(argv)
    robot = Robot.load(arguments.robot)
    ends: dict[str, list[str]] = {name: [] for name in ("all", "easy", "up", "down", "straight", "angled")}
    reasons: Counter = Counter()
    seconds, expansions, refined, refused = [], [], 0, 0
    for number, task in enumerate(random_tasks(arguments.seed, arguments.count)):
        plan, took = solve(task, robot, arguments.heuristic, arguments.weight, arguments.expansions)
        end = end_of(plan)
        groups = ["all", "up" if task.up else "down", "straight" if task.straight else "angled"]
        for group in groups + ["easy"] * task.easy:
            ends[group].append(end)
        seconds.append(took)
        expansions.append(plan.stats.expansions)
        refused += bool(plan.refused)
        refined += end == "climbed" and carried_out(plan)
        if end != "climbed":
            reasons[kind_of(plan.explain())] += 1
        print(
            f"{number + 1:4d}/{arguments.count} {end:9s} {task.steps} steps {'up' if task.up else 'down':4s} "
            f"rise {task.rise:.3f} tread {task.tread:.3f} yaw {math.degrees(task.yaw):+5.1f}  "
            f"{plan.stats.expansions:9,d} expansions {took:6.2f} s" + ("" if plan.solved else f"  {plan.explain()}"),
            flush=True,
        )
    climbed = ends["all"].count("climbed")
    result = {
        "staircases": len(ends["all"]),
        "climbed": share(ends["all"], "climbed"),
        "proved": share(ends["all"], "proved"),
        "undecided": share(ends["all"], "undecided"),
        "climbed_of_easy": share(ends["easy"], "climbed"),
        "refined": refined / climbed if climbed else None,
        "refused": refused,
        "groups": {
            group: {"staircases": len(ends[group]), **{end: share(ends[group], end) for end in ENDS}} for group in ends
        },
        "reasons": dict(reasons.most_common()),
        "median_seconds": round(float(np.median(seconds)), 2),
        "most_seconds": round(max(seconds), 2),
        "most_expansions": max(expansions),
    }
    if arguments.page:
        write_block(arguments.page, "benchmarks.stairs", text(result))
    print(json.dumps(result))
    return result


def text(result: dict) -> str:
    """Formats the result for the page."""
    names = {"easy": f"rise up to {EASY_RISE:g} m, tread from {EASY_TREAD:g} m"}
    rows = [[names.get(group, group), *shares.values()] for group, shares in result["groups"].items()]
    return table(["staircases", "number", *ENDS], rows)


def solve(task: Task, robot: Robot, heuristic: str, weight: float, expansions: int) -> tuple[Plan, float]:
    """Plans a task and carries it out; returns the plan and seconds, with the preparation of the map."""
    began = time.perf_counter()
    start, goal = task.poses()
    plan = Planner(task.terrain(), robot, heuristic).plan(
        start, goal, weight=weight, refinable=True, expansions=expansions
    )
    return plan, time.perf_counter() - began


def end_of(plan: Plan) -> str:
    """How a query ended: ``climbed``, ``proved`` or ``undecided``; after refused steps, nothing is proved."""
    if plan.solved:
        return "climbed"
    proofs = Status.INFEASIBLE, Status.INVALID_START, Status.INVALID_GOAL
    return "proved" if plan.status in proofs and not plan.refused else "undecided"


def carried_out(plan: Plan) -> bool:
    """Whether the motion after the plan exists and passes its own check."""
    try:
        return not plan.refine().check()
    except RefinementError:
        return False


def kind_of(words: str) -> str:
    """An explanation without its numbers."""
    return re.sub(r"-?\d[\d.,]*", "*", words)


def share(ends: list[str], end: str) -> float | None:
    return round(ends.count(end) / len(ends), 4) if ends else None


if __name__ == "__main__":
    main()
