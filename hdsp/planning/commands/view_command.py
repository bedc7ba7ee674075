"""The commands `hdsp view` and `hdsp demo`: plans on a map in the browser."""

from __future__ import annotations

import argparse
import threading
import webbrowser
from typing import TYPE_CHECKING

from hdsp.base.compilation import compilations
from hdsp.base.errors import InputError
from hdsp.base.files import writable_file
from hdsp.base.gradual import now
from hdsp.planning.commands.command_parser import add_heuristic, add_robot
from hdsp.planning.commands.console import Console
from hdsp.planning.commands.map_file_commands import add_cell_size, add_map_reading, map_options
from hdsp.planning.commands.plan_command import NO_PLAN, goal_pose, start_pose
from hdsp.terrain.height_map import HeightMap
from hdsp.viz.viewer import PORT

if TYPE_CHECKING:
    from hdsp.planning.viewing.map_viewer import MapViewer

#: Seed of the demo's arena, and a way through its door and up its stairs.
_ARENA, _START, _GOAL = 7, (1.0, 3.0, 0.0), (4.25, 0.75, None)
_LINE = 2.0  # s, between two lines on the progress


def add_view(commands) -> None:
    """Adds the command `view`."""
    parser = commands.add_parser(
        "view", help="plan on a height map in the browser, with start and goal to drag", description=_view.__doc__
    )
    parser.add_argument("map", metavar="MAP", help="a height map with cells of up to 0.2 m, or a point cloud")
    parser.add_argument(
        "--start", nargs=3, type=float, metavar=("X", "Y", "DEGREES"), help="first start (default: chosen)"
    )
    parser.add_argument(
        "--goal", nargs="+", metavar=("X", "Y DEGREES"),
        help="first goal; without DEGREES, or with the word free, any heading (default: chosen)",
    )  # fmt: skip
    add_robot(parser)
    add_heuristic(parser)
    parser.add_argument("--weight", type=float, default=1.25, help="how much speed counts, from 1 on (default: 1.25)")
    parser.add_argument("--tolerance", type=float, default=0.0, help="m around the goal (default: 0)")
    parser.add_argument("--margin", type=float, default=0.0, help="m that the body keeps clear of obstacles")
    parser.add_argument("--page", metavar="HTML", help="write the first plan as an HTML page, and end")
    _add_server(parser)
    add_map_reading(parser)
    add_cell_size(parser)
    parser.set_defaults(run=_view)


def add_demo(commands) -> None:
    """Adds the command `demo`."""
    parser = commands.add_parser("demo", help="a robot climbs stairs in the browser", description=_demo.__doc__)
    add_robot(parser)
    _add_server(parser)
    parser.set_defaults(run=_demo)


def _add_server(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--port", type=int, default=PORT, help=f"first port to try, on this machine only (default: {PORT})"
    )
    parser.add_argument(
        "--no-browser", dest="browser", action="store_false", help="print the address, and open no browser"
    )


def _view(chosen: argparse.Namespace) -> int:
    """Shows a map in the browser and plans on it: drag start and goal, choose robot, heuristic, weight and layers."""
    from hdsp.planning.viewing.map_viewer import MapViewer
    from hdsp.planning.viewing.planning_session import PlanningRequest

    if chosen.page:
        writable_file(chosen.page, "page", (".html",))
    request = PlanningRequest(
        start=None if chosen.start is None else tuple(start_pose(chosen.start).tolist()),
        goal=None if chosen.goal is None else goal_pose(chosen.goal),
        robot=chosen.robot,
        heuristic=chosen.heuristic,
        weight=chosen.weight,
        tolerance=chosen.tolerance,
        margin=chosen.margin,
    )
    terrain = HeightMap.load(chosen.map, **map_options(chosen))
    for note in terrain.frame.notes:
        chosen.console.tell(f"map: {note}")
    viewer = MapViewer(terrain, request, chosen.port)
    return _page(viewer, chosen) if chosen.page else _serve(viewer, chosen)


def _demo(chosen: argparse.Namespace) -> int:
    """Makes an arena with a door and stairs, plans through it, and shows the robot's motion in the browser."""
    return _serve(demo_viewer(chosen.robot, chosen.port), chosen)


def demo_viewer(robot: str, port: int) -> MapViewer:
    """Returns the viewer of the demo, which works in threads of its own.

    Args:
        robot: preset name or path to a YAML file.
        port: first port to try.
    """
    from hdsp.planning.viewing.map_viewer import MapViewer
    from hdsp.planning.viewing.planning_session import PlanningRequest
    from hdsp.terrain.random_arenas import random_arena

    return MapViewer(random_arena(_ARENA), PlanningRequest(_START, _GOAL, robot), port, play=True)


def _serve(viewer: MapViewer, chosen: argparse.Namespace) -> int:
    """Shows a viewer until Ctrl-C."""
    console, port = chosen.console, chosen.port
    try:
        busy = "" if viewer.address.endswith(f":{port}") or port == 0 else f" (port {port} is busy)"
        console.tell(f"{viewer.address}{busy}: open it in a browser; Ctrl-C ends")
        if chosen.browser:
            webbrowser.open(viewer.address)
        _wait(viewer, console)
        if viewer.answer is not None:
            console.tell(viewer.words or f"no plan: {viewer.answer.plan.status}")
        elif viewer.error:
            raise InputError(viewer.error)
        threading.Event().wait()
    except KeyboardInterrupt:
        console.progress.clear()
    finally:
        viewer.close()
    return 0


def _page(viewer: MapViewer, chosen: argparse.Namespace) -> int:
    """Writes the first answer of a viewer as a page."""
    try:
        _wait(viewer, chosen.console)
        if viewer.answer is None:
            raise InputError(viewer.error)
        plan = viewer.answer.plan
        plan.view(chosen.page)
        chosen.console.tell(f"{plan.explain()}\n{chosen.page}: page")
        return 0 if plan.solved else NO_PLAN
    finally:
        viewer.close()


def _wait(viewer: MapViewer, console: Console) -> None:
    """Waits for the first answer, with a line every two seconds; compilation has its own lines."""
    began, compiled = now(), compilations.done
    while not viewer.answered.wait(_LINE):
        if compilations.done == compiled:
            if not console.progress.quiet:
                console.warn(f"{viewer.work or 'starting'} ... {now() - began:.0f} s")
        else:
            compiled = compilations.done
            viewer.on_work(f"compiling the planner for this machine, {compiled} kernels so far", None)
