"""T_a->d: from an abstract state to the detailed state that represents it.

Source: paper, Sec. V-B: "For all detailed robot base states that match the abstract state, we search the least cost
foot configuration while preferring configurations which are close to the neutral robot configuration." The reverse,
T_d->a, is ``hdsp.robot.lattice.detailed_to_abstract``.
"""

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.actions.state_costs import foot_row
from hdsp.detailed.world.world import World, body_is_free, cell_index
from hdsp.robot.lattice import CELLS_PER_ABSTRACT, HEADINGS, HEADINGS_PER_ABSTRACT, abstract_anchor


def to_detailed(world: World, abstract, whole_cell: bool = False) -> np.ndarray | None:
    """Returns the least-cost detailed state that matches an abstract state.

    Args:
        world: terrain and robot.
        abstract: (a, b, k), abstract cell and heading.
        whole_cell: search all detailed base states in the abstract cell (nearest to the anchor first) instead of the
            anchor alone. The published labels show no shift in position or heading, so labelling uses the anchor.

    Returns:
        int64 [7] in lattice units, or None if no state is valid.
    """
    anchor = abstract_anchor(np.asarray(abstract))
    bases = _matching_bases(anchor) if whole_cell else anchor[None]
    best, best_cost = None, np.inf
    for base in bases:
        if not (0 <= base[0] < world.nx and 0 <= base[1] < world.ny):
            continue
        cost, offsets = best_feet(world, *base)
        if cost < best_cost:
            best, best_cost = np.array([*base, *offsets], dtype=np.int64), cost
    return best


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


def _matching_bases(anchor: np.ndarray) -> np.ndarray:
    cell = anchor[:2] // CELLS_PER_ABSTRACT * CELLS_PER_ABSTRACT
    half = HEADINGS_PER_ABSTRACT // 2
    bases = [
        (cell[0] + i, cell[1] + j, (anchor[2] + k) % HEADINGS)
        for i in range(CELLS_PER_ABSTRACT)
        for j in range(CELLS_PER_ABSTRACT)
        for k in range(-half, half)
    ]
    off = [abs(x - anchor[0]) + abs(y - anchor[1]) + abs((h - anchor[2] + 32) % HEADINGS - 32) for x, y, h in bases]
    return np.array(bases)[np.argsort(off, kind="stable")]


@njit()
def best_feet(world, ix, iy, heading):
    """Least value of ``max S + sum S + neutral_penalty * sum |offset|``, and its four foot offsets (steps).

    Feet on one side keep a minimum separation, so they are chosen as pairs. The largest S is bounded by each of its
    possible values in turn, which makes both sides independent. The value is inf if no feet are valid.
    """
    t = world.tables
    n = t.n_offsets
    penalty = world.constants.neutral_penalty
    p = cell_index(world, ix, iy)
    best = np.zeros(4, dtype=np.int64)
    least = np.inf
    if not body_is_free(world, heading, p):
        return least, best
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
    return least, best


@njit()
def _fill_feet(world, states, valid):
    for i in range(len(states)):
        cost, offsets = best_feet(world, states[i, 0], states[i, 1], states[i, 2])
        if cost < np.inf:
            states[i, 3:], valid[i] = offsets, True
