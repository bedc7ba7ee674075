"""From a plan to the motion of base and feet.

- `motion`: `Motion`, all configurations of a plan, and their check
- `refinement`: `refine`, a motion for a plan; steps that cannot be carried out
- `stance`: the base over given feet
"""

from hdsp.detailed.motion.motion import PHASES, Motion
from hdsp.detailed.motion.refinement import ban, last_step, refine

__all__ = ["PHASES", "Motion", "ban", "last_step", "refine"]
