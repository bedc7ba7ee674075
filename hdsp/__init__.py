"""Hybrid driving-stepping planning: a detailed 7D planner and learned abstractions as its heuristic.

    import hdsp

    terrain = hdsp.HeightMap.load("arena.npz")
    planner = hdsp.Planner(terrain, robot="momaro", heuristic="learned")
    plan = planner.plan(start=(1.0, 2.0, 0.0), goal=(4.0, 3.0, 1.57), weight=1.25)
    print(plan.explain())

Importing this package imports neither torch nor matplotlib, which load when first used. ``load_abstraction("momaro")``
is the trained abstraction that comes with it; training is in ``hdsp.learning``, pictures in ``hdsp.viz``.
"""

from hdsp.base.errors import InputError, RefinementError
from hdsp.detailed.motion.motion import Motion
from hdsp.detailed.search.outcome import Status
from hdsp.labels.shards import read_tasks
from hdsp.learning.loading import load_abstraction
from hdsp.planning.answers.plans import Plan
from hdsp.planning.planner import Planner
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap

__all__ = [
    "HeightMap", "InputError", "Motion", "Plan", "Planner", "RefinementError", "Robot", "Status", "load_abstraction",
    "read_tasks",
]  # fmt: skip
