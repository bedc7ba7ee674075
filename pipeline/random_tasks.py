"""Random tasks beside the arena's: a small sample of `benchmarks.planning`, for the stage `plan`.

Tasks are drawn before any search, so no heuristic takes part in their choice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import fmean
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.planning.planner import Planner
from hdsp.terrain.random_arenas import random_arena

from .abstractions import available, heuristic_source
from .config_types import Config, RandomTaskSettings
from .stage import Folders

Pose = tuple[float, float, float]

_TRIALS = 10_000  # poses
_LEAST = 1.0  # m between start and goal
_RISE = 0.1  # m between the ground under start and goal of every second task


def random_arena_runs(config: Config, folders: Folders, number: int) -> list[dict[str, Any]]:
    """Plans the tasks of one random arena with each heuristic; returns an entry of the report for each search."""
    section = config.planner.random
    terrain = random_arena(section.seed + number, section.size)
    tasks: list[tuple[Pose, Pose]] = []
    runs = []
    for name in available(section.heuristics, config.robot):
        heuristic = heuristic_source(name, config, folders)
        planner = Planner(terrain, config.robot, heuristic, margin=config.planner.margin, conditioning=None)
        tasks = tasks or draw_tasks(planner, section.tasks, section.seed + number)
        planner.prepare().plan(*tasks[0], expansions=1)  # loads kernels before any measurement
        for task, ends in enumerate(tasks):
            planner.clear()
            plan = planner.plan(*ends, weight=section.weight, expansions=section.expansions, polish=0.0)
            runs.append({
                "pair": f"{number}.{task}", "heuristic": name, "status": str(plan.status),
                "cost": plan.cost if plan.solved else None, "expansions": plan.stats.expansions,
                "seconds": plan.stats.seconds,
            })  # fmt: skip
    return runs


def random_task_report(config: Config, runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Returns settings, all runs and a summary."""
    section = config.planner.random
    return {
        "arenas": section.arenas, "size": section.size, "weight": section.weight, "expansions": section.expansions,
        "tasks": section.arenas * section.tasks, "runs": runs, "summary": summarise_random(runs, section),
    }  # fmt: skip


def draw_tasks(planner: Planner, count: int, seed: int) -> list[tuple[Pose, Pose]]:
    """Draws pairs of poses that the robot can leave, at least 1 m apart; in every second pair on different levels.

    Raises:
        InputError: the map has too few.
    """
    random = np.random.default_rng(seed)
    (x, y), (length, width) = planner.terrain.origin, planner.terrain.size
    margin, height_at = planner.terrain.resolution, planner.terrain.height_at
    found: list[Pose] = []
    for _ in range(_TRIALS):
        low, high = (x + margin, y + margin, -math.pi), (x + length - margin, y + width - margin, math.pi)
        pose: Pose = tuple(random.uniform(low, high).tolist())
        if len(found) % 2 == 1:
            rise = abs(height_at(*found[-1][:2]) - height_at(*pose[:2]))
            if (len(found) % 4 == 3 and not rise >= _RISE) or math.dist(found[-1][:2], pose[:2]) < _LEAST:
                continue
        if planner.can_leave(pose):
            found.append(pose)
        if len(found) == 2 * count:
            return list(zip(found[::2], found[1::2], strict=True))
    raise InputError(f"planner.random: {len(found) // 2} tasks found on an arena; need {count}")


def summarise_random(runs: Sequence[dict[str, Any]], section: RandomTaskSettings) -> dict[str, dict[str, Any]]:
    """Returns figures by heuristic, over tasks that some search solved.

    `hard` counts tasks for which the first heuristic needs `section.hard` expansions or more. Expansions are geometric
    means; a search without a plan counts with the expansions that it made. `cost_above_best` is a mean over the tasks
    that the heuristic solved.
    """
    best: dict[str, float] = {}
    for run in runs:
        if run["cost"] is not None:
            best[run["pair"]] = min(run["cost"], best.get(run["pair"], math.inf))
    names = list(dict.fromkeys(run["heuristic"] for run in runs))
    reference = [run for run in runs if run["heuristic"] == names[0] and run["pair"] in best]
    hard = {run["pair"] for run in reference if run["expansions"] >= section.hard or run["cost"] is None}
    summary = {}
    for name in names:
        own = [run for run in runs if run["heuristic"] == name and run["pair"] in best]
        above = [run["cost"] / best[run["pair"]] - 1 for run in own if run["cost"] is not None]
        summary[name] = {
            "solvable": len(own),
            "solved": len(above),
            "hard": len(hard),
            "expansions_easy": _geometric_mean(run["expansions"] for run in own if run["pair"] not in hard),
            "expansions_hard": _geometric_mean(run["expansions"] for run in own if run["pair"] in hard),
            "seconds_mean": fmean(run["seconds"] for run in own) if own else None,
            "cost_above_best": fmean(above) if above else None,
        }
    return summary


def _geometric_mean(values) -> float | None:
    logs = [math.log(max(value, 1)) for value in values]
    return math.exp(fmean(logs)) if logs else None
