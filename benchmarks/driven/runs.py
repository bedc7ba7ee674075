"""Plans and drives tasks, side by side in processes; each result has a file."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.driven.tasks import Pose, Task, make_task
from benchmarks.driven.ways import joined, make_ways
from hdsp.base.errors import InputError, RefinementError
from hdsp.base.files import replacing
from hdsp.planning.answers.plans import Plan
from hdsp.planning.margin import DRIVEN_MARGIN
from hdsp.planning.planner import Planner
from hdsp.robot.robot import Robot

WAYS = "ways"
WEIGHT = 1.5
_EXPANSIONS = 1_500_000
_TRIES = 4  # numbers of tasks for each result


class Job(NamedTuple):
    """A task by its kind and number, for one robot, and the folder for its result."""

    kind: str
    number: int
    seed: int
    robot: Robot
    folder: Path


def run_all(
    counts: dict[str, int], seed: int, robot: Robot, folder: Path, processes: int
) -> dict[str, list[dict[str, Any]]]:
    """Drives tasks of all kinds in turn until each kind has its count of tasks with a plan, or reads their files.

    Args:
        counts: number of tasks by kind.
        seed: seed of the tasks.
        robot: the robot.
        folder: folder for the results.
        processes: number of processes.

    Returns:
        results by kind, in the order of the tasks.
    """
    found: dict[str, list[dict[str, Any]]] = {kind: [] for kind in counts}
    following = dict.fromkeys(counts, 0)
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        in_turn = pool.map if processes > 1 else map
        while jobs := _batch(counts, found, following, seed, robot, folder):
            for result in in_turn(run_job, jobs):
                if result["planned"]:
                    found[result["kind"]].append(result)
                print(_line(result), flush=True)
    return found


def _batch(counts, found, following, seed: int, robot: Robot, folder: Path) -> list[Job]:
    """The next tasks: as many of each kind as it lacks, the kinds in turn."""
    jobs = []
    for kind, count in counts.items():
        lacking = min(count - len(found[kind]), _TRIES * count - following[kind])
        jobs += [Job(kind, following[kind] + k, seed, robot, folder) for k in range(lacking)]
        following[kind] += lacking
    return sorted(jobs, key=lambda job: job.number)  # sorted() keeps the order of the kinds


def run_job(job: Job) -> dict[str, Any]:
    """Returns the result of a task, from its file or by planning and driving."""
    path = job.folder / f"{job.robot.name}-{job.kind}-{job.seed}-{job.number}.json"
    if path.is_file():
        return json.loads(path.read_text())
    result = {"kind": job.kind, "number": job.number}
    result |= _both_ways(job) if job.kind == WAYS else _one(job)
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(result))
    return result


def _one(job: Job) -> dict[str, Any]:
    task = make_task(job.kind, job.seed, job.number, job.robot)
    plan = None if task is None else solve(task, job.robot)
    if task is None or plan is None:
        return {"planned": False}
    return {"planned": True} | driven(task, plan, job.number)


def _both_ways(job: Job) -> dict[str, Any]:
    sort, task, through = make_ways(job.seed, job.number, job.robot)
    plans = [solve(task, job.robot, poses) for poses in through]
    if None in plans:
        return {"planned": False, "sort": sort}
    return {"planned": True, "sort": sort, "ways": [driven(task, plan, job.number) for plan in plans if plan]}


def solve(task: Task, robot: Robot, through: Sequence[Pose] = ()) -> Plan | None:
    """Returns a plan that can be carried out, or None.

    Args:
        task: the task.
        robot: the robot.
        through: poses on the way.
    """
    try:
        planner = Planner(task.map, robot, "manual", margin=DRIVEN_MARGIN)
        plans: list[Plan] = []
        for goal in (*through, task.goal):
            start = plans[-1].states[-1] if plans else task.start
            plan = planner.plan(start, goal, weight=WEIGHT, refinable=True, expansions=_EXPANSIONS, polish=0)
            if not plan.solved or not plan.actions:
                return None
            plans.append(plan)
        plan = joined(plans)
        plan.refine()
        return plan
    except (InputError, RefinementError):
        return None


def driven(task: Task, plan: Plan, seed: int) -> dict[str, Any]:
    """Drives along a plan; returns the verdict, cost and CPU time."""
    began = time.process_time()
    run = plan.drive(task.truth, seed)
    seconds = time.process_time() - began
    return run.facts() | {"cost": plan.cost, "steps": plan.steps, "cpu": seconds, "actions": len(plan.actions)}


def _line(result: dict[str, Any]) -> str:
    name = f"{result['kind']} {result['number']}"
    if not result["planned"]:
        return f"{name}: no plan"
    runs = result.get("ways", [result])
    return "; ".join([f"{name}: {run['cause']}, {run['duration']:.0f} s, {run['energy']:.0f} J" for run in runs])
