"""Stage `scan_arena`: simulated lidar scans of the paper's arena and of random courses; simulated patches."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.robot.robot import Robot

from .config_types import Config
from .stage import Folders, run_stage, write_json
from .task_sets import ABSENT, remove_results

if TYPE_CHECKING:
    from hdsp.detailed.world.world import World
    from hdsp.robot.lattice import Grid

FIGURES = "reports", "figures"
PICTURES = "arena.png", "simulated_courses.png"
PATCHES, MAPS = "simulated.h5", ("scanned.npz", "true.npz")


def scan_arena(config: Config, folders: Folders) -> None:
    from hdsp.terrain.simulation.mujoco_world import is_available
    from hdsp.viz import save_note

    simulated, arena = folders.write("data", "simulated"), folders.write("data", "arena")
    remove_results(simulated, PATCHES)
    remove_results(arena, *MAPS)
    available, reason = is_available()
    if not available:
        print(f"skipped: {reason}")
        for folder in (simulated, arena):
            write_json(folders.write("data", folder.name, ABSENT), {"reason": reason})
        write_json(folders.write("reports", "arena.json"), {"available": False, "reason": reason})
        for picture in PICTURES:
            save_note(f"not simulated: {reason}", folders.write(*FIGURES, picture))
        return
    robot = config.robot
    lidar = config.simulation.lidar
    report = {
        "available": True,
        "arena": scan_paper_arena(config, folders, robot, lidar),
        "patches": scan_courses(config, folders, robot, lidar),
    }
    write_json(folders.write("reports", "arena.json"), report)


def scan_paper_arena(config: Config, folders: Folders, robot: Robot, lidar) -> dict[str, Any]:
    """Writes the arena's true and scanned maps and its picture; returns the scan accuracy and the valid task ends."""
    from hdsp.detailed.world.world import build_world
    from hdsp.robot.lattice import Grid
    from hdsp.terrain.arenas import read_arena
    from hdsp.terrain.simulation.lidar_mapping import accuracy, scanned_map
    from hdsp.viz import save_arena

    section = config.simulation.arena
    arena = read_arena(section)
    tasks = {task.name: (task.start, task.goal) for task in section.tasks}
    start = next(iter(tasks.values()))[0]
    scanned, true = scanned_map(arena, start, lidar, config.simulation.seed), arena.height_map()
    for terrain, name in zip((scanned, true), MAPS, strict=True):
        terrain.save(folders.write("data", "arena", name))
    world, grid = build_world(scanned, robot), Grid(scanned.origin, scanned.shape)
    ends = {name: {"start": stands(world, grid, a), "goal": stands(world, grid, b)} for name, (a, b) in tasks.items()}
    save_arena(_picture(arena), scanned, true, tasks, folders.write(*FIGURES, PICTURES[0]))
    found = accuracy(scanned, true, robot)
    print(", ".join(f"{name} {value:.3g}" for name, value in found.items()))
    return {"accuracy": found, "valid": ends}


def stands(world: World, grid: Grid, pose: tuple[float, float, float]) -> bool:
    """Whether the robot can stand at a pose (m, m, rad)."""
    from hdsp.abstract.transform import feet_at

    x, y, heading = (int(value) for value in grid.to_lattice(pose)[:3])
    return feet_at(world, (x, y, heading)) is not None


def scan_courses(config: Config, folders: Folders, robot: Robot, lidar) -> dict[str, Any]:
    """Writes the simulated patch set and its picture; returns the number of patches per kind."""
    from hdsp.base.workers import ClusterSettings
    from hdsp.labels.course_patches import PatchRun, simulated_courses, task_set
    from hdsp.labels.label_robots import ROBOT_HASH
    from hdsp.labels.shards import write_shard
    from hdsp.robot.lattice import heading_angle
    from hdsp.viz import save_courses

    run = PatchRun(
        config.simulation.patches,
        config.simulation.courses,
        lidar,
        robot,
        config.labelling.settings,
    )
    courses = []
    cluster = ClusterSettings(config.runtime.workers, dashboard=config.runtime.dashboard, memory=config.runtime.memory)
    for course in simulated_courses(run, cluster):
        courses.append(course)
        if config.runtime.progress:
            print(f"course {course.number}: {len(course.patches)} patches", flush=True)
    tasks = task_set(run, courses)
    path = folders.write("data", "simulated", PATCHES)
    write_shard(path, tasks, {"labels_hash": run.hash(), "maps": len(tasks), ROBOT_HASH: robot.hash()})
    starts = [[(p.kind, *p.start[:2], float(heading_angle(p.start[2]))) for p in course.patches] for course in courses]
    save_courses([course.terrain for course in courses], starts, folders.write(*FIGURES, PICTURES[1]))
    kinds, counts = np.unique(tasks.category, return_counts=True)
    return {"maps": len(tasks), "kinds": dict(zip(kinds.tolist(), counts.tolist(), strict=True))}


def _picture(arena) -> np.ndarray | None:
    """Renders the arena; None if the machine cannot draw."""
    from hdsp.terrain.simulation.mujoco_world import MujocoWorld

    try:
        return MujocoWorld(arena).picture()
    except InputError as error:
        print(f"no picture of the arena: {error}")
        return None


if __name__ == "__main__":
    run_stage(scan_arena, "scan_arena")
