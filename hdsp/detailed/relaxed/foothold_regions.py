"""A relaxed problem of two dimensions for each foot: over which edges must it at least step?

The cells on which a foot can stand fall into regions within which it can roll. From one region into another it comes
only by steps. Left alone by the rest of the robot, a foot needs at least the cheapest sequence of steps from its region
to that of its goal. The sum over the feet never exceeds what the steps of a plan cost, and counts no other action: it
adds to the relaxed costs of the base (``relaxed``) and to the foot term of ``estimate``. Where no sequence exists,
there is no plan.
"""

import math
from typing import NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.actions.state_costs import foot_row
from hdsp.detailed.actions.successors import Rules, allowed_headings
from hdsp.detailed.world.world import World, cell_index, step_effort, step_fits
from hdsp.robot.lattice import HEADINGS


class FootholdRegions(NamedTuple):
    """Regions of footholds and the steps between them.

    Attributes:
        region: int32 flat like the maps of ``World``; number of the region, -1 where no foot can stand.
        effort: float32 [regions, regions]; least cost of a step from one to the other beyond what the foot term of
            ``estimate`` already counts for its length; inf where no step leads.
    """

    region: np.ndarray
    effort: np.ndarray


def find_foothold_regions(world: World, rules: Rules, counted_per_cell: float) -> FootholdRegions:
    """Regions and steps of a terrain under the headings that ``rules`` allow.

    Args:
        world: terrain and robot.
        rules: of the search.
        counted_per_cell: cost per cell of a step's length that is counted elsewhere.
    """
    from scipy.ndimage import binary_dilation, label

    standable = world.standable.reshape(-1, world.stride)
    # Cells are connected if one action may take a foot from one to the other; turning reaches farthest.
    c = world.constants
    reach = math.floor(math.hypot(c.neutral_x, c.neutral_y) * 2 * math.pi / HEADINGS) + 1
    rounds = max(1, math.ceil((reach - 1) / 2))
    # No foot stands in the border, and only the edge of it is reached here.
    inner = tuple(slice(world.pad - rounds, world.pad + n + rounds) for n in (world.nx, world.ny))
    wider = binary_dilation(standable[inner], np.ones((3, 3), bool), iterations=rounds)
    regions, count = label(wider, np.ones((3, 3), int))
    region = np.full(standable.shape, -1, dtype=np.int32)
    region[inner] = np.where(standable[inner], regions - 1, -1)
    region = region.ravel()
    effort = np.full((count, count), np.inf, dtype=np.float32)
    np.fill_diagonal(effort, 0)
    if count > 1:
        allowed = allowed_headings(rules)
        toward = allowed | np.roll(allowed, HEADINGS // 2)
        _collect_steps(world, region, np.flatnonzero(toward), counted_per_cell, effort)
    return FootholdRegions(region, effort)


def efforts_to(regions: FootholdRegions, world: World, goals: np.ndarray) -> np.ndarray:
    """Least effort of steps from each region to the nearest of several goals.

    Args:
        regions: the regions and the steps between them.
        world: terrain and robot.
        goals: int64 [n, 7], valid states in lattice units.

    Returns:
        float32 [4, regions]: per foot; inf where a foot cannot get to any goal.
    """
    n, t = len(regions.effort), world.tables
    result = np.full((4, n), np.inf, dtype=np.float32)
    for foot in range(4):
        rows = foot_row(t, goals[:, 2], foot, goals[:, 3 + foot] - t.lowest)
        cells = cell_index(world, goals[:, 0], goals[:, 1]) + t.feet[rows]
        result[foot, regions.region[cells]] = 0
        # Bellman-Ford: there are few regions, and a foot seldom crosses more than a few of them.
        for _ in range(n):
            through = (regions.effort + result[foot][None, :]).min(axis=1)
            if not (through < result[foot]).any():
                break
            result[foot] = np.minimum(result[foot], through)
    return result


@njit()
def _collect_steps(world, region, headings, counted_per_cell, effort):
    t, c = world.tables, world.constants
    standable, height, swing, edge = world.standable, world.height, world.swing, world.edge
    steps, line = world.steps, t.line
    stride = world.stride
    # The kernel lands on the foot's own cell, which rounding may put beside the line.
    around = (-stride - 1, -stride, -stride + 1, -1, 0, 1, stride - 1, stride, stride + 1)
    for p in range(len(standable)):
        if steps[p] == 0:
            continue
        before = height[p]
        for h in headings:
            if (steps[p] >> np.uint64(h)) & np.uint64(1) == 0:
                continue
            crossed = False
            highest = before
            for length in range(1, line.shape[1]):
                at = p + line[h, length]
                highest = max(highest, swing[at])
                crossed = crossed or edge[at]
                if not crossed:
                    continue
                for beside in around:
                    q = at + beside
                    if not standable[q]:
                        continue
                    after = height[q]
                    if step_fits(before, after, max(highest, after), c.step_max_height, c.step_max_clearance):
                        cost = step_effort(c.step, c.step_per_metre, c.step_per_height, length, before, after)
                        extra = np.float32(max(0.0, cost - counted_per_cell * length))
                        if extra < effort[region[p], region[q]]:
                            effort[region[p], region[q]] = extra
