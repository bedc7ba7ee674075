"""Options of `hdsp plan`."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.planning.commands.command_parser import add_heuristic, add_json, add_robot, takes_file
from hdsp.planning.commands.map_file_commands import add_cell_size, add_map_reading

#: Time of a search and weight, where none is given, s and W.
TIME, WEIGHT = 60.0, 1.25
_EXAMPLES = """examples:
  hdsp plan map.npz --start 1 2 0 --goal 4 3 90 --picture plan.png
  hdsp plan map.bag --start 1 2 0 --goal 4 3 free --tolerance 0.2 30
  hdsp plan map.npz --start 1 2 0 --goal 4 3 --goal 5 1 --each
  hdsp plan map.npz --start 1 2 0 --goal 4 3 0 --heuristic learned --json
  hdsp plan map.npz --start 1 2 0 --goal 4 3 0 --improve 20

exit status: 0 solved, 1 bad input, 2 wrong usage, 3 no plan, 130 interrupted"""


def add_plan_options(parser: argparse.ArgumentParser) -> None:
    """Adds all options of `hdsp plan`."""
    parser.epilog = _EXAMPLES
    takes_file(parser.add_argument("map", metavar="MAP", help="a height map with cells of up to 0.2 m, or points"))
    add_json(parser)
    _add_query(parser.add_argument_group("query"))
    _add_search(parser.add_argument_group("search"))
    _add_results(parser.add_argument_group("results"))
    add_map_reading(parser)
    add_cell_size(parser)


def _add_query(group: Any) -> None:
    pose: dict[str, Any] = {"nargs": 3, "type": float, "required": True, "metavar": ("X", "Y", "DEGREES")}
    group.add_argument("--start", help="base position in m, heading against the x axis", **pose)
    group.add_argument(
        "--goal", nargs="+", action="append", required=True, metavar=("X", "Y DEGREES"),
        help="the same; without DEGREES, or with the word free, any heading. Several --goal: the one that costs least",
    )  # fmt: skip
    group.add_argument("--each", action="store_true", help="with several --goal: a plan to each of them")
    group.add_argument(
        "--tolerance", nargs="+", type=float, metavar=("M", "DEGREES"),
        help="distance from the goal, and difference in heading, within which the path may end (default: none)",
    )  # fmt: skip
    group.add_argument(
        "--no-start-free", dest="start_free", action="store_false",
        help="at the start, unknown ground and the robot itself in the map count as they are",
    )  # fmt: skip
    group.add_argument(
        "--way-out", action="store_true", help="a robot too near to obstacles at the start drives away from them first"
    )
    add_robot(group)
    group.add_argument(
        "--margin", type=float, default=0.0, metavar="M", help="m that the body keeps clear of obstacles (default: 0)"
    )
    group.add_argument(
        "--no-conditioning", dest="conditioning", action="store_false", help="plan on the map as it is, with its noise"
    )


def _add_search(group: Any) -> None:
    add_heuristic(group)
    group.add_argument(
        "--weight", type=float, metavar="W",
        help=f"how much speed counts, from 1 on (default: {WEIGHT}; with --improve the last one, 1)",
    )  # fmt: skip
    group.add_argument(
        "--polish", type=float, metavar="S",
        help="seconds in which parts of the path are planned again, so that it gets cheaper; 0 for none (default: 0.3 "
        "if nothing bounds its cost)",
    )  # fmt: skip
    group.add_argument(
        "--improve", type=float, metavar="S",
        help="better and better plans for so many seconds, each told with its cost and bound; Ctrl-C keeps the best",
    )  # fmt: skip
    group.add_argument("--time", type=float, metavar="S", help=f"seconds after which it gives up (default: {TIME:g})")
    group.add_argument("--expansions", type=int, metavar="N", help="expanded states after which it gives up")
    group.add_argument("--memory", type=float, metavar="GIB", help="memory for its states, GiB (default: 4)")


def _add_results(group: Any) -> None:
    takes_file(
        group.add_argument(
            "--out", metavar="CSV",
            help="a CSV file of the states (m, rad) and of the actions that lead to them, also in the frame of the "
            "map's source if that is another one",
        )
    )  # fmt: skip
    takes_file(
        group.add_argument(
            "--motion", "--record", dest="motions", action="append", default=[], metavar="FILE",
            help="the motion with its times: .csv, .json, .npz; .mcap (Foxglove), .gif, .mp4; no suffix: a ROS 2 bag",
        )
    )  # fmt: skip
    takes_file(group.add_argument("--picture", metavar="PNG", help="the path, or the causes why there is none"))


def start_pose(values: Sequence[float]) -> np.ndarray:
    """Pose (m, m, rad) from (m, m, degrees); full turns are dropped."""
    x, y, degrees = values
    return np.array([x, y, math.radians(math.remainder(degrees, 360) if math.isfinite(degrees) else degrees)])


def goal_pose(words: Sequence[str]) -> tuple[float, float, float | None]:
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
    x, y, heading = start_pose([*values, 0.0] if free else values).tolist()
    return x, y, None if free else heading


def tolerance_of(values: Sequence[float] | None) -> float | tuple[float, float] | None:
    """Tolerance (m, rad) from (m, degrees).

    Raises:
        InputError: more than two values.
    """
    if values is None or len(values) == 1:
        return None if values is None else values[0]
    if len(values) > 2:
        raise InputError(f"--tolerance takes M, or M DEGREES, not {len(values)} values")
    return values[0], math.radians(values[1])


def limits_of_search(chosen: argparse.Namespace) -> dict[str, Any]:
    """Limits for `Planner.plan` or `Planner.improve`.

    Raises:
        InputError: two limits of time, or memory that is no positive number.
    """
    if chosen.improve is not None and chosen.time is not None:
        raise InputError("--improve takes its seconds itself; leave out --time")
    if chosen.improve is not None and chosen.each:
        raise InputError("--improve takes one query; leave out --each")
    limits: dict[str, Any] = {"time": chosen.improve if chosen.improve is not None else chosen.time}
    if limits["time"] is None:
        limits["time"] = TIME
    if chosen.expansions is not None:
        limits["expansions"] = chosen.expansions
    if chosen.memory is not None:
        if not (math.isfinite(chosen.memory) and chosen.memory > 0):
            raise InputError(f"--memory is {chosen.memory:g}; need a positive number of GiB")
        limits["memory"] = int(chosen.memory * 2**30)
    return limits
