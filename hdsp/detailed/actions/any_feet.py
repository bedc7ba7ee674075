"""Options of the feet at a base pose, for relaxed problems over base poses."""

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.actions.state_costs import feet_cells, foot_row, state_cost
from hdsp.detailed.states import pack
from hdsp.detailed.world.body import may_be_free
from hdsp.detailed.world.world import cell_index
from hdsp.robot.lattice import HEADINGS


@njit(allocates=False)
def stands_on_neutral(world, x, y, heading):
    """Whether the robot can stand on neutral feet."""
    zero = -world.tables.lowest
    return state_cost(world, pack(x, y, heading, zero, zero, zero, zero)) < np.inf


@njit(allocates=False)
def can_step_from_neutral(world, x, y, heading):
    """Whether some foot can step while all are neutral."""
    t = world.tables
    steps, feet, n_offsets, n_samples, zero = world.steps, t.feet, t.n_offsets, t.n_samples, -t.lowest
    p = cell_index(world, x, y)
    p0, p1, p2, p3 = feet_cells(p, feet, n_offsets, n_samples, heading, zero, zero, zero, zero)
    ways = steps[p0] | steps[p1] | steps[p2] | steps[p3]
    if world.constants.step_backward:
        ways |= (ways << np.uint64(HEADINGS // 2)) | (ways >> np.uint64(HEADINGS // 2))
    return (ways >> np.uint64(heading)) & np.uint64(1) != 0


@njit(allocates=False)
def least_pose_cost(world, x, y, heading):
    """Least state cost at a pose over all feet; inf without a valid state."""
    t = world.tables
    uneven, contacts, n_offsets, n_samples = world.uneven, t.contacts, t.n_offsets, t.n_samples
    p = cell_index(world, x, y)
    if not may_be_free(world, heading, p):
        return np.inf
    total = largest = np.float32(0)
    for i in range(4):
        row = foot_row(t, heading, i, 0)
        # The neutral offset first: on even ground nothing is better.
        best = uneven[p + contacts[row - t.lowest * n_samples]]
        if best > 0:
            for offset in range(n_offsets):
                best = min(best, uneven[p + contacts[row + offset * n_samples]])
        total += best
        largest = max(largest, best)
    return 1.0 + world.constants.unevenness * (np.float64(largest) + total)
