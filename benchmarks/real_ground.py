"""Planning on maps as robots measure them: noise, unknown cells, spikes and coarse cells over known scenes.

    python -m benchmarks.real_ground [--count 40] [--seed 0] [--robot momaro] [--heuristic manual] [--weight 1.25]
                                     [--only white_1cm,cells_5cm] [--page docs/your-map.md]

Each task is a scene with a plan on its exact map: level floor, a kerb of 0.15 m, a door, stairs of 0.16 / 0.30 m, or a
ramp; position, direction and poses are random. Every disturbance is applied to the map of every task. The planner
conditions the disturbed map (`hdsp.terrain.conditioned`) and plans. The plan is then tested against the exact scene
(`hdsp.planning.check_plan`).

The last line is JSON, with one entry for each disturbance:

- `solved`: share of the tasks with a plan;
- `cost`: mean ratio between the cost of the plan and the cost on the exact map;
- `most`: largest ratio;
- `stepped`: share of the plans over a kerb or stairs that make a step;
- `false`: number of plans that collide with the exact scene by more than 0.02 m.

`false` beside them is the sum. `conditioning_10x10` is the CPU time in s for the conditioning of a map of 10 x 10 m
with noise, spikes and unknown cells, in cells of 0.025 m; `conditioning_1m2` is the time after a change of 1 m2 in it.
"""

import argparse
import json
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.page import table, write_block
from hdsp.base.errors import InputError
from hdsp.planning.answers.plans import Plan
from hdsp.planning.collisions import check_plan
from hdsp.planning.planner import Planner
from hdsp.robot.robot import Robot
from hdsp.terrain.arenas import Arena
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.obstacles import Bank, Block, Scene, Staircase

SIDE = 6.0  # m
MIDDLE = SIDE / 2
KINDS = "flat", "kerb", "door", "stairs", "ramp"
KERB, RISE, TREAD, STEPS = 0.15, 0.16, 0.30, 3  # m, m, m
TOLERANCE = 0.02  # m
STEPPING = "kerb", "stairs"
_FAR = 12.0  # m, larger than the map


class Task(NamedTuple):
    """A scene with start and goal pose (x, y, theta), m and rad."""

    kind: str
    arena: Arena
    start: tuple[float, float, float]
    goal: tuple[float, float, float]


def random_task(seed: int, number: int) -> Task:
    """Makes a task; it depends on seed and number alone. The way leads from one side of the map to the other."""
    rng = np.random.default_rng((seed, number))
    kind = KINDS[number % len(KINDS)]
    yaw = float(rng.uniform(-0.2, 0.2))
    ahead, left = np.array([math.cos(yaw), math.sin(yaw)]), np.array([-math.sin(yaw), math.cos(yaw)])

    def place(along: float, aside: float = 0.0) -> tuple[float, float]:
        x, y = MIDDLE + along * ahead + aside * left
        return float(x), float(y)

    phase = float(rng.uniform(-0.05, 0.05))
    obstacles: tuple = ()
    if kind == "kerb":
        x, y = place(phase + _FAR / 2)
        obstacles = (Block(x, y, yaw, _FAR, _FAR, KERB),)
    elif kind == "door":
        thick, gap, at = rng.uniform(0.1, 0.3), rng.uniform(0.95, 1.2), rng.uniform(-0.5, 0.5)
        walls = [(at + side * (gap + _FAR) / 2) for side in (-1, 1)]
        obstacles = tuple(Block(*place(phase, wall), yaw, thick, _FAR, 2.0) for wall in walls)
    elif kind == "stairs":
        x, y = place(phase - TREAD)
        obstacles = (Staircase(x, y, yaw, STEPS, RISE, TREAD, _FAR, _FAR),)
    elif kind == "ramp":
        run, slope = 2.0, math.radians(rng.uniform(5.0, 12.0))
        x, y = place(phase - run / 2 + _FAR / 2)
        obstacles = (Bank(x, y, yaw, _FAR, _FAR, run * math.tan(slope), run),)
    first, last = ((-1.6, 1.7) if rng.random() < 0.5 else (1.7, -1.6)) if kind != "stairs" else (-1.7, 1.7)
    turn = yaw if last > first else yaw + math.pi
    turns = rng.uniform(-0.3, 0.3, 2) if kind in ("flat", "door", "ramp") else np.zeros(2)
    asides = rng.uniform(-0.6, 0.6, 2) if kind in ("flat", "door", "ramp") else np.zeros(2)
    ends = [
        (*place(along, float(aside)), math.remainder(turn + float(bend), 2 * math.pi))
        for along, aside, bend in zip((first, last), asides, turns, strict=True)
    ]
    return Task(kind, Arena(SIDE, Scene(obstacles)), ends[0], ends[1])


Disturbance = Callable[[HeightMap, np.random.Generator], HeightMap]


def _white(sigma: float) -> Disturbance:
    return lambda terrain, rng: _with(terrain, terrain.heights + sigma * rng.standard_normal(terrain.shape))


def _smooth(sigma: float, length: float = 0.05) -> Disturbance:
    """Noise with a standard deviation ``sigma`` (m), correlated over ``length`` (m)."""
    from scipy.ndimage import gaussian_filter

    def disturbed(terrain: HeightMap, rng: np.random.Generator) -> HeightMap:
        waves = gaussian_filter(rng.standard_normal(terrain.shape), length / terrain.resolution)
        return _with(terrain, terrain.heights + sigma * waves / waves.std())

    return disturbed


def _unknown(share: float) -> Disturbance:
    return lambda terrain, rng: _with(terrain, np.where(rng.random(terrain.shape) < share, np.nan, terrain.heights))


def _spikes(share: float, highest: float = 0.5) -> Disturbance:
    def disturbed(terrain: HeightMap, rng: np.random.Generator) -> HeightMap:
        hit = rng.random(terrain.shape) < share
        return _with(terrain, terrain.heights + hit * rng.uniform(-highest, highest, terrain.shape))

    return disturbed


def _coarse(cells: int) -> Disturbance:
    """Cells ``cells`` times as large, each with the mean height."""

    def disturbed(terrain: HeightMap, rng: np.random.Generator) -> HeightMap:
        nx, ny = (count // cells for count in terrain.shape)
        blocks = terrain.heights[: nx * cells, : ny * cells].reshape(nx, cells, ny, cells)
        return HeightMap(blocks.mean(axis=(1, 3)), terrain.origin, terrain.resolution * cells)

    return disturbed


def _together(*parts: Disturbance) -> Disturbance:
    def disturbed(terrain: HeightMap, rng: np.random.Generator) -> HeightMap:
        for part in parts:
            terrain = part(terrain, rng)
        return terrain

    return disturbed


def _with(terrain: HeightMap, heights: np.ndarray) -> HeightMap:
    return HeightMap(heights, terrain.origin, terrain.resolution)


DISTURBANCES: dict[str, Disturbance] = {
    "white_1cm": _white(0.01),
    "white_2cm": _white(0.02),
    "white_3cm": _white(0.03),
    "smooth_2cm": _smooth(0.02),
    "smooth_3cm": _smooth(0.03),
    "unknown_1%": _unknown(0.01),
    "unknown_5%": _unknown(0.05),
    "spikes_1%": _spikes(0.01),
    "cells_5cm": _coarse(2),
    "cells_10cm_kerb": _coarse(4),
    "together": _together(_coarse(2), _white(0.01), _unknown(0.02)),
}
#: Disturbances for some kinds of tasks only.
_ONLY = {"cells_10cm_kerb": ("kerb",)}


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=40, help="tasks")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robot", default="momaro", help="preset or YAML file")
    parser.add_argument("--heuristic", default="manual")
    parser.add_argument("--weight", type=float, default=1.25)
    parser.add_argument("--time", type=float, default=30.0, help="s for one plan")
    parser.add_argument("--only", help="disturbances, separated by commas")
    parser.add_argument("--page", type=Path, help="docs page to update")
    arguments = parser.parse_args(argv)
    chosen = arguments.only.split(",") if arguments.only else list(DISTURBANCES)
    if unknown := [name for name in chosen if name not in DISTURBANCES]:
        raise InputError(f"--only {unknown[0]}: need some of {', '.join(DISTURBANCES)}")
    robot = Robot.load(arguments.robot)

    def plan_on(terrain: HeightMap, task: Task) -> Plan:
        planner = Planner(terrain, robot, arguments.heuristic)
        return planner.plan(task.start, task.goal, weight=arguments.weight, time=arguments.time)

    tasks = [random_task(arguments.seed, number) for number in range(arguments.count)]
    exact = [plan_on(task.arena.height_map(), task) for task in tasks]
    unsolved = [number for number, plan in enumerate(exact) if not plan.solved]
    if unsolved:
        raise InputError(f"tasks {unsolved} have no plan on their exact map: {exact[unsolved[0]].explain()}")
    result: dict = {"robot": robot.name, "tasks": arguments.count, "weight": arguments.weight}
    for name in chosen:
        result[name] = _measured(name, tasks, exact, plan_on, arguments.seed, robot)
        print(f"{name}: {result[name]}", file=sys.stderr, flush=True)
    result["false"] = sum(result[name]["false"] for name in chosen)
    result |= _conditioning_times(arguments.seed)
    if arguments.page:
        write_block(arguments.page, "benchmarks.real_ground", _page(result, chosen))
    print(json.dumps(result))
    return result


def _measured(
    name: str,
    tasks: list[Task],
    exact: list[Plan],
    plan_on: Callable[[HeightMap, Task], Plan],
    seed: int,
    robot: Robot,
) -> dict:
    """Figures for one disturbance."""
    ratios, stepped, collided, asked = [], [], 0, 0
    for number, (task, best) in enumerate(zip(tasks, exact, strict=True)):
        if task.kind not in _ONLY.get(name, KINDS):
            continue
        asked += 1
        rng = np.random.default_rng((seed, number, list(DISTURBANCES).index(name)))
        plan = plan_on(DISTURBANCES[name](task.arena.height_map(), rng), task)
        if not plan.solved:
            print(f"{name}, task {number} ({task.kind}): {plan.explain()}", file=sys.stderr, flush=True)
            continue
        ratios.append(plan.cost / best.cost)
        if task.kind in STEPPING:
            stepped.append(plan.steps > 0)
        verdict = check_plan(task.arena, plan, robot, TOLERANCE)
        if not verdict.free:
            print(f"{name}, task {number} ({task.kind}): {verdict.collisions}", file=sys.stderr, flush=True)
            collided += 1
    return {
        "solved": round(len(ratios) / asked, 4) if asked else None,
        "cost": round(float(np.mean(ratios)), 4) if ratios else None,
        "most": round(float(np.max(ratios)), 4) if ratios else None,
        "stepped": round(float(np.mean(stepped)), 4) if stepped else None,
        "false": collided,
    }


def _conditioning_times(seed: int) -> dict[str, float]:
    """CPU times in s: a map of 10 x 10 m, and a change of 1 m2 in its middle."""
    rng = np.random.default_rng(seed)
    terrain = HeightMap.flat((400, 400))
    for part in (_smooth(0.02), _white(0.005), _spikes(0.01), _unknown(0.02)):
        terrain = part(terrain, rng)
    began = time.process_time()
    stages = terrain.stages()
    whole = time.process_time() - began
    heights = terrain.heights.copy()
    heights[180:220, 180:220] += 0.1
    began = time.process_time()
    stages.update(heights, (slice(180, 220), slice(180, 220)))
    return {"conditioning_10x10": round(whole, 3), "conditioning_1m2": round(time.process_time() - began, 4)}


def _page(result: dict, names: list[str]) -> str:
    rows = [
        [name.replace("_", " "), *(result[name][key] for key in ("solved", "cost", "most", "stepped", "false"))]
        for name in names
    ]
    head = ["disturbance", "solved", "mean cost", "largest cost", "with a step", "collide"]
    times = (
        f"Conditioning took {result['conditioning_10x10']} s of CPU time for 10 x 10 m, and "
        f"{result['conditioning_1m2']} s after a change of 1 m2."
    )
    return f"{table(head, rows)}\n\n{result['tasks']} tasks at W = {result['weight']:g}. {times}"


if __name__ == "__main__":
    main()
