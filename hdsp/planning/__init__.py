"""Planning: queries and their answers.

- `planner`: `Planner`, the entry point
- `heuristics`: the contract `Heuristic`; geometric and abstract heuristics
- `heuristic_conformance`: a check of your own heuristic
- `query`: one query with its search or its proof
- `departure`, `way_out`: the start: ground under the robot, and the way out of the clearance of obstacles
- `arrival`: goals with a tolerance or a free heading, and several goals
- `nearby`, `invalid_end`: poses that the robot can leave, and the nearest of them
- `refinable`, `improving`: plans without impossible steps; anytime planning
- `plans`, `plan_statistics`: `Plan` and its statistics
- `explanation`, `findings`, `advice`: plans in words; reasons for the absence of a plan, and help
- `collisions`: an independent check of plans against arenas
- `margin`, `map_changes`: a margin around the base; changed cells between two maps
"""

from hdsp.planning.collisions import Collision, PlanCheck, check_plan
from hdsp.planning.heuristic_conformance import check_heuristic
from hdsp.planning.heuristics import AbstractHeuristic, GeometricHeuristic, Heuristic
from hdsp.planning.margin import with_margin
from hdsp.planning.plan_statistics import PlanStatistics
from hdsp.planning.planner import Planner
from hdsp.planning.plans import Plan

__all__ = [
    "AbstractHeuristic",
    "Collision",
    "GeometricHeuristic",
    "Heuristic",
    "Plan",
    "PlanCheck",
    "PlanStatistics",
    "Planner",
    "check_heuristic",
    "check_plan",
    "with_margin",
]
