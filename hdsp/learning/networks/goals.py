"""Goals as networks see them."""

import torch
from torch import Tensor

#: Number of features of a goal.
GOAL_FEATURES = 7


def goal_features(goals: Tensor) -> Tensor:
    """(dx, dy, dtheta), distance, direction and whether it is a turn; [..., 3] to [..., 7], order of magnitude one.

    The cost of a goal on flat ground depends on distance times a function of direction, which these make easy to learn.
    """
    position = goals[..., :2]
    distance = position.norm(dim=-1, keepdim=True)
    direction = position / distance.clamp_min(1e-6)
    return torch.cat([goals, distance, direction, (distance < 1e-3).to(goals.dtype)], dim=-1)
