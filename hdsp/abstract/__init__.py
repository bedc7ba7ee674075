"""Abstract planning: costs of abstract actions, their search, and the step to detailed states."""

from hdsp.abstract.abstract_conformance import check_abstract_costs
from hdsp.abstract.abstract_costs import AbstractCosts, FlatCosts, LocalCosts, TaskPredictor
from hdsp.abstract.dijkstra import PreparedGraph, cost_to_go
from hdsp.abstract.manual import ManualCosts, ManualSettings

__all__ = [
    "AbstractCosts",
    "FlatCosts",
    "LocalCosts",
    "ManualCosts",
    "ManualSettings",
    "PreparedGraph",
    "TaskPredictor",
    "check_abstract_costs",
    "cost_to_go",
]
