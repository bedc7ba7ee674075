"""What every network of tasks has in common: one trunk per map, shared by all goals of the map."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from hdsp.learning.encoding import HeightEncoding
from hdsp.learning.networks.dense import DenseEvaluation


class TaskNetwork(nn.Module):
    """Cost and feasibility of the tasks of a patch.

    A subclass implements ``map_part`` (all that depends on the patch alone, evaluated once per patch) and ``goal_part``
    (what depends on the goal too, evaluated for each goal), and has its last linear layer as ``heads``. Heights go in
    as they are, in metres with NaN for unknown cells; the encoding belongs to the network.
    """

    def __init__(self, encoding: HeightEncoding):
        super().__init__()
        self.encoding = encoding

    def map_part(self, encoded: Tensor) -> Tensor:
        """Features [B, F] of encoded patches [B, channels, 72, 72]."""
        raise NotImplementedError

    def goal_part(self, features: Tensor, goals: Tensor) -> tuple[Tensor, Tensor]:
        """Cost [B, G] and feasibility logits [B, G] of features [B, F] and goals [B, G, 3]."""
        raise NotImplementedError

    def dense_trunk(self) -> DenseEvaluation | None:
        """What computes ``map_part`` for all patches of a map at once; None if the architecture has no such trunk."""
        return None

    def is_dense(self) -> bool:
        """Whether dense evaluation gives what the evaluation of each patch gives: no padding, and heights that are
        encoded alike in all patches."""
        trunk = self.dense_trunk()
        return trunk is not None and trunk.exact and self.encoding.is_local()

    def forward(self, heights: Tensor, goals: Tensor) -> tuple[Tensor, Tensor]:
        """Evaluates tasks.

        Args:
            heights: float32 [B, 1, 72, 72], metres, NaN = unknown.
            goals: float32 [B, G, 3], (dx, dy, dtheta) in abstract steps in the robot frame of each patch; any G.

        Returns:
            (cost, feasibility logits), float [B, G] each. The cost means something only where the task is feasible.

        Convention: axis 2 of ``heights`` is x, along the robot's heading, axis 3 is y, to its left; the base stands at
        the centre of cell (36, 36).
        """
        features = self.map_part(self.encoding(heights)).float()
        # The trunk may run in bfloat16; what sees the goals is cheap and stays in float32, since costs need its digits.
        with torch.autocast(heights.device.type, enabled=False):
            return self.goal_part(features, goals)


class MapGoalLinear(nn.Linear):
    """A linear layer over [map features, goal features], with the map part computed once per map.

    Same parameters and same result as ``nn.Linear(map_features + goal_features, out)`` on the concatenation; the
    published network appends the goal to the flattened map in this way.
    """

    def __init__(self, map_features: int, goal_features: int, out_features: int):
        super().__init__(map_features + goal_features, out_features)
        self.map_features = map_features

    def forward(self, map_features: Tensor, goal_features: Tensor) -> Tensor:
        """[B, M] and [B, G, K] to [B, G, out]."""
        map_weight, goal_weight = self.weight.split([self.map_features, self.in_features - self.map_features], dim=1)
        of_map = functional.linear(map_features, map_weight, self.bias)
        return of_map[:, None, :] + functional.linear(goal_features, goal_weight)


def initialise_he(network: "TaskNetwork") -> None:
    """He initialisation of all convolutions and linear layers, zero biases, and heads that start near zero.

    PyTorch's default leaves the last convolution of the published network nearly constant over its inputs (0.9 %
    variation against 20 %), and it takes long to leave that plateau.
    """
    for module in network.modules():
        if isinstance(module, (nn.Conv2d, nn.Linear)):
            nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
            if module.bias is not None:
                nn.init.zeros_(module.bias)
    # Costs and logits are of order one half; the first epochs need not be spent on bringing down random ones.
    with torch.no_grad():
        network.heads.weight.mul_(0.1)


def count_parameters(network: nn.Module) -> int:
    """Number of trainable values."""
    return sum(parameter.numel() for parameter in network.parameters() if parameter.requires_grad)
