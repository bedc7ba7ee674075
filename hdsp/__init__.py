"""Hybrid driving-stepping planning: a detailed 7D planner and learned abstractions as its heuristic.

    import hdsp

    terrain = hdsp.HeightMap.load("arena.npz")
    planner = hdsp.Planner(terrain, robot="momaro", heuristic="learned")
    plan = planner.plan(start=(1.0, 2.0, 0.0), goal=(4.0, 3.0, 1.57), weight=1.25)
    print(plan.explain())

Importing this package imports neither torch nor matplotlib, which load when first used. ``load_abstraction("momaro")``
is the trained abstraction that comes with it; training is in ``hdsp.learning``, pictures in ``hdsp.viz``.
"""

from hdsp.detailed.motion import Motion
from hdsp.detailed.solve import Status
from hdsp.errors import InputError, RefinementError
from hdsp.heightmap import HeightMap
from hdsp.plan import Plan
from hdsp.planner import Planner
from hdsp.pretrained import load_abstraction
from hdsp.robot import Robot
from hdsp.shards import read_tasks

__all__ = [
    "HeightMap", "InputError", "Motion", "Plan", "Planner", "RefinementError", "Robot", "Status", "load_abstraction",
    "read_tasks",
]  # fmt: skip
