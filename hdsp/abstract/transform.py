"""T_a->d: from an abstract state to the detailed state that represents it.

Source: paper, Sec. V-B: "For all detailed robot base states that match the abstract state, we search the least cost
foot configuration while preferring configurations which are close to the neutral robot configuration." The reverse,
T_d->a, is ``hdsp.robot.lattice.detailed_to_abstract``.
"""

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.actions.state_costs import foot_row
from hdsp.detailed.world.body import body_is_free
from hdsp.detailed.world.world import World, cell_index


def feet_at(world: World, base) -> np.ndarray | None:
    """Returns the detailed state, int64 [7], with the best feet at a base state (ix, iy, heading), or None."""
    cost, offsets = best_feet(world, *base)
    return np.array([*base, *offsets], dtype=np.int64) if np.isfinite(cost) else None


def feet_at_all(world: World, bases: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Applies ``feet_at`` to base states int64 [n, 3]; returns states int64 [n, 7] and their validity, bool [n].

    Invalid states have neutral feet.
    """
    states, valid = np.zeros((len(bases), 7), dtype=np.int64), np.zeros(len(bases), dtype=np.bool_)
    states[:, :3] = bases
    _fill_feet(world, states, valid)
    return states, valid


@njit(nogil=True)
def best_feet(world, ix, iy, heading):
    """Least value of ``max S + sum S + neutral_penalty * sum |offset|``, and its four foot offsets (steps).

    Feet on one side keep a minimum separation, so they are chosen as pairs. The largest S is bounded by each of its
    possible values in turn, which makes both sides independent. The value is inf if no feet have
    footholds, or if the base is blocked over the best feet.
    """
    t = world.tables
    n = t.n_offsets
    penalty = world.constants.neutral_penalty
    p = cell_index(world, ix, iy)
    best = np.zeros(4, dtype=np.int64)
    least = np.inf
    s = np.empty((4, n))
    for foot in range(4):
        for o in range(n):
            s[foot, o] = world.uneven[p + t.contacts[foot_row(t, heading, foot, o)]]
    apart = 2 * world.constants.neutral_x - world.constants.min_separation
    choice = np.zeros(4, dtype=np.int64)
    for bound in np.unique(s.ravel()):
        if bound == np.inf:
            break
        if bound >= least:
            break
        total = bound
        for side in range(2):
            front, rear = (0, 1) if side == 0 else (3, 2)
            pair = np.inf
            for f in range(n):
                if s[front, f] > bound:
                    continue
                cost_front = s[front, f] + penalty * abs(f + t.lowest)
                if cost_front >= pair:
                    continue
                for r in range(n):
                    if s[rear, r] > bound or r - f > apart:
                        continue
                    cost = cost_front + s[rear, r] + penalty * abs(r + t.lowest)
                    if cost < pair:
                        pair = cost
                        choice[front], choice[rear] = f + t.lowest, r + t.lowest
            total += pair
        if total < least:
            least = total
            best[:] = choice
    o0, o1, o2, o3 = best[0] - t.lowest, best[1] - t.lowest, best[2] - t.lowest, best[3] - t.lowest
    if least < np.inf and not body_is_free(world, heading, p, o0, o1, o2, o3):
        return np.inf, best
    return least, best


@njit(nogil=True)
def _fill_feet(world, states, valid):
    for i in range(len(states)):
        cost, offsets = best_feet(world, states[i, 0], states[i, 1], states[i, 2])
        if cost < np.inf:
            states[i, 3:], valid[i] = offsets, True
