"""The command `hdsp drive`: a plan driven by a simulated robot."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from hdsp.base.errors import InputError
from hdsp.base.files import writable_file
from hdsp.detailed.motion.motion_files import check_motion_path
from hdsp.planning.commands.command_parser import add_heuristic, add_json, add_robot, takes_file
from hdsp.planning.commands.console import NO_PLAN, Console
from hdsp.planning.commands.json_documents import map_fields, plan_fields
from hdsp.planning.commands.map_file_commands import add_cell_size, add_map_reading
from hdsp.planning.commands.output_files import outputs_of, planning_inputs, refuse_overwriting
from hdsp.planning.commands.plan_command import prepared_planner
from hdsp.planning.commands.plan_options import TIME, WEIGHT, goal_pose, start_pose, tolerance_of
from hdsp.planning.margin import DRIVEN_MARGIN
from hdsp.terrain.height_map import HeightMap

if TYPE_CHECKING:
    from hdsp.planning.driving.driven_run import Run

#: Exit status of a drive that did not arrive.
FAILED = 4
_FILMS = ".gif", ".mp4"
_EXAMPLES = """examples:
  hdsp drive map.npz --start 1 2 0 --goal 4 3 90 --video climb.mp4
  hdsp drive map.npz --start 1 2 0 --goal 4 3 --truth scan.npz --record run.mcap
  hdsp drive map.npz --start 1 2 0 --goal 4 3 0 --seed 1 --json

exit status: 0 arrived, 1 bad input, 2 wrong usage, 3 no plan, 4 drive failed,
130 interrupted"""


def add_drive(commands) -> None:
    """Adds the command `drive`."""
    parser = commands.add_parser(
        "drive", help="plan, and let a simulated robot drive", description=_drive.__doc__, epilog=_EXAMPLES
    )
    takes_file(parser.add_argument("map", metavar="MAP", help="a height map with cells of up to 0.2 m, or points"))
    add_json(parser)
    parser.add_argument(
        "--start", nargs=3, type=float, required=True, metavar=("X", "Y", "DEGREES"),
        help="base position in m, heading against the x axis",
    )  # fmt: skip
    parser.add_argument(
        "--goal", nargs="+", required=True, metavar=("X", "Y DEGREES"),
        help="the same; without DEGREES, or with the word free, any heading",
    )  # fmt: skip
    parser.add_argument(
        "--tolerance", nargs="+", type=float, metavar=("M", "DEGREES"),
        help="distance from the goal, and difference in heading, within which the path may end (default: none)",
    )  # fmt: skip
    add_robot(parser)
    add_heuristic(parser)
    parser.add_argument(
        "--weight", type=float, default=WEIGHT, metavar="W", help=f"how much speed counts (default: {WEIGHT})"
    )
    parser.add_argument(
        "--margin",
        type=float,
        default=DRIVEN_MARGIN,
        metavar="M",
        help=f"m that the body keeps clear of obstacles (default: {DRIVEN_MARGIN:g})",
    )
    parser.add_argument(
        "--time", type=float, default=TIME, metavar="S", help=f"seconds for the search (default: {TIME:g})"
    )
    parser.add_argument(
        "--no-conditioning", dest="conditioning", action="store_false", help="plan on the map as it is, with its noise"
    )
    takes_file(
        parser.add_argument("--truth", metavar="MAP", help="the true ground to drive on (default: the map of the plan)")
    )
    parser.add_argument("--seed", type=int, default=0, help="seed for the noise of the measured pose (default: 0)")
    takes_file(parser.add_argument("--video", metavar="FILE", help="the drive as .mp4 or .gif, drawn by MuJoCo"))
    takes_file(
        parser.add_argument(
            "--record", metavar="FILE", help="all states: .mcap (Foxglove), .csv, .json, .npz; no suffix: a ROS 2 bag"
        )
    )
    add_map_reading(parser)
    add_cell_size(parser)
    parser.set_defaults(run=_drive)


def _drive(chosen: argparse.Namespace) -> int:
    """Plans a path, lets a simulated robot drive along it in MuJoCo, and says whether it arrived (else status 4)."""
    console: Console = chosen.console
    _check_outputs(chosen)
    planner, terrain = prepared_planner(chosen)
    truth = HeightMap.load(chosen.truth) if chosen.truth else None
    with console.progress.during("planning"):
        plan = planner.plan(
            start_pose(chosen.start), goal_pose(chosen.goal), weight=chosen.weight, time=chosen.time,
            tolerance=tolerance_of(chosen.tolerance), refinable=True,
        )  # fmt: skip
    console.tell(plan.explain())
    common = plan_fields(plan) | {"robot": planner.robot.name, "map": map_fields(terrain)}
    if not plan.solved:
        console.document(common)
        return NO_PLAN
    with console.progress.during("driving"):
        run = plan.drive(truth, chosen.seed)
    console.tell(f"{run.cause}: {run.duration:.1f} s, {run.energy:.0f} J, least margin {100 * run.least_margin:.1f} cm")
    console.document(common | {"run": run.facts(), "files": _save(run, chosen)})
    return 0 if run.success else FAILED


def _check_outputs(chosen: argparse.Namespace) -> None:
    """Checks packages, seed and output files before the search."""
    from hdsp.planning.driving.simulated_robot import import_mujoco

    import_mujoco()
    if chosen.seed < 0:
        raise InputError(f"--seed is {chosen.seed}; need a number of at least 0")
    refuse_overwriting(outputs_of(chosen, "video", "record"), planning_inputs(chosen))
    if chosen.video:
        writable_file(chosen.video, "video", _FILMS)
    if chosen.record:
        if Path(chosen.record).suffix.lower() in _FILMS:
            raise InputError(f"--record {chosen.record}: need .mcap, .csv, .json, .npz or no suffix; films are --video")
        check_motion_path(chosen.record)


def _save(run: Run, chosen: argparse.Namespace) -> dict[str, str]:
    """Writes video and recording; returns their names."""
    files = {name: path for name in ("video", "record") if (path := getattr(chosen, name))}
    for name, path in files.items():
        with chosen.console.progress.during(f"writing the {name}"):
            run.save(path)
        chosen.console.tell(f"{path}: {name}")
    return files
