"""The pose in reach that is nearest to a goal."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Nearest:
    """Pose in reach that is nearest to a goal. Convention: world coordinates, m and rad.

    Attributes:
        pose: state (x, y, theta, four foot offsets); the search reached it.
        distance: distance from the goal, m.
        turn: difference in heading from the goal, rad, >= 0.
    """

    pose: tuple[float, ...]
    distance: float
    turn: float

    def __str__(self) -> str:
        x, y, theta = self.pose[:3]
        away = f"{self.distance:.2f} m"
        if self.turn > 1e-6:
            away += f" and {math.degrees(self.turn):.0f} degrees"
        heading = f"heading {math.degrees(theta):.0f} degrees"
        return f"the nearest pose reached is ({x:.2f}, {y:.2f}) m, {heading}, {away} from the goal"
