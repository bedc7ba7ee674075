"""From a plan to the motion of base and feet.

- `motion`: `Motion`, all configurations of a plan, their times and their check
- `refinement`: `refine`, a motion for a plan; steps that cannot be carried out
- `stance`: the base over given feet
- `timing`, `rounded_path`: times within the robot's speeds and accelerations, on a smooth path
- `motion_state`: `MotionState`, the robot at moments of a motion
"""

from hdsp.detailed.motion.motion import PHASES, Motion
from hdsp.detailed.motion.motion_state import MotionState
from hdsp.detailed.motion.refinement import ban, last_step, refine

__all__ = ["PHASES", "Motion", "MotionState", "ban", "last_step", "refine"]
