"""Stage `plan`: abstractions as heuristics for the detailed planner in the paper's arena (Sec. VI-B, Table II)."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from statistics import median
from typing import TYPE_CHECKING, Any, NamedTuple

from hdsp.base.errors import InputError
from hdsp.robot.robot import Robot

from . import tracking
from .abstractions import available, heuristic_source, trained_weights
from .config import plain
from .config_types import Config, PlannerSettings
from .random_tasks import random_arena_runs, random_task_report
from .side_by_side import side_by_side, with_threads
from .speedup import best_known, summarise
from .stage import Folders, read_json, run_stage, write_json
from .tables import percent
from .task_sets import ABSENT

if TYPE_CHECKING:
    from hdsp.abstract import AbstractCosts
    from hdsp.planning.answers.plans import Plan
    from hdsp.planning.planner import Planner
    from hdsp.terrain.arenas import Arena, ArenaDescription
    from hdsp.terrain.height_map import HeightMap
    from hdsp.terrain.random_arenas import RandomArena
    from hdsp.viz import DrawnPath

Pose = tuple[float, float, float]
Tasks = dict[str, tuple[Pose, Pose]]


class ArenaMap(NamedTuple):
    """Planning terrain: the map, its origin in words, and the true arena if known."""

    terrain: HeightMap
    about: str
    truth: Arena | None


def blocked(robot: Robot) -> Plan:
    """Plans through a wall; the search ends in a proof of infeasibility."""
    import numpy as np

    from hdsp.planning.planner import Planner
    from hdsp.terrain.height_map import HeightMap

    heights = np.zeros((160, 80), np.float32)
    heights[78:82] = 1.5
    return Planner(HeightMap(heights), robot).plan((1.0, 1.0, 0.0), (3.0, 1.0, 0.0))


class Searches(NamedTuple):
    """Searches in the arena with one heuristic.

    Attributes:
        runs: entries of the report.
        paths: path of each task that was solved, by task and weight.
        edges: `seconds` for abstract action costs, and the `share` of the states that have them; None without any.
    """

    runs: list[dict[str, Any]]
    paths: dict[tuple[str, float], DrawnPath]
    edges: dict[str, float] | None


def plan(config: Config, folders: Folders) -> None:
    from hdsp.viz import save_planned_path, save_planned_paths, save_planning_bars

    from .stored_paths import PathKey, write_paths

    robot = config.robot
    ground = read_ground(config.arena, folders)
    print(f"{ground.about}, {config.arena.size:g} x {config.arena.size:g} m", flush=True)
    names = available(config.planner.heuristics, robot)
    if not names:
        raise InputError(f"planner.heuristics: none of {', '.join(config.planner.heuristics)} exists for {robot.name}")
    tasks = read_tasks(ground.terrain, config)
    weights = trained_weights(names, folders)
    workers = config.runtime.workers or os.cpu_count() or 1
    shared = with_threads(config, max((os.cpu_count() or 1) // workers, 1))
    jobs: list[Callable[[], Any]] = []
    groups = []
    # By default networks come last among the names. They take longest and start first: no process waits at the end.
    for name in reversed(names):
        # Searches with the geometric heuristic are long and share nothing.
        parts = [{task: ends} for task, ends in tasks.items()] if name == "geometric" else [tasks]
        groups += [name] * len(parts)
        jobs += [partial(search_tasks, shared, folders, name, part) for part in parts]
    arenas = [partial(random_arena_runs, shared, folders, k) for k in range(config.planner.random.arenas)]
    done = side_by_side([*jobs, *arenas], workers)
    searches = sorted(zip(groups, done[: len(jobs)], strict=True), key=lambda search: names.index(search[0]))
    runs = [run for _, found in searches for run in found.runs]
    edges = {name: found.edges for name, found in searches if found.edges is not None}

    report = {
        "arena": {"source": ground.about, "size": config.arena.size, "pairs": len(tasks)},
        "tasks": plain(config.arena.tasks),
        "margin": config.planner.margin,
        "limits": plain(config.planner.limits),
        "processes": workers,
        "edges_seconds": {name: values["seconds"] for name, values in edges.items()},
        "edges_share": {name: values["share"] for name, values in edges.items()},
        "runs": runs,
        "best_known": best_known(runs),
        "summary": summarise(runs),
        "collisions": collisions(runs),
        "random": random_task_report(config, [run for found in done[len(jobs) :] for run in found]),
    }
    written = folders.write("reports", "planning.json")
    write_json(written, report)
    tracking.add_results(folders, weights, table_two(report["summary"]), [written], "planning")
    save_planning_bars(runs, folders.write("reports", "figures", "planning.png"))
    found = {PathKey(task, name, weight): p for name, part in searches for (task, weight), p in part.paths.items()}
    write_paths(folders.write("data", "paths.npz"), {key: (path.states, path.actions) for key, path in found.items()})
    task, name, weight = best_to_show(runs)
    title = f"Task {task}: {name} heuristic, W = {weight:g}"
    picture = folders.write("reports", "figures", "planned_path.png")
    shown = found[PathKey(task, name, weight)]
    save_planned_path(ground.terrain, shown.states, shown.actions, robot, picture, title, *tasks[task])
    name, weight = series_to_show(runs)
    save_planned_paths(
        ground.terrain,
        {task: found[PathKey(task, name, weight)] for task in tasks},
        tasks,
        robot,
        folders.write("reports", "figures", "planned_paths.png"),
        f"{name} heuristic, W = {weight:g}",
    )


def table_two(summary: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> dict[str, float | None]:
    """Returns Table II with flat names, for MLflow."""
    return {
        f"table 2/{name}/W{weight}/{key}": values.get(key)
        for name, by_weight in summary.items()
        for weight, values in by_weight.items()
        for key in ("speedup", "cost_increase", "seconds_mean")
    }


def search_tasks(config: Config, folders: Folders, name: str, tasks: Tasks) -> Searches:
    """Searches for each task and weight with one heuristic; prints a line for each search.

    A network that judges patch by patch evaluates only abstract states that the queries need.
    """
    from hdsp.planning.heuristics import AbstractHeuristic
    from hdsp.planning.planner import Planner
    from hdsp.planning.polish import DEFAULT
    from hdsp.terrain.height_map import HeightMap
    from hdsp.viz import DrawnPath

    robot, section = config.robot, config.planner
    ground = read_ground(config.arena, folders)
    costs = heuristic_source(name, config, folders)
    planner = Planner(ground.terrain, robot, costs, margin=section.margin, conditioning=None)
    is_lazy, seconds = not isinstance(costs, str) and _by_patches(costs), 0.0
    flat = HeightMap.flat((100, 100))  # compiles and loads kernels before any measurement,
    Planner(flat, robot, costs, conditioning=None).plan((1.2, 1.2, 0.0), (1.4, 1.2, 0.0), expansions=1)
    blocked(robot)  # including the kernels for proofs
    if not is_lazy:
        began = time.perf_counter()
        planner.prepare()
        seconds = time.perf_counter() - began

    runs: list[dict[str, Any]] = []
    paths: dict[tuple[str, float], DrawnPath] = {}
    for task, (start, goal) in tasks.items():
        for weight in section.weights:
            if is_lazy:
                seconds += evaluate_needed(planner, start, goal, weight, section)
            result, duration = timed(planner, start, goal, weight, section)
            run = describe(task, name, weight, result, duration) | checked(ground.truth, result, robot)
            if not planner.heuristic.admissible:  # the polish is for plans whose cost nothing bounds
                polished, polished_seconds = timed(planner, start, goal, weight, section, DEFAULT)
                cost = polished.cost if polished.solved else None
                run |= {"polished_cost": cost, "polished_seconds": polished_seconds}
            runs.append(run)
            paths[task, weight] = DrawnPath(result.states, result.actions, result.cost)
            print(in_words(run), flush=True)
    if not isinstance(planner.heuristic, AbstractHeuristic):
        return Searches(runs, paths, None)
    share = planner.heuristic.known.share
    print(f"costs of abstract actions, {name}: {seconds:.1f} s for {percent(share)} of the states", flush=True)
    return Searches(runs, paths, {"seconds": seconds, "share": share})


def read_ground(arena: ArenaDescription | RandomArena, folders: Folders) -> ArenaMap:
    """Returns the map named by `arena.source`; an arena without scan gives its own heights.

    Raises:
        InputError: the arena cannot be made.
    """
    from hdsp.terrain.arenas import read_arena
    from hdsp.terrain.height_map import HeightMap
    from hdsp.terrain.random_arenas import random_arena

    if arena.source == "random":
        return ArenaMap(random_arena(arena.seed, arena.size, arena.contents), "a generated arena", None)
    truth, absent = read_arena(arena), folders.read("data", "arena", ABSENT)
    if absent.is_file():
        return ArenaMap(truth.height_map(), f"the arena as it is, not scanned ({read_json(absent)['reason']})", truth)
    return ArenaMap(HeightMap.load(folders.read("data", "arena", "scanned.npz")), "the scanned arena", truth)


def evaluate_needed(planner: Planner, start: Pose, goal: Pose, weight: float, section: PlannerSettings) -> float:
    """Repeats a query until it evaluates no further abstract action costs; returns the seconds for these costs.

    A query with a time limit may leave some costs to the next one.
    """
    from hdsp.planning.heuristics import AbstractHeuristic

    assert isinstance(planner.heuristic, AbstractHeuristic)
    durations, share = [], -1.0
    while share != (share := planner.heuristic.known.share):
        began = time.perf_counter()
        planner.plan(start, goal, weight=weight, polish=0.0, **asdict(section.limits))
        durations.append(time.perf_counter() - began)
    return sum(max(duration - durations[-1], 0.0) for duration in durations)


def _by_patches(costs: AbstractCosts) -> bool:
    """Whether a network judges each state's patch on its own, which takes milliseconds."""
    from hdsp.learning import LearnedCosts

    return isinstance(costs, LearnedCosts) and not costs.abstraction.is_dense()


def timed(
    planner: Planner, start: Pose, goal: Pose, weight: float, section: PlannerSettings, polish: float = 0.0
) -> tuple[Plan, float]:
    """Returns a plan and its query time in seconds, the median of several runs for short queries.

    Each run equals the first query on a new map: earlier results are forgotten, so the time includes the Dijkstra
    search for its goal. The paper's comparison has no polish (s).
    """
    times: list[float] = []
    while True:
        planner.clear()
        began = time.perf_counter()
        result = planner.plan(start, goal, weight=weight, polish=polish, **asdict(section.limits))
        times.append(time.perf_counter() - began)
        if len(times) >= section.repeats or sum(times) > section.repeat_below:
            return result, median(times)


def read_tasks(terrain: HeightMap, config: Config) -> Tasks:
    """Returns each task's start and goal by name.

    Raises:
        InputError: the robot cannot stand at a pose.
    """
    from hdsp.planning.planner import Planner

    planner = Planner(terrain, config.robot, margin=config.planner.margin, conditioning=None)
    found: Tasks = {}
    for task in config.arena.tasks:
        for end, pose in (("start", task.start), ("goal", task.goal)):
            if not planner.valid(pose):
                raise InputError(f"arena.tasks: the robot cannot stand at the {end} {list(pose)} of task {task.name!r}")
        found[task.name] = task.start, task.goal
    return found


def describe(task: str, heuristic: str, weight: float, plan: Plan, seconds: float) -> dict[str, Any]:
    """Report entry for a search."""
    status = str(plan.status)
    return {
        "pair": task,
        "heuristic": heuristic,
        "weight": weight,
        "status": status,
        "steps": plan.steps,
        "cost": plan.cost if status == "solved" else None,
        "seconds": seconds,
        "expansions": plan.stats.expansions,
        "stats": plan.stats.known(),
    }


def checked(truth: Arena | None, plan: Plan, robot: Robot) -> dict[str, Any]:
    """Checks a path for collisions with the true arena; None without a path or a known arena."""
    from hdsp.planning.collisions import check_plan

    if truth is None or not plan.solved:
        return {"collision_free": None}
    verdict = check_plan(truth, plan, robot)
    return {
        "collision_free": verdict.free,
        "collisions": [f"{hit.part} {hit.why}, {1000 * hit.depth:.1f} mm deep" for hit in verdict.collisions],
        "body_clearance": verdict.body_clearance,
        "foot_clearance": verdict.foot_clearance,
    }


def collisions(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts checked and collision-free paths, with the least body and foot clearance (m)."""
    known = [run for run in runs if run["collision_free"] is not None]
    return {
        "checked": len(known),
        "free": sum(run["collision_free"] for run in known),
        "least_body_clearance": min((run["body_clearance"] for run in known), default=None),
        "least_foot_clearance": min((run["foot_clearance"] for run in known), default=None),
    }


def in_words(run: dict[str, Any]) -> str:
    """Describes a search in one line."""
    cost = "no path" if run["cost"] is None else f"cost {run['cost']:.3f}"
    hits = run.get("collisions") or [""]
    verdict = {True: ", free", False: f", COLLIDES {len(hits)} times: {hits[0]}", None: ""}
    return (
        f"{run['pair']}, {run['heuristic']}, W = {run['weight']:g}: {run['status']}, {cost}, {run['seconds']:.3f} s, "
        f"{run['expansions']:,} expansions, {run['stats']['memory'] / 1e6:.0f} MB{verdict[run['collision_free']]}"
    )


def best_to_show(runs: list[dict[str, Any]]) -> tuple[str, str, float]:
    """Selects the search for the picture.

    The order is: most steps, longest path, trained abstraction if it found a path, least weight.
    """
    solved = [run for run in runs if run["status"] == "solved"] or runs
    chosen = max(solved, key=lambda run: (run["steps"], run["cost"] or 0.0))["pair"]
    candidates = [run for run in solved if run["pair"] == chosen]
    run = min(candidates, key=lambda run: (run["heuristic"] != "trained", run["weight"]))
    return run["pair"], run["heuristic"], run["weight"]


def series_to_show(runs: list[dict[str, Any]], weight: float = 1.25) -> tuple[str, float]:
    """Selects heuristic and weight for the picture with all paths.

    The heuristic is the trained abstraction, or else the last; the weight is nearest to the paper's.
    """
    names = [run["heuristic"] for run in runs]
    chosen = "trained" if "trained" in names else names[-1]
    return chosen, min((run["weight"] for run in runs if run["heuristic"] == chosen), key=lambda w: abs(w - weight))


if __name__ == "__main__":
    run_stage(plan, "plan")
