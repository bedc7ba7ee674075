"""The command `hdsp plan`: a path on a height map, its table and its picture."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.files import writable_file
from hdsp.detailed.motion.motion_files import check_motion_path
from hdsp.planning.commands.map_file_commands import add_cell_size, add_map_reading, map_options
from hdsp.terrain.conditioning import is_conditioned
from hdsp.terrain.height_map import HeightMap

#: Exit status where there is no plan.
NO_PLAN = 3
_TABLES = ".csv", ".txt"


def add_plan(commands) -> None:
    """Adds the command `plan`."""
    parser = commands.add_parser("plan", help="plan a path on a height map", description=_plan.__doc__)
    pose: dict[str, Any] = {"nargs": 3, "type": float, "required": True, "metavar": ("X", "Y", "DEGREES")}
    parser.add_argument("map", metavar="MAP", help="a height map with cells of up to 0.2 m, or a point cloud")
    parser.add_argument("--start", help="base position in m, heading against the x axis", **pose)
    parser.add_argument(
        "--goal", nargs="+", action="append", required=True, metavar=("X", "Y DEGREES"),
        help="the same; without DEGREES, or with the word free, any heading. Several --goal: the one that costs least",
    )  # fmt: skip
    parser.add_argument(
        "--tolerance", nargs="+", type=float, metavar=("M", "DEGREES"),
        help="distance from the goal, and difference in heading, within which the path may end (default: none)",
    )  # fmt: skip
    parser.add_argument(
        "--no-start-free", dest="start_free", action="store_false",
        help="at the start, unknown ground and the robot itself in the map count as they are",
    )  # fmt: skip
    parser.add_argument(
        "--way-out", action="store_true", help="a robot too near to obstacles at the start drives away from them first"
    )
    parser.add_argument("--robot", default="momaro", help="a preset or a YAML file (default: momaro)")
    parser.add_argument(
        "--heuristic", default="manual",
        help="geometric, manual, learned (the abstraction that comes with the package) or learned:FOLDER "
        "(default: manual)",
    )  # fmt: skip
    parser.add_argument("--weight", type=float, default=1.25, help="how much speed counts, from 1 on (default: 1.25)")
    parser.add_argument(
        "--polish", type=float, metavar="S",
        help="s in which parts of the path are planned again, so that it gets cheaper; 0 for none (default: 0.2 if "
        "nothing bounds its cost)",
    )  # fmt: skip
    parser.add_argument(
        "--margin", type=float, default=0.0, help="m that the body keeps clear of obstacles (default: 0)"
    )
    parser.add_argument(
        "--no-conditioning", dest="conditioning", action="store_false", help="plan on the map as it is, with its noise"
    )
    parser.add_argument("--time", type=float, default=60.0, help="s after which the search gives up (default: 60)")
    parser.add_argument(
        "--out",
        help="a CSV file of the states (m, rad) and of the actions that lead to them, also in the frame of the map's "
        "source if that is another one",
    )
    parser.add_argument(
        "--motion", "--record", dest="motions", action="append", default=[], metavar="FILE",
        help="the motion with its times: .csv, .json, .npz; .mcap (Foxglove), .gif, .mp4; no suffix: a ROS 2 bag",
    )  # fmt: skip
    parser.add_argument("--picture", help="a PNG of the path, or of the causes why there is none")
    add_map_reading(parser)
    add_cell_size(parser)
    parser.set_defaults(run=_plan)


def _plan(chosen: argparse.Namespace) -> int:
    """Plans a path and says what it does and costs, or why there is none (exit status 3)."""
    from hdsp.planning.planner import Planner

    _check_outputs(chosen)
    terrain = HeightMap.load(chosen.map, **map_options(chosen))
    for note in terrain.frame.notes:
        print(f"map: {note}")
    planner = Planner(terrain, chosen.robot, chosen.heuristic, chosen.margin, conditioning=chosen.conditioning)
    report = planner.conditioning
    # A note of a conditioned map already names its unknown share.
    if report is not None and (report.changed or (report.unknown and not is_conditioned(terrain.frame.notes))):
        print(f"map: {report}")
    goals = [_goal(words) for words in chosen.goal]
    plan = planner.plan(
        _pose(chosen.start), goals if len(goals) > 1 else goals[0], chosen.weight,
        time=chosen.time, polish=chosen.polish, tolerance=_tolerance(chosen.tolerance), start_free=chosen.start_free,
        way_out=chosen.way_out, refinable=bool(chosen.motions),
    )  # fmt: skip
    if len(goals) > 1 and plan.goal_index is not None:
        print(f"goal {plan.goal_index + 1} of {len(goals)}: {' '.join(chosen.goal[plan.goal_index])}")
    print(plan.explain())
    if not plan.solved:
        if chosen.picture:
            plan.show(chosen.picture)
            print(f"{chosen.picture}: picture of the causes")
        return NO_PLAN
    print(f"{plan.stats.expansions:,} states expanded in {plan.stats.seconds:.2f} s")
    print(f"proved: at most {math.ceil(100 * plan.bound) / 100:.2f} times the least possible cost")
    if chosen.out:
        plan.write(chosen.out)
        print(f"{chosen.out}: {len(plan.states)} states{_frames(terrain)}")
    for path in chosen.motions:
        plan.save(path)
        print(f"{path}: motion, {plan.refine().duration:.1f} s")
    if chosen.picture:
        plan.show(chosen.picture)
        print(f"{chosen.picture}: picture")
    return 0


def _check_outputs(chosen: argparse.Namespace) -> None:
    """Checks the output files and the packages for them before the search."""
    if chosen.out:
        writable_file(chosen.out, "table", _TABLES)
    for path in chosen.motions:
        check_motion_path(path)
    if chosen.picture:
        from hdsp.viz import save_planned_path  # noqa: F401, an extra that may be missing

        writable_file(chosen.picture, "picture", (".png",))


def _pose(values: Sequence[float]) -> np.ndarray:
    """Pose (m, m, rad) from (m, m, degrees); full turns are dropped."""
    x, y, degrees = values
    return np.array([x, y, math.radians(math.remainder(degrees, 360) if math.isfinite(degrees) else degrees)])


def _goal(words: Sequence[str]) -> tuple[float, float, float | None]:
    """Goal (m, m, rad) from the words X Y DEGREES; None for a free heading.

    Raises:
        InputError: other words.
    """
    free = len(words) == 2 or (len(words) == 3 and words[2] == "free")
    try:
        values = [float(word) for word in words[: 2 if free else None]]
    except ValueError:
        values = []
    if len(values) != (2 if free else 3):
        raise InputError(f"--goal {' '.join(words)}: need X Y DEGREES, X Y free, or X Y")
    x, y, heading = _pose([*values, 0.0] if free else values).tolist()
    return x, y, None if free else heading


def _tolerance(values: Sequence[float] | None) -> float | tuple[float, float] | None:
    """Tolerance (m, rad) from (m, degrees).

    Raises:
        InputError: more than two values.
    """
    if values is None or len(values) == 1:
        return None if values is None else values[0]
    if len(values) > 2:
        raise InputError(f"--tolerance takes M, or M DEGREES, not {len(values)} values")
    return values[0], math.radians(values[1])


def _frames(terrain: HeightMap) -> str:
    """Frames of the table, in words."""
    frame = terrain.frame
    if frame.is_source and not (frame.name or frame.crs):
        return ""
    crs = f"({frame.crs})" if frame.name and frame.crs else frame.crs
    source = " ".join(filter(None, (frame.name, crs))) or "the source"
    return f", in the frame {source}" if frame.is_source else f", in the frame of the map; source_*: in {source}"
