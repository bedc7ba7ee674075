"""The abstract representation: costs of abstract actions, their search, and the way from and to detailed states."""

from hdsp.abstract.costs import AbstractCosts, FlatCosts, TaskPredictor
from hdsp.abstract.dijkstra import PreparedGraph, cost_to_go

__all__ = ["AbstractCosts", "FlatCosts", "PreparedGraph", "TaskPredictor", "cost_to_go"]
