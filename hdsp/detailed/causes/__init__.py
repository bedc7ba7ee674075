"""Causes of failures: why a state is invalid, and which ground keeps the robot from a goal.

- `cause`: a cause as a value with its place, and in words
- `state_faults`: causes for which a state is invalid
- `gap`: the gap between the poses in reach and a goal, and the causes in it
"""

from hdsp.detailed.causes.cause import Cause, Kind
from hdsp.detailed.causes.gap import Gap, Obstacle, obstacle_steps
from hdsp.detailed.causes.state_faults import faults_of

__all__ = ["Cause", "Gap", "Kind", "Obstacle", "faults_of", "obstacle_steps"]
