"""Goal features for networks."""

import torch
from torch import Tensor

from hdsp.learning.footprint_geometry import GOAL_FEATURES as GOAL_FEATURES


def goal_features(goals: Tensor) -> Tensor:
    """Expands goals [..., 3] to features [..., 7] with magnitude one.

    Features are (dx, dy, dtheta), distance, direction (x, y) and a flag for turns. Flat ground costs are distance times
    a function of direction, which these features make easy to learn.
    """
    position = goals[..., :2]
    distance = position.norm(dim=-1, keepdim=True)
    direction = position / distance.clamp_min(1e-6)
    return torch.cat([goals, distance, direction, (distance < 1e-3).to(goals.dtype)], dim=-1)
