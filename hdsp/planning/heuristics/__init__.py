"""Heuristics: estimates of the cost from a detailed state to the goal.

- ``heuristic``: the contract, ``Heuristic``.
- ``geometric``: distance, heading and feet. Admissible and consistent.
- ``grid``: the way of the base over the map. Admissible and consistent, and aware of walls.
- ``abstract``: costs-to-go in an abstraction (manual, learned, any ``AbstractCosts``). Well informed, not admissible.
- ``heuristic_choice``: heuristics by name.
- ``standing``: abstract states at which the robot can stand.
"""

from hdsp.planning.heuristics.abstract import AbstractHeuristic
from hdsp.planning.heuristics.geometric import GeometricHeuristic
from hdsp.planning.heuristics.grid import GridHeuristic
from hdsp.planning.heuristics.heuristic import Heuristic
from hdsp.planning.heuristics.standing import standing_states

__all__ = ["AbstractHeuristic", "GeometricHeuristic", "GridHeuristic", "Heuristic", "standing_states"]
