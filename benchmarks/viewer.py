"""The viewer: time from the end of a drag to the drawn path, on a random arena of 10 x 10 m.

    python -m benchmarks.viewer [--drags 20] [--size 10] [--seed 0] [--robot momaro] [--weight 1.25]
        [--heuristics manual learned]

A goal is dragged to random places to which a way exists. The clock runs from the release of the handle until the path
is in the scene; a browser on the same machine gets it within some milliseconds. The first plan, the compilation, and
the preparation of the heuristic for the whole map come before. The last line is JSON: ``drag_to_path_ms`` is the median
with the manual heuristic, ``learned_drag_to_path_ms`` with the learned one; ``cpu_ms`` are processor milliseconds of
the process in the same time, which depend less on other work on the machine.
"""

from __future__ import annotations

import argparse
import json
import time
from statistics import median

import numpy as np

PATIENCE = 600  # s


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--drags", type=int, default=20)
    parser.add_argument("--size", type=float, default=10.0, help="m along each side of the arena")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robot", default="momaro")
    parser.add_argument("--weight", type=float, default=1.25)
    parser.add_argument("--heuristics", nargs="+", choices=("manual", "learned"), default=["manual", "learned"])
    arguments = parser.parse_args(argv)

    from hdsp.planning.compiled import compile_for
    from hdsp.planning.viewing.map_viewer import MapViewer
    from hdsp.planning.viewing.planning_session import PlanningRequest
    from hdsp.terrain import random_arena

    terrain = random_arena(arguments.seed, arguments.size)
    viewer = MapViewer(terrain, PlanningRequest(robot=arguments.robot, weight=arguments.weight), port=0)
    result: dict = {"size_m": arguments.size, "drags": arguments.drags}
    try:
        assert viewer.session.wait(PATIENCE), "no first plan"
        goals = reachable_goals(viewer, arguments.drags, np.random.default_rng(arguments.seed))
        for heuristic in arguments.heuristics:
            name = "" if heuristic == "manual" else f"{heuristic}_"
            viewer.change(heuristic=heuristic)
            assert viewer.session.wait(PATIENCE), f"{heuristic}: no plan"
            compile_for(viewer.answer.planner.robot, viewer.answer.planner.heuristic)  # waits for the session's thread
            wall, cpu = zip(*(drag(viewer, goal) for goal in goals), strict=True)
            print(
                f"{heuristic}: drag to path {1000 * median(wall):.0f} ms (median of {len(goals)}; longest "
                f"{1000 * max(wall):.0f} ms), {1000 * median(cpu):.0f} ms of the processor"
            )
            result[f"{name}drag_to_path_ms"] = round(1000 * median(wall), 1)
            result[f"{name}longest_ms"] = round(1000 * max(wall), 1)
            result[f"{name}cpu_ms"] = round(1000 * median(cpu), 1)
    finally:
        viewer.close()
    print(json.dumps(result))
    return result


def reachable_goals(viewer, count: int, random: np.random.Generator) -> list[tuple[float, ...]]:
    """Random poses (x, y, heading) with a way from the viewer's start."""
    planner, start = viewer.answer.planner, viewer.session.request.start
    (x, y), (length, width) = planner.terrain.origin, planner.terrain.size
    found: list[tuple[float, ...]] = []
    while len(found) < count:
        pose = x + length * random.random(), y + width * random.random(), 2 * np.pi * random.random() - np.pi
        if planner.valid(pose) and planner.plan(start, pose, 1.25, polish=0.0, time=2.0).solved:
            found.append(tuple(float(value) for value in pose))
    return found


def drag(viewer, goal: tuple[float, ...]) -> tuple[float, float]:
    """Seconds and processor seconds from the release of the goal's handle until the path is drawn."""
    viewer.answered.clear()
    began, cpu = time.perf_counter(), time.process_time()
    viewer.change(goal=goal)
    assert viewer.answered.wait(PATIENCE)
    seconds = time.perf_counter() - began, time.process_time() - cpu
    assert viewer.answer.request.goal == goal and viewer.answer.plan.solved
    assert viewer.session.wait(PATIENCE)
    return seconds


if __name__ == "__main__":
    main()
