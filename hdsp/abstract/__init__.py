"""Abstract planning: costs of abstract actions, their search, and the step to detailed states.

- `abstract_costs`: the contracts `AbstractCosts`, `LocalCosts` and `TaskPredictor`, and flat-ground costs
- `abstract_conformance`: a checker for own implementations
- `manual`: the manually tuned abstraction
- `oracle`: costs of the detailed planner from one state; `oracle_costs`: on a map
- `prepared_graph`: costs-to-go on a map (`dijkstra`: search, `repair`: after a change, `bridging`: between action ends)
- `corridor`: costs-to-go for one start, from few edges; `cut_off`: for states without a path
- `transform`: detailed states of abstract ones
"""

from hdsp.abstract.abstract_conformance import check_abstract_costs
from hdsp.abstract.abstract_costs import (
    AbstractCosts,
    BoundedCosts,
    FlatCosts,
    GradualCosts,
    LocalCosts,
    Region,
    TaskPredictor,
)
from hdsp.abstract.manual import ManualCosts, ManualSettings
from hdsp.abstract.oracle import CostKind, LabelSettings, task_costs
from hdsp.abstract.oracle_costs import OracleCosts
from hdsp.abstract.prepared_graph import PreparedGraph, cost_to_go
from hdsp.abstract.transform import feet_at, feet_at_all

__all__ = [
    "AbstractCosts",
    "BoundedCosts",
    "CostKind",
    "FlatCosts",
    "GradualCosts",
    "LabelSettings",
    "LocalCosts",
    "ManualCosts",
    "ManualSettings",
    "OracleCosts",
    "PreparedGraph",
    "Region",
    "TaskPredictor",
    "check_abstract_costs",
    "cost_to_go",
    "feet_at",
    "feet_at_all",
    "task_costs",
]
