"""Climbing: up and down a staircase, over a bar, through a door, and no path through a narrow door.

    python -m examples.climbing

The example plans each task and refines the plan to a motion. It writes the figures in docs/figures and the table in
docs/climbing.md, and prints one line of JSON.
"""

import argparse
import itertools
import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.page import write_block
from hdsp import HeightMap, Planner
from hdsp.planning.answers.plans import Plan
from hdsp.robot.lattice import Grid, cells
from hdsp.terrain.obstacles import Block, Scene

DOCS = Path(__file__).resolve().parents[1] / "docs"


@dataclass(frozen=True)
class Task:
    """A planning task; poses are x, y (m) and heading (rad), blocks stand on flat ground with a given size (m)."""

    title: str
    size: tuple[float, float]
    blocks: tuple[Block, ...]
    start: tuple[float, float, float]
    goal: tuple[float, float, float]

    def terrain(self) -> HeightMap:
        shape = (round(cells(self.size[0])), round(cells(self.size[1])))
        centers = Grid((0.0, 0.0), shape).center(np.stack(np.indices(shape), axis=-1))
        return HeightMap(Scene(self.blocks).heights_at(centers[..., 0], centers[..., 1]))


def platform(x: float, y: float, steps: int, rise: float, tread: float, top: float, width: float) -> tuple[Block, ...]:
    """A platform of length ``top``, with stairs up to it from x on and stairs down on its other side."""
    length = 2 * (steps - 1) * tread + top
    return tuple(
        Block(x + length / 2, y, 0.0, length - 2 * k * tread, width, rise * (k + 1)) for k in range(steps)
    )  # fmt: skip


def door(x: float, y: float, width: float, room: float) -> tuple[Block, ...]:
    """A wall across a room, 1 m high, with an opening around y."""
    left, right = room - (y + width / 2), y - width / 2
    return (
        Block(x, room - left / 2, 0.0, 0.1, left, 1.0),
        Block(x, right / 2, 0.0, 0.1, right, 1.0),
    )


STAIRS = platform(1.2, 1.0, steps=4, rise=0.2, tread=0.3, top=1.6, width=1.8)
TASKS = {
    "stairs_over": Task("up a staircase of 4 x 0.2 m and down the other side", (6.0, 2.0), STAIRS,
                        (0.6, 1.0, 0.0), (5.2, 1.0, 0.0)),
    "stairs_back": Task("up the same staircase, turn on the platform, and down again", (4.6, 2.0),
                        platform(1.2, 1.0, 4, 0.2, 0.3, 3.0, 1.8), (0.6, 1.0, 0.0), (0.6, 1.0, math.pi)),
    "bar": Task("over a bar of 0.2 m", (3.0, 2.0), (Block(1.5, 1.0, 0.0, 0.1, 2.0, 0.2),),
                (0.6, 1.0, 0.0), (2.4, 1.0, 0.0)),
    "door_wide": Task("through a door of 0.75 m", (10.0, 10.0), door(5.0, 5.0, 0.75, 10.0),
                      (3.8, 4.5, 0.0), (6.2, 5.5, 0.0)),
    "door_narrow": Task("through a door of 0.5 m", (10.0, 10.0), door(5.0, 5.0, 0.5, 10.0),
                        (3.8, 4.5, 0.0), (6.2, 5.5, 0.0)),
}  # fmt: skip


def solve(task: Task) -> tuple[list[Plan], float]:
    """Plans a task; returns its plans and the time in seconds.

    If the goal position is the start position, the robot first drives to the platform and turns there.
    """
    planner = Planner(task.terrain(), heuristic="manual").prepare()
    began = time.perf_counter()
    legs = [task.start, task.goal]
    if task.start[:2] == task.goal[:2]:
        legs.insert(1, (3.1, task.start[1], math.pi))
    plans = [planner.plan(a, b, weight=1.25, refinable=True) for a, b in itertools.pairwise(legs)]
    return plans, time.perf_counter() - began


def facts(plans: list[Plan], seconds: float) -> dict:
    """Results for the documentation page and the tests."""
    result = {
        "solved": all(plan.solved for plan in plans),
        "status": [str(plan.status) for plan in plans],
        "seconds": round(seconds, 2),
        "words": [plan.explain() for plan in plans],
        "refused_steps": sum(len(plan.refused) for plan in plans),
    }
    if not result["solved"]:
        return result
    motions = [plan.refine() for plan in plans]
    lengths = np.concatenate([motion.leg_lengths() for motion in motions])
    clearances = np.concatenate([motion.swing_clearances().ravel() for motion in motions])
    return result | {
        "steps": sum(plan.steps for plan in plans),
        "configurations": sum(map(len, motions)),
        "problems": sum(len(motion.problems()) for motion in motions),
        "least_margin": round(float(min(motion.margins().min() for motion in motions)), 3),
        "least_swing_clearance": round(float(clearances.min()), 3) if np.isfinite(clearances).any() else None,
        "legs": [round(float(lengths.min()), 3), round(float(lengths.max()), 3)],
        "highest_base": round(float(max(motion.base[:, 2].max() for motion in motions)), 2),
    }


def run(folder: Path) -> dict[str, dict]:
    """Plans all tasks and writes their figures to a folder."""
    from hdsp.viz import save_motion, save_planned_path

    folder.mkdir(parents=True, exist_ok=True)
    found = {}
    for name, task in TASKS.items():
        plans, seconds = solve(task)
        found[name] = {"title": task.title} | facts(plans, seconds)
        for number, plan in enumerate(plans, start=1):
            part = f"_{number}" if len(plans) > 1 else ""
            if name.startswith("door") or number == 1:
                save_planned_path(
                    plan.terrain, plan.states, plan.actions, plan.robot, folder / f"{name}{part}_top.png",
                    task.title if plan.solved else f"no way {task.title}",
                    task.start if not plan.solved else None, task.goal if not plan.solved else None,
                )  # fmt: skip
            if plan.solved and plan.steps:
                save_motion(plan.refine(), folder / f"{name}{part}_side.png", title=task.title)
    return found


def page(found: dict[str, dict]) -> str:
    """The table and the explanations in docs/climbing.md."""
    rows = [
        "| task | planned in (s) | steps | configurations | least margin (m) | legs (m) | problems |",
        "|---|---|---|---|---|---|---|",
    ]
    for one in found.values():
        if one["solved"]:
            low, high = one["legs"]
            rows.append(
                f"| {one['title']} | {one['seconds']:.1f} | {one['steps']} | {one['configurations']} "
                f"| {one['least_margin']} | {low} to {high} | {one['problems']} |"
            )
        else:
            rows.append(f"| {one['title']} | {one['seconds']:.1f} | no way | | | | |")
    words = [f"- {one['title']}: *{line}*" for one in found.values() for line in one["words"]]
    return "\n".join([*rows, "", "Output of `explain()`:", "", *words])


def main() -> None:
    write_page(__doc__, "examples.climbing", "climbing.md", run, page)


def write_page(
    about: str,
    author: str,
    name: str,
    run: Callable[[Path], dict[str, dict]],
    page: Callable[[dict[str, dict]], str],
) -> None:
    """Runs an example from the command line: its figures, its block on a page in docs/, and one line of JSON.

    Args:
        about: the example's documentation.
        author: its name in the markers of the block.
        name: file name of the page.
        run: solves the tasks and writes the figures to a folder.
        page: the block for the results.
    """
    arguments = argparse.ArgumentParser(description=about.split("\n")[0])
    arguments.add_argument("--docs", type=Path, default=DOCS, help=f"folder of {name} and figures/")
    docs = arguments.parse_args().docs
    found = run(docs / "figures")
    if (docs / name).exists():
        write_block(docs / name, author, page(found))
    print(json.dumps(found))


if __name__ == "__main__":
    main()
