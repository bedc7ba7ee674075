"""Base class for task networks: one trunk per map, shared by all its goals."""

from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from hdsp.learning.encoding import encode
from hdsp.learning.learning_settings import HeightEncoding
from hdsp.learning.networks.dense import DenseEvaluation


class TaskNetwork(nn.Module):
    """Predicts cost and feasibility for a patch's tasks.

    A subclass implements ``map_part`` (depends on the patch alone, runs once per patch) and ``goal_part`` (depends on
    the goal too, runs for each goal). Its last linear layer is named ``heads``. Input heights are in metres, NaN =
    unknown; the encoding belongs to the network. A subclass is made from an encoding and its options.

    Attributes:
        Options: settings class of the architecture's options (`hdsp.base.settings.checked`).
        predicts_planning_cost: whether costs for planning follow as a third output; the tasks it learns from need them.
    """

    Options: ClassVar[type]
    heads: nn.Linear
    predicts_planning_cost = False

    def __init__(self, encoding: HeightEncoding):
        super().__init__()
        self.encoding = encoding

    def map_part(self, encoded: Tensor) -> Tensor:
        """Returns features [B, F] for encoded patches [B, channels, 72, 72]."""
        raise NotImplementedError

    def goal_part(self, features: Tensor, goals: Tensor) -> tuple[Tensor, ...]:
        """Returns the outputs of ``forward`` for features [B, F] and goals [B, G, 3]."""
        raise NotImplementedError

    def dense_trunk(self) -> DenseEvaluation | None:
        """Returns an evaluator for ``map_part`` on all patches of a map at once; None without such a trunk."""
        return None

    def is_dense(self) -> bool:
        """Returns whether dense evaluation equals patch-by-patch evaluation.

        Both are equal for a trunk without padding and an encoding that treats a cell alike in all patches.
        """
        trunk = self.dense_trunk()
        return trunk is not None and trunk.exact and self.encoding.is_local()

    def forward(self, heights: Tensor, goals: Tensor) -> tuple[Tensor, ...]:
        """Evaluates tasks.

        Args:
            heights: float32 [B, 1, 72, 72], metres, NaN = unknown.
            goals: float32 [B, G, 3], (dx, dy, dtheta) in abstract steps in each patch's robot frame; any G.

        Returns:
            (cost, feasibility logits), float [B, G] each, and with ``predicts_planning_cost`` a third tensor, costs for
            planning. Costs are meaningful for feasible tasks only.

        Convention: axis 2 of ``heights`` is x, along the robot's heading, axis 3 is y, to its left; the base stands at
        the centre of cell (36, 36).
        """
        features = self.map_part(encode(self.encoding, heights)).float()
        # The trunk may run in bfloat16. Goal layers are cheap and stay in float32, because costs need its digits.
        with torch.autocast(heights.device.type, enabled=False):
            return self.goal_part(features, goals)


class MapGoalLinear(nn.Linear):
    """Linear layer over [map features, goal features]; its map part runs once per map.

    Parameters and result equal ``nn.Linear(map_features + goal_features, out)`` on the concatenated input. The
    published network appends the goal to the flattened map in the same way.
    """

    def __init__(self, map_features: int, goal_features: int, out_features: int):
        super().__init__(map_features + goal_features, out_features)
        self.map_features = map_features

    # A module of this name and kind, with its weights and its initialisation, but with two inputs instead of one.
    def forward(self, map_features: Tensor, goal_features: Tensor) -> Tensor:  # type: ignore[override]
        """Maps features [B, M] and goals [B, G, K] to [B, G, out]."""
        map_weight, goal_weight = self.weight.split([self.map_features, self.in_features - self.map_features], dim=1)
        of_map = functional.linear(map_features, map_weight, self.bias)
        return of_map[:, None, :] + functional.linear(goal_features, goal_weight)


def initialise_he(network: "TaskNetwork") -> None:
    """Applies He initialisation to all convolutions and linear layers, zeroes biases, scales heads by 0.1.

    With PyTorch's default, the published network's last convolution is nearly constant over its inputs (0.9 % variation
    against 20 %), and training needs long to leave this plateau.
    """
    for module in network.modules():
        if isinstance(module, (nn.Conv2d, nn.Linear)):
            nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
            if module.bias is not None:
                nn.init.zeros_(module.bias)
    # Labels have magnitude one half: small heads save the epochs that would shrink larger random outputs.
    with torch.no_grad():
        network.heads.weight.mul_(0.1)


def count_parameters(network: nn.Module) -> int:
    """Returns the number of trainable values."""
    return sum(parameter.numel() for parameter in network.parameters() if parameter.requires_grad)
