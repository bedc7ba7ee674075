"""The geometric heuristic."""

import numpy as np

from hdsp.detailed.search.estimate import Estimate, geometric_estimate
from hdsp.planning.heuristics.heuristic import Heuristic


class GeometricHeuristic(Heuristic):
    """Distance, heading and foot configuration, each at its least cost (paper, Sec. VI-B)."""

    name = "geometric"
    admissible = True
    consistent = True

    def estimate_for(self, goal: np.ndarray) -> Estimate:
        return geometric_estimate(self.world, goal)

    def estimate_for_nearest(self, goals: np.ndarray, groups: np.ndarray) -> Estimate:
        return geometric_estimate(self.world, goals, groups)
