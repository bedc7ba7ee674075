"""The command `hdsp warmup`: kernels are compiled before the first plan needs them."""

from __future__ import annotations

import argparse
import signal

from hdsp.base.compilation import compilations
from hdsp.base.ending import ended_by
from hdsp.base.gradual import now
from hdsp.planning.commands.command_parser import add_heuristic, add_robot
from hdsp.terrain.height_map import HeightMap


def add_warmup(commands) -> None:
    """Adds the command `warmup`."""
    parser = commands.add_parser(
        "warmup", help="compile the planner for this machine, once", description=_warm_up.__doc__
    )
    add_robot(parser)
    add_heuristic(parser)
    parser.set_defaults(run=_warm_up)


def _warm_up(chosen: argparse.Namespace) -> None:
    """Compiles all code that plans for a robot and a heuristic need, or finds it on disk. Later starts take seconds."""
    from hdsp.planning.compiled import warm_up
    from hdsp.planning.planner import Planner

    began, before = now(), compilations.done
    with ended_by(signal.SIGINT):  # a compiler looks at no signals for seconds
        planner = Planner(HeightMap.flat((80, 80)), chosen.robot, chosen.heuristic)
        warm_up(planner.robot, planner.heuristic)
    compiled = compilations.done - before
    about = f"{compiled} kernels compiled" if compiled else "all kernels were there"
    print(f"ready: {about}, {now() - began:.1f} s")
