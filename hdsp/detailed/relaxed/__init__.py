"""Relaxed problems: the robot may do more, so their costs are lower bounds, and their proofs hold.

- `foothold_regions`: the steps of one foot over edges
- `relaxed_costs`: costs between base poses; `poses` their edges, `pose_search` Dijkstra, `bucket_queue` its queue
- `proofs`: proofs that a goal is out of reach; `heading_masks` floods poses with the headings as bits
"""

from hdsp.detailed.relaxed.foothold_regions import FootholdRegions, efforts_to, find_foothold_regions
from hdsp.detailed.relaxed.poses import Poses, new_poses
from hdsp.detailed.relaxed.proofs import Unreachable, why_unreachable
from hdsp.detailed.relaxed.relaxed_costs import Relaxed, costs_to_go, explore, least_costs

__all__ = [
    "FootholdRegions",
    "Poses",
    "Relaxed",
    "Unreachable",
    "costs_to_go",
    "efforts_to",
    "explore",
    "find_foothold_regions",
    "least_costs",
    "new_poses",
    "why_unreachable",
]
