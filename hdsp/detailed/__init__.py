"""The detailed planner: seven-dimensional states, six kinds of action, weighted A* (paper, Sec. V-A).

- `states`: a state as one integer
- `base_pose`: height, pitch and roll of the base over given feet
- `world`: terrain and robot, compiled for the kernels
- `actions`: actions, their costs, the successors of a state
- `search`: weighted A*, anytime and multi-heuristic search
- `relaxed`: easier problems for lower bounds and proofs
- `motion`: from a plan to the motion of base and feet
- `causes`: why a state is invalid, and which ground keeps the robot from a goal

Each package imports only packages above it in this list; `relaxed` and `motion` do not import each other.
"""

from hdsp.detailed.actions import Action, ActionKind, Rules
from hdsp.detailed.motion import Motion, refine
from hdsp.detailed.relaxed import Unreachable, why_unreachable
from hdsp.detailed.search import (
    Estimate,
    Limits,
    Path,
    SearchResult,
    Status,
    geometric_estimate,
    improve,
    solve,
    solve_multi,
)
from hdsp.detailed.world import World, build_world

__all__ = [
    "Action",
    "ActionKind",
    "Estimate",
    "Limits",
    "Motion",
    "Path",
    "Rules",
    "SearchResult",
    "Status",
    "Unreachable",
    "World",
    "build_world",
    "geometric_estimate",
    "improve",
    "refine",
    "solve",
    "solve_multi",
    "why_unreachable",
]
