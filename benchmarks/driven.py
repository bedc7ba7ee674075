"""Plans driven in physics: shares of plans along which a simulated robot arrives, by kind of ground.

    python -m benchmarks.driven [--count 20] [--seed 0] [--robot momaro] [--kinds flat,stairs,...] [--pairs 4]
                                [--folder outputs/driven] [--page docs/driving.md]

Kinds: `flat`, `stairs` (2 to 3 steps, up and down), `blocks` to step onto, `ramps` up to 2 degrees below the robot's
limit, `doors`, `clutter`, and `places`: scans of real places as height fields. Planning uses a map with 1 cm of noise
in each cell, conditioned as every measured map. The drive is on the true ground (`hdsp.planning.driving`). A task
depends on seed, kind and number alone; tasks without a plan do not count, and other tasks take their places. Each task
writes a file into the folder, so an interrupted run continues; results of other code need another folder.

One JSON line comes last. `driven` is the share of tasks, by kind, whose robot arrives within 10 cm and 10 degrees,
without a fall, without contact of the body, and without more than 5 cm slip of a standing foot; `all` is their mean
over all tasks. `causes` counts the ends of the other drives. `realtime` is simulated time over CPU time on one core.
`rank_correlation` compares cost and energy over pairs of ways between the same poses: concordant minus discordant
pairs, over all pairs (`pairs`). `--page` writes a table into the page, and its picture beside it.
"""

import argparse
import json
import math
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.page import table, write_block
from benchmarks.real_places import SCANS, poses_to_leave
from hdsp.base.errors import InputError, RefinementError
from hdsp.base.files import replacing
from hdsp.planning.answers.plans import Plan
from hdsp.planning.planner import Planner
from hdsp.robot.lattice import Grid, cells
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.obstacles import Block, Obstacle, Ramp, Scene, Staircase

NOISE = 0.01  # m
KINDS = "flat", "stairs", "blocks", "ramps", "doors", "clutter", "places"
PLACES = "octomap_courtyard_stairs", "pcl_room_scan", "plane_seg_terrain_med", "rsl_real_stairs"
SIZE = 6.0, 3.0  # m, of made ground
BELOW = math.radians(2)
_EXPANSIONS = 1_500_000
_NEAR = 3.0  # m, largest distance of a goal in a real place
_DIFFERS = 1.03  # ratio of costs from which two ways are a pair
Pose = tuple[float, float, float | None]


class Task(NamedTuple):
    """Ground to plan on, ground to drive on, start and goal."""

    map: HeightMap
    truth: HeightMap | Scene
    start: Pose
    goal: Pose


def made_task(kind: str, seed: int, number: int, robot: Robot) -> Task:
    """Returns a task on made ground; the robot drives along x, in a corridor or around obstacles."""
    random = np.random.default_rng((seed, KINDS.index(kind), number))
    (length, width), middle = SIZE, SIZE[1] / 2
    start = [0.8, middle + random.uniform(-0.1, 0.1), random.uniform(-0.1, 0.1)]
    goal: list = [length - 0.8, middle + random.uniform(-0.1, 0.1), random.uniform(-0.1, 0.1)]
    obstacles: list[Obstacle] = []
    yaw = random.uniform(-0.15, 0.15)
    if kind == "flat":
        start = [random.uniform(0.8, length - 0.8), random.uniform(0.8, width - 0.8), random.uniform(-math.pi, math.pi)]
        goal = [random.uniform(0.8, length - 0.8), random.uniform(0.8, width - 0.8), random.uniform(-math.pi, math.pi)]
    elif kind == "stairs":
        steps, highest = int(random.integers(2, 4)), min(0.2, robot.step.max_height)
        obstacles.append(
            Staircase(2.0, middle, yaw / 2, steps, random.uniform(0.6, 1.0) * highest, random.uniform(0.28, 0.34), 8, 8)
        )
    elif kind == "blocks":
        highest = 0.9 * robot.step.max_height
        obstacles.append(
            Block(3.0, middle, yaw, random.uniform(1.2, 2.0), 8, random.uniform(0.06, highest)),
        )
    elif kind == "ramps":
        slope = math.tan(random.uniform(0.4, 1.0) * (robot.slope.max_pitch - BELOW))
        run = random.uniform(1.0, 2.0)
        obstacles.append(Ramp(1.8 + run / 2, middle, 0.0, run, 8, slope * run))
        obstacles.append(Block(1.8 + run + 4, middle, 0.0, 8, 8, slope * run))
    elif kind == "doors":
        opening, place = random.uniform(0.75, 1.1), middle + random.uniform(-0.4, 0.4)
        for low, high in ((-1.0, place - opening / 2), (place + opening / 2, width + 1.0)):
            obstacles.append(Block(3.0, (low + high) / 2, math.pi / 2, high - low, 0.1, 1.2))
    elif kind == "clutter":
        for _ in range(8):
            x, y = random.uniform(1.6, length - 1.6), random.uniform(0.2, width - 0.2)
            side = random.uniform(0.1, 0.5, 2).tolist()
            obstacles.append(Block(x, y, random.uniform(-math.pi, math.pi), *side, random.uniform(0.03, 0.35)))
    if kind in ("stairs", "ramps") and random.random() < 0.5:  # down, ahead
        start, goal = [*goal[:2], goal[2] + math.pi], [*start[:2], start[2] + math.pi]
    scene = Scene(tuple(obstacles))
    shape = round(cells(length)), round(cells(width))
    centers = Grid((0.0, 0.0), shape).center(np.moveaxis(np.indices(shape), 0, -1))
    heights = scene.heights_at(centers[..., 0], centers[..., 1])
    return Task(_noisy(HeightMap(heights), random), scene, tuple(start), tuple(goal))  # type: ignore[arg-type]


def place_tasks(seed: int, robot: Robot) -> Iterator[Task]:
    """Yields tasks between random poses in real places, one place after the other."""
    from hdsp.terrain.scans import build_map, find_files, load_scan

    planners = {}
    for number in range(10_000):
        name = PLACES[number % len(PLACES)]
        if name not in planners:
            paths, reason = find_files(scan := load_scan(SCANS / f"{name}.yaml"))
            if not paths:
                raise InputError(reason)
            planners[name] = Planner(build_map(scan, paths), robot, "geometric")
        planner = planners[name]
        random = np.random.default_rng((seed, KINDS.index("places"), number))
        poses = poses_to_leave(planner, 12, int(random.integers(2**31)))
        start = poses[0]
        goals = [pose for pose in poses[1:] if 0.5 < math.dist(pose[:2], start[:2]) < _NEAR]
        truth = planner.terrain
        if goals:
            yield Task(_noisy(truth, random), _filled(truth), start, (*goals[0][:2], None))


def _noisy(terrain: HeightMap, random: np.random.Generator) -> HeightMap:
    noise = random.normal(0.0, NOISE, terrain.shape).astype(np.float32)
    return HeightMap(terrain.heights + noise, terrain.origin, terrain.resolution)


def _filled(terrain: HeightMap) -> HeightMap:
    """The same ground; unknown cells are as low as the lowest ground, and no plan leads there."""
    return HeightMap(
        np.where(np.isnan(terrain.heights), np.nanmin(terrain.heights), terrain.heights), terrain.origin,
        terrain.resolution,
    )  # fmt: skip


def tasks(kind: str, seed: int, robot: Robot) -> Iterator[Task]:
    """Yields tasks of a kind without end."""
    if kind == "places":
        yield from place_tasks(seed, robot)
        return
    number = 0
    while True:
        yield made_task(kind, seed, number, robot)
        number += 1


def solve(task: Task, robot: Robot, weight: float) -> Plan | None:
    """Returns a plan that can be carried out, or None."""
    try:
        plan = Planner(task.map, robot, "manual").plan(
            task.start, task.goal, weight=weight, refinable=True, expansions=_EXPANSIONS, polish=0
        )
        if plan.solved and plan.actions:
            plan.refine()
            return plan
    except (InputError, RefinementError):
        pass
    return None


def driven(task: Task, plan: Plan, seed: int) -> dict[str, Any]:
    """Drives along a plan; returns the verdict, cost and CPU time."""
    began = time.process_time()
    run = plan.drive(task.truth, seed)
    seconds = time.process_time() - began
    return run.facts() | {"cost": plan.cost, "steps": plan.steps, "cpu": seconds, "actions": len(plan.actions)}


def run_kind(kind: str, robot: Robot, arguments: argparse.Namespace, folder: Path) -> list[dict[str, Any]]:
    """Drives tasks of one kind until there are enough, or reads their files."""
    results: list[dict[str, Any]] = []
    found = tasks(kind, arguments.seed, robot)
    for number in range(4 * arguments.count):
        if len(results) == arguments.count:
            break
        path = folder / f"{robot.name}-{kind}-{arguments.seed}-{number}.json"
        task = next(found)
        if path.is_file():
            result = json.loads(path.read_text())
        else:
            result = one(kind, number, task, robot, arguments)
            with replacing(path) as temporary:
                temporary.write_text(json.dumps(result))
        if result["planned"]:
            results.append(result)
            print(
                f"{kind} {number}: {result['cause']}, {result['duration']:.0f} s, {result['energy']:.0f} J", flush=True
            )
    return results


def one(kind: str, number: int, task: Task, robot: Robot, arguments: argparse.Namespace) -> dict[str, Any]:
    """Plans and drives one task; the first tasks of a kind also drive a second, dearer way."""
    plan = solve(task, robot, 1.5)
    result: dict[str, Any] = {"kind": kind, "number": number, "planned": plan is not None}
    if plan is None:
        return result
    result |= driven(task, plan, number)
    if number < arguments.pairs and result["success"]:
        other = solve(task, robot, 5.0)
        if other is not None and other.cost > _DIFFERS * plan.cost:
            result["other"] = driven(task, other, number)
    return result


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=20, help="tasks of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robot", default="momaro", help="preset or YAML file")
    parser.add_argument("--kinds", default=",".join(KINDS), help="kinds, separated by commas")
    parser.add_argument("--pairs", type=int, default=4, help="first tasks of each kind with a second way")
    parser.add_argument("--folder", type=Path, default=Path("outputs/driven"), help="folder for the results of tasks")
    parser.add_argument("--page", type=Path, help="docs page to update")
    arguments = parser.parse_args(argv)
    kinds = arguments.kinds.split(",")
    if unknown := [kind for kind in kinds if kind not in KINDS]:
        raise InputError(f"--kinds {unknown[0]}: need some of {', '.join(KINDS)}")
    arguments.folder.mkdir(parents=True, exist_ok=True)
    robot = Robot.load(arguments.robot)
    results = [result for kind in kinds for result in run_kind(kind, robot, arguments, arguments.folder)]
    summary = summarise(robot.name, kinds, results)
    if arguments.page:
        picture = arguments.page.parent / "figures" / "driven_energy.png"
        draw(results, picture)
        write_block(arguments.page, "benchmarks.driven", text(summary, picture.name))
    print(json.dumps(summary))
    return summary


def summarise(robot: str, kinds: list[str], results: list[dict[str, Any]]) -> dict:
    """Returns the benchmark's JSON document."""
    by_kind = {kind: [result for result in results if result["kind"] == kind] for kind in kinds}
    pairs = [(result, result["other"]) for result in results if result.get("other", {}).get("success")]
    signs = [math.copysign(1, b["energy"] - a["energy"]) * math.copysign(1, b["cost"] - a["cost"]) for a, b in pairs]
    return {
        "robot": robot,
        "tasks": {kind: len(found) for kind, found in by_kind.items()},
        "driven": {kind: _share(found) for kind, found in by_kind.items()},
        "all": _share(results),
        "causes": {
            kind: dict(Counter(result["ending"] for result in found if not result["success"]))
            for kind, found in by_kind.items()
        },
        "realtime": round(sum(r["duration"] for r in results) / sum(r["cpu"] for r in results), 2) if results else None,
        "pairs": len(pairs),
        "rank_correlation": round(float(np.mean(signs)), 2) if signs else None,
    }


def _share(results: list[dict[str, Any]]) -> float | None:
    return round(sum(result["success"] for result in results) / len(results), 4) if results else None


def text(summary: dict, picture: str) -> str:
    """Formats the result for the page."""
    rows = [
        [kind, summary["tasks"][kind], share, ", ".join(f"{n} {end}" for end, n in summary["causes"][kind].items())]
        for kind, share in summary["driven"].items()
    ]
    rows.append(["all", sum(summary["tasks"].values()), summary["all"], ""])
    head = table(["ground", "tasks", "arrived", "other ends"], rows)
    return (
        f"{head}\n\nSimulation: {summary['realtime']} times as fast as real time on one core. Rank correlation of cost "
        f"and energy over {summary['pairs']} pairs of ways between the same poses: {summary['rank_correlation']}.\n\n"
        f"![Energy against cost, pairs of ways joined](figures/{picture})"
    )


def draw(results: list[dict[str, Any]], path: Path) -> None:
    """Draws energy against cost; a line joins two ways between the same poses."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6.5, 4.2), layout="constrained")
    for kind in KINDS:
        found = [result for result in results if result["kind"] == kind and result["success"]]
        if found:
            axes.scatter([r["cost"] for r in found], [r["energy"] for r in found], s=18, label=kind)
    for result in results:
        if result.get("other", {}).get("success"):
            ways = result, result["other"]
            axes.plot([way["cost"] for way in ways], [way["energy"] for way in ways], color="0.6", lw=0.8, zorder=0)
            axes.scatter(ways[1]["cost"], ways[1]["energy"], s=14, facecolors="none", edgecolors="0.4", zorder=0)
    axes.set(xlabel="planned cost", ylabel="energy (J)", yscale="log", xscale="log")
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    main()
