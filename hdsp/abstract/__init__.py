"""Abstract planning: costs of abstract actions, their search, and the step to detailed states."""

from hdsp.abstract.abstract_conformance import check_abstract_costs
from hdsp.abstract.abstract_costs import AbstractCosts, FlatCosts, LocalCosts, TaskPredictor
from hdsp.abstract.manual import ManualCosts, ManualSettings
from hdsp.abstract.prepared_graph import PreparedGraph, cost_to_go

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
