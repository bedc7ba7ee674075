"""Network with one output per action: it takes no goal, and one evaluation per patch serves all actions."""

import numpy as np
import torch
from torch import Tensor, nn

from hdsp.base.errors import InputError
from hdsp.base.settings import checked
from hdsp.learning.learning_settings import HeightEncoding, Width
from hdsp.learning.networks.base import TaskNetwork
from hdsp.learning.networks.dense import DenseTrunk
from hdsp.robot.lattice import ABSTRACT_HEADINGS, robot_frame_goals

#: Largest difference, in abstract steps, between a goal and its action.
TOLERANCE = 1e-3
#: Headings with distinct robot-frame actions; a quarter turn maps the action set onto itself.
RESIDUES = ABSTRACT_HEADINGS // 4


@checked
class TableOptions:
    """Layer widths.

    Attributes:
        widths: channels per convolution.
        hidden: width of the two layers after the convolutions.
    """

    widths: tuple[Width, Width, Width, Width] = (12, 24, 40, 48)
    hidden: Width = 192


class Table(TaskNetwork):
    """Convolutions and poolings without padding, then a table with costs and logits for all actions.

    The table has 82 entries: the 20 translations in the robot frame at each of four heading residues, and two turns.
    Any other goal is an ``InputError``. Each entry learns only from labels at its own residue. After training on maps
    that all start at residue 0, like the paper's, entries for other residues are meaningless.
    """

    actions: Tensor

    Options = TableOptions

    def __init__(self, encoding: HeightEncoding, options: TableOptions):
        super().__init__(encoding)
        first, second, third, fourth = options.widths
        self.trunk = nn.Sequential(
            nn.Conv2d(len(encoding.channels), first, 5), nn.ReLU(), nn.MaxPool2d(2),
            nn.Conv2d(first, second, 5), nn.ReLU(), nn.MaxPool2d(2),
            nn.Conv2d(second, third, 4), nn.ReLU(), nn.MaxPool2d(2),
            nn.Conv2d(third, fourth, 3), nn.ReLU(), nn.Flatten(),
        )  # fmt: skip
        self.rest = nn.Sequential(
            nn.Linear(fourth * 4 * 4, options.hidden), nn.ReLU(),
            nn.Linear(options.hidden, options.hidden), nn.ReLU(),
        )  # fmt: skip
        actions = torch.from_numpy(distinct_goals())
        self.heads = nn.Linear(options.hidden, 2 * len(actions))
        self.register_buffer("actions", actions, persistent=False)

    def dense_trunk(self) -> DenseTrunk:
        return DenseTrunk(self.trunk)

    def map_part(self, encoded: Tensor) -> Tensor:
        return self.trunk(encoded)

    def goal_part(self, features: Tensor, goals: Tensor) -> tuple[Tensor, Tensor]:
        entries = self.entries(goals).expand(features.shape[0], -1)
        cost, logits = self.heads(self.rest(features)).chunk(2, dim=-1)
        return cost.gather(1, entries), logits.gather(1, entries)

    def entries(self, goals: Tensor) -> Tensor:
        """Returns table entries, int64 [B, G], for goals [B, G, 3].

        Raises:
            InputError: a goal is no action at any heading; the message names the first one.
        """
        difference, entries = (goals[..., None, :] - self.actions).abs().amax(-1).min(-1)
        foreign = goals[difference > TOLERANCE]
        if len(foreign):
            goal = ", ".join(f"{value:g}" for value in foreign[0].tolist())
            raise InputError(
                f"goal ({goal}): the architecture table knows the {len(robot_frame_goals(0))} abstract actions, as the "
                f"robot sees them at its {ABSTRACT_HEADINGS} headings, and no other goal"
            )
        return entries


def distinct_goals() -> np.ndarray:
    """Returns all goals, float32 [82, 3], that abstract actions have in the robot frame at any heading."""
    seen = [robot_frame_goals(residue) for residue in range(RESIDUES)]
    translations = [goals[goals[:, 2] == 0] for goals in seen]
    return np.concatenate([*translations, seen[0][seen[0][:, 2] != 0]])
