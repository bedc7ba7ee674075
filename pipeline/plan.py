"""Stage `plan`: the abstractions as heuristics of the detailed planner on a generated map (the paper's Table II)."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
from omegaconf import DictConfig

from hdsp.errors import InputError
from hdsp.robot import Robot
from pipeline.abstractions import abstract_costs
from pipeline.config import plain, settings
from pipeline.speedup import summarise
from pipeline.stage import Folders, run_stage, write_json

if TYPE_CHECKING:
    from hdsp.heightmap import HeightMap
    from hdsp.planner import Plan, Planner

Pose = tuple[float, float, float]

#: Draws of a start and goal before giving up.
ATTEMPTS = 10_000


def plan(config: DictConfig, folders: Folders) -> None:
    from hdsp.arena import ArenaSettings, random_arena
    from hdsp.planner import Planner
    from hdsp.viz import save_planned_path, save_planning_bars

    robot = Robot.load(plain(config.robot))
    contents = settings(ArenaSettings, config.arena.contents, "arena.contents")
    terrain = random_arena(config.arena.seed, config.arena.size, contents)
    planners: dict[str, Planner] = {}
    edges_seconds: dict[str, float] = {}
    for name in config.planner.heuristics:
        began = time.perf_counter()
        if name == "geometric":
            planners[name] = Planner(terrain, robot)
        else:
            planners[name] = Planner(terrain, robot, heuristic=abstract_costs(name, config, folders))
            planners[name].prepare()
            edges_seconds[name] = time.perf_counter() - began
            print(f"costs of all abstract actions, {name}: {edges_seconds[name]:.1f} s")

    pairs = draw_pairs(planners["geometric"], terrain, config.arena)
    limits = plain(config.planner.limits)
    runs: list[dict[str, Any]] = []
    found: dict[tuple[int, str, float], Plan] = {}
    for number, (start, goal) in enumerate(pairs):
        for name, planner in planners.items():
            for weight in config.planner.weights:
                began = time.perf_counter()
                result = planner.plan(start, goal, weight=weight, **limits)
                seconds = time.perf_counter() - began
                found[number, name, weight] = result
                runs.append(_run(number, name, weight, result, seconds))
                print(f"pair {number}, {name}, W = {weight:g}: {result.status}, cost {result.cost:.3f}, {seconds:.2f} s")

    report = {
        "arena": {"size": config.arena.size, "seed": config.arena.seed, "pairs": len(pairs)},
        "pairs": [{"start": start, "goal": goal} for start, goal in pairs],
        "edges_seconds": edges_seconds,
        "runs": runs,
        "summary": summarise(runs),
    }
    write_json(folders.write("reports", "planning.json"), report)
    save_planning_bars(runs, folders.write("reports", "figures", "planning.png"))
    number, name, weight = best_to_show(runs)
    start, goal = pairs[number]
    title = f"{name} heuristic, W = {weight:g}"
    picture = folders.write("reports", "figures", "planned_path.png")
    save_planned_path(terrain, found[number, name, weight], robot, picture, title, start, goal)


def draw_pairs(planner: Planner, terrain: HeightMap, arena: DictConfig) -> list[tuple[Pose, Pose]]:
    """Pairs of poses (x, y, theta) at which the robot can stand, at least `arena.min_distance` apart.

    Raises:
        InputError: too few such pairs were found.
    """
    random = np.random.default_rng(arena.pairs_seed)
    low, high = np.array(terrain.origin), np.array(terrain.origin) + terrain.size

    def pose() -> Pose:
        x, y = random.uniform(low, high).tolist()
        return (x, y, random.uniform(-np.pi, np.pi))

    pairs: list[tuple[Pose, Pose]] = []
    for _ in range(ATTEMPTS):
        start, goal = pose(), pose()
        far = np.hypot(goal[0] - start[0], goal[1] - start[1]) >= arena.min_distance
        if far and planner.valid(start) and planner.valid(goal):
            pairs.append((start, goal))
        if len(pairs) == arena.pairs:
            return pairs
    raise InputError(
        f"arena.pairs: found {len(pairs)} of {arena.pairs} pairs of poses {arena.min_distance:g} m apart in {ATTEMPTS} draws"
    )


def best_to_show(runs: list[dict[str, Any]]) -> tuple[int, str, float]:
    """The search for the picture: the longest path that was found, with the least weight, and the learned heuristic."""
    solved = [run for run in runs if run["status"] == "solved"] or runs
    costs: dict[int, float] = {}
    for run in solved:
        costs[run["pair"]] = min(run["cost"] or 0.0, costs.get(run["pair"], np.inf))
    longest = max(costs, key=costs.__getitem__)
    candidates = [run for run in solved if run["pair"] == longest]
    run = min(candidates, key=lambda run: (run["heuristic"] != "learned", run["weight"]))
    return run["pair"], run["heuristic"], run["weight"]


def _run(number: int, heuristic: str, weight: float, plan: Plan, seconds: float) -> dict[str, Any]:
    status = str(plan.status)
    return {
        "pair": number,
        "heuristic": heuristic,
        "weight": weight,
        "status": status,
        "cost": plan.cost if status == "solved" else None,
        "seconds": seconds,
        "expansions": plan.stats["expansions"],
        "stats": plan.stats,
    }


if __name__ == "__main__":
    run_stage(plan, "plan")
