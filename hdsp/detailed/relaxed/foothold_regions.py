"""Relaxed problem with two dimensions for each foot: the edges over which it must step.

A foothold region is a connected set of cells over which a foot can roll. A foot enters another region only by steps.
Without the rest of the robot, a foot needs at least the cheapest sequence of steps from its region to the goal's
region. The sum over the feet never exceeds the cost of all steps in a plan, and counts no other action. It can
therefore be added to the relaxed base costs (``relaxed_costs``) and to the foot term in ``estimate``. If no sequence
exists, no plan exists.
"""

import math
from typing import NamedTuple

import numpy as np

from hdsp.base.gradual import Steps, finished
from hdsp.base.jit import njit
from hdsp.detailed.actions.state_costs import foot_row
from hdsp.detailed.actions.successors import Rules, allowed_headings
from hdsp.detailed.world.world import World, cell_index, step_effort, step_fits
from hdsp.robot.lattice import HEADINGS

_CELL_BYTES = 48  # for each cell of the map
_CELLS = 16_384  # cells whose steps are collected between two looks at the clock


class FootholdRegions(NamedTuple):
    """Foothold regions and the steps between them.

    Attributes:
        region: int32, flat like the maps in ``World``; region number, -1 where no foot can stand.
        effort: float32 [regions, regions]; least cost of a step from one region (row) to another (column), minus the
            cost that the foot term in ``estimate`` already counts for its length; inf without a step.
    """

    region: np.ndarray
    effort: np.ndarray


def find_foothold_regions(world: World, rules: Rules, counted_per_cell: float) -> FootholdRegions:
    """Finds the foothold regions and steps on a terrain, under the headings allowed by ``rules``.

    Args:
        world: terrain and robot.
        rules: restrictions of the search.
        counted_per_cell: cost per cell of step length that is counted elsewhere.
    """
    return finished(foothold_region_steps(world, rules, counted_per_cell))


def foothold_region_steps(world: World, rules: Rules, counted_per_cell: float) -> Steps[FootholdRegions]:
    """Like `find_foothold_regions`, in short steps."""
    from scipy.ndimage import binary_dilation, label

    standable = world.standable.reshape(-1, world.stride)
    # Cells are connected if one action can take a foot from one to the other; turning reaches farthest.
    c = world.constants
    reach = math.floor(math.hypot(c.neutral_x, c.neutral_y) * 2 * math.pi / HEADINGS) + 1
    rounds = max(1, math.ceil((reach - 1) / 2))
    # No foot stands in the border, and the dilation reaches only its inner edge.
    inner = tuple(slice(world.pad - rounds, world.pad + n + rounds) for n in (world.nx, world.ny))
    wider = binary_dilation(standable[inner], np.ones((3, 3), bool), iterations=rounds)
    regions, count = label(wider, np.ones((3, 3), int))
    numbers = np.full(standable.shape, -1, dtype=np.int32)
    numbers[inner] = np.where(standable[inner], regions - 1, -1)
    region = numbers.ravel()
    effort = np.full((count, count), np.inf, dtype=np.float32)
    np.fill_diagonal(effort, 0)
    yield
    if count > 1:
        allowed = allowed_headings(rules)
        toward = np.flatnonzero(allowed | np.roll(allowed, HEADINGS // 2))
        for first in range(0, len(region), _CELLS):
            _collect_steps(world, region, first, min(first + _CELLS, len(region)), toward, counted_per_cell, effort)
            yield
    return FootholdRegions(region, effort)


def regions_memory(world: World, regions: FootholdRegions | None) -> int:
    """Bytes for foothold regions and their computation; the efforts between regions count once these are known."""
    efforts = 0 if regions is None else 2 * regions.effort.nbytes
    return _CELL_BYTES * len(world.standable) + efforts


def efforts_to(regions: FootholdRegions, world: World, goals: np.ndarray) -> np.ndarray:
    """Returns the least step effort from each region to the nearest of several goals.

    Args:
        regions: regions and steps.
        world: terrain and robot.
        goals: int64 [n, 7], valid states in lattice units.

    Returns:
        float32 [4, regions], per foot; inf if the foot cannot reach any goal.
    """
    n, t = len(regions.effort), world.tables
    result = np.full((4, n), np.inf, dtype=np.float32)
    for foot in range(4):
        rows = foot_row(t, goals[:, 2], foot, goals[:, 3 + foot] - t.lowest)
        cells = cell_index(world, goals[:, 0], goals[:, 1]) + t.feet[rows]
        result[foot, regions.region[cells]] = 0
        # Bellman-Ford: a terrain has few regions, and a foot seldom crosses more than a few.
        for _ in range(n):
            through = (regions.effort + result[foot][None, :]).min(axis=1)
            if not (through < result[foot]).any():
                break
            result[foot] = np.minimum(result[foot], through)
    return result


@njit(nogil=True)
def _collect_steps(world, region, first, end, headings, counted_per_cell, effort):
    t, c = world.tables, world.constants
    standable, height, swing, edge = world.standable, world.height, world.swing, world.edge
    steps, line = world.steps, t.line
    stride = world.stride
    # A step lands on the foot's own cell, and rounding may place this cell beside the line.
    around = (-stride - 1, -stride, -stride + 1, -1, 0, 1, stride - 1, stride, stride + 1)
    for p in range(first, end):
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
