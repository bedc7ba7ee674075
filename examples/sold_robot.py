"""A robot that is sold, the Unitree Go2-W: over a kerb, up a ramp and stairs, and where it finds no way.

    python -m examples.sold_robot

The example plans each task and refines the plan to a motion. It writes the figures in docs/figures and the table in
docs/own-robot.md, and prints one line of JSON.
"""

import math
import time
from pathlib import Path

from examples.climbing import Task, facts, write_page
from hdsp import Planner
from hdsp.planning.answers.plans import Plan
from hdsp.terrain.obstacles import Block, Ramp

ROBOT = "go2w"
WIDTH = 2.0  # m, of all maps: nothing leads around an obstacle


def ramp(degrees: float, rise: float) -> tuple[Block, ...]:
    """A ramp from x = 1 m up to a platform."""
    length = rise / math.tan(math.radians(degrees))
    return Ramp(1 + length / 2, WIDTH / 2, 0.0, length, WIDTH, rise), _ground(1 + length, 1.5, rise)


def _ground(x: float, length: float, height: float) -> Block:
    return Block(x + length / 2, WIDTH / 2, 0.0, length, WIDTH, height)


def task(title: str, blocks: tuple[Block, ...], goal: float) -> Task:
    """A task straight ahead, up to x = ``goal``; the last block ends the map."""
    start = 0.5, WIDTH / 2, 0.0
    size = round(max(block.x + block.length / 2 for block in blocks), 3)
    return Task(title, (size, WIDTH), blocks, start, (goal, *start[1:]))


def stairs(steps: int, rise: float, tread: float) -> Task:
    """A task up a flight of stairs, to 0.8 m behind its last edge."""
    end = 1.0 + (steps - 1) * tread
    blocks = tuple(_ground(1.0 + k * tread, end + 1.5 - (1.0 + k * tread), rise * (k + 1)) for k in range(steps))
    return task(f"up {steps} steps of {rise:g} m, treads of {tread:g} m", blocks, end + 0.8)


TASKS = {
    "kerb": task("up a kerb of 0.12 m", (_ground(1.0, 1.8, 0.12),), 1.9),
    "ramp": task("up a ramp of 15 degrees", ramp(15, 0.4), 3.2),
    "steep_ramp": task("up a ramp of 40 degrees", ramp(40, 0.8), 2.7),
    "stairs": stairs(4, 0.15, 0.28),
    "flight": stairs(8, 0.16, 0.3),
    "high_stairs": stairs(3, 0.18, 0.28),
}


def solve(task: Task) -> tuple[Plan, float]:
    """Plans a task; returns the plan and the time in seconds."""
    planner = Planner(task.terrain(), ROBOT, heuristic="manual").prepare()
    began = time.perf_counter()
    plan = planner.plan(task.start, task.goal, weight=1.5, refinable=True)
    return plan, time.perf_counter() - began


def run(folder: Path) -> dict[str, dict]:
    """Plans all tasks and writes their figures to a folder."""
    from hdsp.viz import save_motion, save_planned_path

    folder.mkdir(parents=True, exist_ok=True)
    found = {}
    for name, each in TASKS.items():
        plan, seconds = solve(each)
        found[name] = {"title": each.title} | facts([plan], seconds)
        if not plan.solved:
            continue
        save_motion(plan.refine(), folder / f"{ROBOT}_{name}_side.png", title=each.title)
        if name == "stairs":
            path = folder / f"{ROBOT}_{name}_top.png"
            save_planned_path(plan.terrain, plan.states, plan.actions, plan.robot, path, each.title)
    return found


def page(found: dict[str, dict]) -> str:
    """The table and the explanations in docs/own-robot.md."""
    rows = ["| task | planned in (s) | steps | legs (m) | problems |", "|---|---|---|---|---|"]
    for one in found.values():
        more = "| no way | | |"
        if one["solved"]:
            more = f"| {one['steps']} | {one['legs'][0]} to {one['legs'][1]} | {one['problems']} |"
        rows.append(f"| {one['title']} | {one['seconds']:.1f} {more}")
    words = [f"- {one['title']}: *{one['words'][0]}*" for one in found.values()]
    return "\n".join([*rows, "", "Output of `explain()`:", "", *words])


def main() -> None:
    write_page(__doc__, "examples.sold_robot", "own-robot.md", run, page)


if __name__ == "__main__":
    main()
