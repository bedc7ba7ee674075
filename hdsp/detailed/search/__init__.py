"""Searches over detailed states.

Drivers, one per file, with one life cycle (`life_cycle`):

- `weighted_astar`: `solve`, weighted A* for planning and labels
- `anytime`: `improve`, rounds with falling weights (ARA*)
- `multi_heuristic`: `solve_multi`, guides with an anchor (SMHA*)
- `windows`: `Windows`, short searches between near states
- `leaving`: `leave`, a search outward for any way from a state

Results and bounds: `outcome`, `bounds`. Heuristics for the kernels: `estimate`.

Kernels: `kernel` and `multi_kernel` choose the next state, `expansion` expands it and relaxes its successors, `store`
keeps states, `open_list` keeps states in wait for expansion.
"""

from hdsp.detailed.search.anytime import Improvement, improve
from hdsp.detailed.search.estimate import Estimate, geometric_estimate, pose_estimate, with_step_efforts
from hdsp.detailed.search.multi_heuristic import solve_multi
from hdsp.detailed.search.outcome import Limits, Path, SearchResult, Status
from hdsp.detailed.search.weighted_astar import solve

__all__ = [
    "Estimate",
    "Improvement",
    "Limits",
    "Path",
    "SearchResult",
    "Status",
    "geometric_estimate",
    "improve",
    "pose_estimate",
    "solve",
    "solve_multi",
    "with_step_efforts",
]
