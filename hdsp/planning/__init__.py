"""Planning: queries and their answers.

- `planner`: `Planner`, the entry point; `arguments`: checks of its arguments
- `shared_ground`: everything that follows from a planner's map, in one object
- `measured_map`, `map_changes`: the conditioned map of a planner; changed cells between two maps
- `heuristics`: the contract `Heuristic`; geometric and abstract heuristics
- `ends`: states at which a plan may begin and end
- `query`: one query with its search or its proof; `compiled`: its kernels, compiled before the clock starts
- `refinable`, `improving`: plans without impossible steps; anytime planning
- `polish`: windows of a plan, planned again at W = 1
- `answers`: `Plan`, plans in words, reasons for the absence of a plan
- `collisions`: an independent check of plans against arenas
- `heuristic_conformance`: a check of your own heuristic
- `margin`: a margin around the base
- `viewing`: the viewer in the browser, with a session that follows its user
- `cli`, `commands`: the command `hdsp`
"""

from hdsp.planning.answers.plan_statistics import PlanStatistics
from hdsp.planning.answers.plans import Plan
from hdsp.planning.collisions import Collision, PlanCheck, check_plan
from hdsp.planning.heuristic_conformance import check_heuristic
from hdsp.planning.heuristics import AbstractHeuristic, GeometricHeuristic, Heuristic
from hdsp.planning.margin import with_margin
from hdsp.planning.planner import Planner

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
