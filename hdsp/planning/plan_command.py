"""The command `hdsp plan`: a path on a height map, its table and its picture."""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import Any

import numpy as np

from hdsp.base.files import replacing
from hdsp.planning.map_file_commands import add_cell_size, add_map_reading, map_options
from hdsp.robot.robot import FEET
from hdsp.terrain.height_map import HeightMap

#: Exit status where there is no plan.
NO_PLAN = 3


def add_plan(commands) -> None:
    """Adds the command `plan`."""
    parser = commands.add_parser("plan", help="plan a path on a height map", description=_plan.__doc__)
    pose: dict[str, Any] = {"nargs": 3, "type": float, "required": True, "metavar": ("X", "Y", "DEGREES")}
    parser.add_argument("map", metavar="MAP", help="a height map with cells of up to 0.2 m, or a point cloud")
    parser.add_argument("--start", help="base position in m, heading against the x axis", **pose)
    parser.add_argument("--goal", help="the same", **pose)
    parser.add_argument("--robot", default="momaro", help="a preset or a YAML file (default: momaro)")
    parser.add_argument(
        "--heuristic", default="manual",
        help="geometric, manual, learned (the abstraction that comes with the package) or learned:FOLDER "
        "(default: manual)",
    )  # fmt: skip
    parser.add_argument("--weight", type=float, default=1.25, help="how much speed counts, from 1 on (default: 1.25)")
    parser.add_argument(
        "--margin", type=float, default=0.0, help="m that the body keeps clear of obstacles (default: 0)"
    )
    parser.add_argument(
        "--no-conditioning", dest="conditioning", action="store_false", help="plan on the map as it is, with its noise"
    )
    parser.add_argument("--time", type=float, default=60.0, help="s after which the search gives up (default: 60)")
    parser.add_argument("--out", help="a CSV file of the states (m, rad) and of the actions that lead to them")
    parser.add_argument("--picture", help="a PNG of the path")
    add_map_reading(parser)
    add_cell_size(parser)
    parser.set_defaults(run=_plan)


def _plan(chosen: argparse.Namespace) -> int:
    """Plans a path and says what it does and costs, or why there is none (exit status 3)."""
    from hdsp.planning.planner import Planner

    terrain = HeightMap.load(chosen.map, **map_options(chosen))
    for note in terrain.frame.notes:
        print(f"map: {note}")
    planner = Planner(terrain, chosen.robot, chosen.heuristic, chosen.margin, conditioning=chosen.conditioning)
    if (report := planner.conditioning) is not None and (report.changed or report.unknown):
        print(f"map: {report}")
    start, goal = (np.array([x, y, np.deg2rad(degrees)]) for x, y, degrees in (chosen.start, chosen.goal))
    plan = planner.prepare().plan(start, goal, chosen.weight, time=chosen.time)
    print(plan.explain())
    if not plan.solved:
        return NO_PLAN
    print(f"{plan.stats.expansions:,} states expanded in {plan.stats.seconds:.2f} s")
    if chosen.out:
        with replacing(chosen.out) as temporary:
            _write_states(plan, temporary)
        print(f"{chosen.out}: {len(plan.states)} states")
    if chosen.picture:
        plan.show(chosen.picture)
        print(f"{chosen.picture}: picture")
    return 0


def _write_states(plan, path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["action", "x", "y", "heading", *FEET])
        for action, state in zip(["", *plan.actions], plan.states, strict=True):
            table.writerow([action, *(f"{value:.6g}" for value in state)])
