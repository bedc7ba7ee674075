"""The command `hdsp plan`: a path on a height map, its table and its picture."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hdsp.base.files import writable_file
from hdsp.detailed.motion.motion_files import check_motion_path
from hdsp.planning.commands.console import NO_PLAN, Console
from hdsp.planning.commands.json_documents import map_fields, plan_fields
from hdsp.planning.commands.map_file_commands import map_options
from hdsp.planning.commands.output_files import OutputFile, planning_inputs, refuse_overwriting
from hdsp.planning.commands.plan_options import (
    WEIGHT,
    add_plan_options,
    goal_pose,
    limits_of_search,
    start_pose,
    tolerance_of,
)
from hdsp.terrain.conditioning import is_conditioned
from hdsp.terrain.height_map import HeightMap

if TYPE_CHECKING:
    from hdsp.planning.answers.plans import Plan
    from hdsp.planning.planner import Planner

__all__ = ["NO_PLAN", "add_plan", "goal_pose", "start_pose"]

_TABLES = ".csv", ".txt"
#: Weights of the rounds of --improve above the last one.
_WEIGHTS = (3.0, 2.0, 1.5, 1.25)


def add_plan(commands) -> None:
    """Adds the command `plan`."""
    parser = commands.add_parser("plan", help="plan a path on a height map", description=_plan.__doc__)
    add_plan_options(parser)
    parser.set_defaults(run=_plan)


def _plan(chosen: argparse.Namespace) -> int:
    """Plans a path and says what it does and costs, or why there is none (exit status 3)."""
    console: Console = chosen.console
    _check_outputs(chosen)
    limits, goals = limits_of_search(chosen), [goal_pose(words) for words in chosen.goal]
    planner, terrain = prepared_planner(chosen)
    query = {
        "tolerance": tolerance_of(chosen.tolerance), "start_free": chosen.start_free, "way_out": chosen.way_out,
        "polish": chosen.polish, "refinable": bool(chosen.motions), **limits,
    }  # fmt: skip
    start, goal = start_pose(chosen.start), goals if len(goals) > 1 else goals[0]
    improvements: list[dict[str, Any]] = []
    with console.progress.during("planning"):
        if chosen.improve is not None:
            weights = *(weight for weight in _WEIGHTS if weight > (chosen.weight or 1.0)), chosen.weight or 1.0
            plans = [_improved(planner, (start, goal), weights, query, console, improvements)]
        else:
            query |= {"weight": WEIGHT if chosen.weight is None else chosen.weight, "progress": _shown(console)}
            plans = planner.plan_each(start, goals, **query) if chosen.each else [planner.plan(start, goal, **query)]
    files = [_report(plan, chosen, terrain, number, len(plans)) for number, plan in enumerate(plans)]
    common = {"start": start, "goals": goals, "robot": planner.robot.name, "map": map_fields(terrain)}
    if chosen.each:
        fields = {"plans": [plan_fields(plan) | {"files": own} for plan, own in zip(plans, files, strict=True)]}
    else:
        fields = plan_fields(plans[0]) | {"files": files[0]} if console.as_json else {}
    if chosen.improve is not None:
        fields["improvements"] = improvements
    console.document(common | fields)
    return 0 if all(plan.solved for plan in plans) else NO_PLAN


def prepared_planner(chosen: argparse.Namespace) -> tuple[Planner, HeightMap]:
    """Reads the map and tells what was assumed about it; returns the planner and the map as it was read."""
    from hdsp.planning.planner import Planner

    console: Console = chosen.console
    with console.progress.during(f"reading {Path(chosen.map).name}"):
        terrain = HeightMap.load(chosen.map, **map_options(chosen))
    for note in terrain.frame.notes:
        console.tell(f"map: {note}")
    with console.progress.during("preparing the planner"):
        planner = Planner(terrain, chosen.robot, chosen.heuristic, chosen.margin, conditioning=chosen.conditioning)
    report = planner.conditioning
    # A note of a conditioned map already names its unknown share.
    if report is not None and (report.changed or (report.unknown and not is_conditioned(terrain.frame.notes))):
        console.tell(f"map: {report}")
    return planner, terrain


def _shown(console: Console):
    """Callback that shows how far a search is."""
    return lambda expansions, _: console.progress.detail(f"{expansions:,} states expanded")


def _improved(
    planner: Planner,
    ends: tuple[Any, Any],
    weights: tuple[float, ...],
    query: dict[str, Any],
    console: Console,
    improvements: list[dict[str, Any]],
) -> Plan:
    """Returns the best plan of an anytime search, which tells each; an interrupt ends the search."""
    best = None
    try:
        for plan in planner.improve(*ends, weights, progress=_shown(console), **query):
            best = plan
            if plan.solved:
                figures = {"seconds": plan.stats.seconds, "cost": plan.cost, "bound": plan.bound}
                improvements.append(figures)
                told = f"{figures['seconds']:.2f} s: cost {plan.cost:.3f}, at most {_rounded_up(plan.bound)} times"
                console.tell(f"{told} the least possible cost")
    except KeyboardInterrupt:
        if best is None or not best.solved:
            raise
        best.stats.end("interrupted")
        console.progress.say("interrupted: the best plan so far is kept")
    assert best is not None
    return best


def _report(plan: Plan, chosen: argparse.Namespace, terrain: HeightMap, number: int, count: int) -> dict[str, Any]:
    """Tells about a plan and writes its files; returns their names."""
    console: Console = chosen.console
    goal = number if count > 1 else plan.goal_index
    if len(chosen.goal) > 1 and goal is not None:
        console.tell(f"goal {goal + 1} of {len(chosen.goal)}: {' '.join(chosen.goal[goal])}")
    with console.progress.during("looking for the reasons"):
        words = plan.explain()
    console.tell(words)
    files: dict[str, Any] = {}
    if plan.stats.ended is not None:
        console.tell(f"end of the improvement: {plan.stats.ended.replace('_', ' ')}")
    if plan.solved:
        console.tell(f"{plan.stats.expansions:,} states expanded in {plan.stats.seconds:.2f} s")
        console.tell(f"proved: at most {_rounded_up(plan.bound)} times the least possible cost")
    if plan.solved and chosen.out:
        files["out"] = _numbered(chosen.out, number, count)
        plan.write(files["out"])
        console.tell(f"{files['out']}: {len(plan.states)} states{_frames(terrain)}")
    files |= _save_motions(plan, chosen, number, count) if plan.solved else {}
    if chosen.picture:
        files["picture"] = _numbered(chosen.picture, number, count)
        with console.progress.during("drawing"):
            plan.show(files["picture"])
        console.tell(f"{files['picture']}: picture{'' if plan.solved else ' of the causes'}")
    return files


def _save_motions(plan: Plan, chosen: argparse.Namespace, number: int, count: int) -> dict[str, list[str]]:
    """Writes the motion and tells its duration; returns the names of the files."""
    written = []
    for path in chosen.motions:
        written.append(_numbered(path, number, count))
        with chosen.console.progress.during("writing the motion"):
            plan.save(written[-1])
        chosen.console.tell(f"{written[-1]}: motion, {plan.refine().duration:.1f} s")
    return {"motions": written} if written else {}


def _rounded_up(bound: float) -> str:
    return f"{math.ceil(100 * bound) / 100:.2f}" if math.isfinite(bound) else "infinitely many"


def _numbered(path: str, number: int, count: int) -> str:
    """Name of a file for one of several plans: ``plan.csv`` becomes ``plan-1.csv``."""
    place = Path(path)
    return path if count == 1 else str(place.with_name(f"{place.stem}-{number + 1}{place.suffix}"))


def _check_outputs(chosen: argparse.Namespace) -> None:
    """Checks the output files and the packages for them before the search."""
    if chosen.picture:
        from hdsp.viz import save_planned_path  # noqa: F401, an extra that may be missing
    files = [("--out", chosen.out), *(("--motion", path) for path in chosen.motions), ("--picture", chosen.picture)]
    count = len(chosen.goal) if chosen.each else 1
    outputs = [
        OutputFile(option, _numbered(path, number, count)) for number in range(count) for option, path in files if path
    ]
    refuse_overwriting(outputs, planning_inputs(chosen))
    for option, path in outputs:
        if option == "--out":
            writable_file(path, "table", _TABLES)
        elif option == "--motion":
            check_motion_path(path)
        else:
            writable_file(path, "picture", (".png",))


def _frames(terrain: HeightMap) -> str:
    """Frames of the table, in words."""
    frame = terrain.frame
    if frame.is_source and not (frame.name or frame.crs):
        return ""
    crs = f"({frame.crs})" if frame.name and frame.crs else frame.crs
    source = " ".join(filter(None, (frame.name, crs))) or "the source"
    return f", in the frame {source}" if frame.is_source else f", in the frame of the map; source_*: in {source}"
