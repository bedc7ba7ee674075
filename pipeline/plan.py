"""Stage `plan`: the abstractions as heuristics of the detailed planner on a generated map (the paper's Table II)."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from hdsp.errors import InputError
from hdsp.robot import Robot
from pipeline.abstractions import abstract_costs
from pipeline.config import plain, settings
from pipeline.speedup import summarise
from pipeline.stage import Folders, run_stage, write_json

if TYPE_CHECKING:
    from hdsp.planner import Plan, Planner

Pose = tuple[float, float, float]


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

    tasks = read_tasks(next(iter(planners.values())), config.arena.tasks)
    limits = plain(config.planner.limits)
    start, goal = next(iter(tasks.values()))
    for planner in planners.values():
        planner.plan(start, goal, expansions=1)  # kernels are compiled, and loaded, before anything is timed
    runs: list[dict[str, Any]] = []
    found: dict[tuple[str, str, float], Plan] = {}
    for task, (start, goal) in tasks.items():
        for name, planner in planners.items():
            for weight in config.planner.weights:
                began = time.perf_counter()
                result = planner.plan(start, goal, weight=weight, **limits)
                seconds = time.perf_counter() - began
                found[task, name, weight] = result
                runs.append(_run(task, name, weight, result, seconds))
                print(f"{task}, {name}, W = {weight:g}: {result.status}, cost {result.cost:.3f}, {seconds:.2f} s")

    report = {
        "arena": {"size": config.arena.size, "seed": config.arena.seed, "pairs": len(tasks)},
        "tasks": plain(config.arena.tasks),
        "edges_seconds": edges_seconds,
        "runs": runs,
        "summary": summarise(runs),
    }
    write_json(folders.write("reports", "planning.json"), report)
    save_planning_bars(runs, folders.write("reports", "figures", "planning.png"))
    task, name, weight = best_to_show(runs)
    start, goal = tasks[task]
    title = f"Task {task}: {name} heuristic, W = {weight:g}"
    picture = folders.write("reports", "figures", "planned_path.png")
    save_planned_path(terrain, found[task, name, weight], robot, picture, title, start, goal)


def read_tasks(planner: Planner, tasks: DictConfig) -> dict[str, tuple[Pose, Pose]]:
    """Start and goal of each task by its name.

    Raises:
        InputError: two tasks have the same name, or the robot cannot stand at a pose.
    """
    found: dict[str, tuple[Pose, Pose]] = {}
    for task in plain(tasks):
        for end in ("start", "goal"):
            if not planner.valid(task[end]):
                raise InputError(
                    f"arena.tasks: the robot cannot stand at the {end} {task[end]} of task {task['name']!r}"
                )
        if task["name"] in found:
            raise InputError(f"arena.tasks: two tasks have the name {task['name']!r}")
        found[task["name"]] = tuple(task["start"]), tuple(task["goal"])
    return found


def best_to_show(runs: list[dict[str, Any]]) -> tuple[str, str, float]:
    """The search for the picture: the task with most steps, then with the longest path, by the learned heuristic if it
    found one, with the least weight."""
    solved = [run for run in runs if run["status"] == "solved"] or runs
    chosen = max(solved, key=lambda run: (run["steps"], run["cost"] or 0.0))["pair"]
    candidates = [run for run in solved if run["pair"] == chosen]
    run = min(candidates, key=lambda run: (run["heuristic"] != "learned", run["weight"]))
    return run["pair"], run["heuristic"], run["weight"]


def _run(task: str, heuristic: str, weight: float, plan: Plan, seconds: float) -> dict[str, Any]:
    status = str(plan.status)
    return {
        "pair": task,
        "heuristic": heuristic,
        "weight": weight,
        "status": status,
        "steps": sum(action.startswith("step ") for action in plan.actions),
        "cost": plan.cost if status == "solved" else None,
        "seconds": seconds,
        "expansions": plan.stats["expansions"],
        "stats": plan.stats,
    }


if __name__ == "__main__":
    run_stage(plan, "plan")
