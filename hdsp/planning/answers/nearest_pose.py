"""The pose in reach that is nearest to a goal, and what the goal asks for."""

import math
from dataclasses import dataclass

import numpy as np

_SAME = 1e-6  # rad; headings on the lattice differ by more


@dataclass(frozen=True, eq=False)
class Aim:
    """What a query asks of its end.

    Attributes:
        state: int64 [7], the nearest lattice state to the goal, without its tolerance.
        heading_free: whether any heading counts.
        feet_given: whether the robot must arrive on the feet of ``state``.
    """

    state: np.ndarray
    heading_free: bool = False
    feet_given: bool = False


@dataclass(frozen=True)
class Nearest:
    """Pose in reach that is nearest to a goal. Convention: world coordinates, m and rad.

    Attributes:
        pose: state (x, y, theta, four foot offsets); the search reached it.
        distance: distance from the goal, m.
        turn: difference in heading from the goal, rad, >= 0; 0 for a goal with a free heading.
    """

    pose: tuple[float, ...]
    distance: float
    turn: float

    @property
    def at_goal(self) -> bool:
        """Whether only the feet differ from the goal's."""
        return self.distance == 0 and self.turn < _SAME

    def __str__(self) -> str:
        x, y, theta = self.pose[:3]
        away = f"{self.distance:.2f} m"
        if self.turn >= _SAME:
            away += f" and {math.degrees(self.turn):.0f} degrees"
        heading = f"heading {math.degrees(theta):.0f} degrees"
        return f"the nearest pose reached is ({x:.2f}, {y:.2f}) m, {heading}, {away} from the goal"
