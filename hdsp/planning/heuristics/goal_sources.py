"""Abstract states around goals, and the cost from each to its goal: sources for the search of costs-to-go."""

from typing import NamedTuple

import numpy as np

from hdsp.base.gradual import Steps, finished
from hdsp.detailed.world.world import World
from hdsp.robot.lattice import (
    ABSTRACT_HEADINGS,
    DRIVE_MOVES,
    HEADINGS,
    abstract_anchor,
    detailed_to_abstract,
    metres,
    surrounding_abstract,
)

_AT_ONCE = 4096  # goals between two looks at the clock


class Sources(NamedTuple):
    """Sources of a search for costs-to-go.

    Attributes:
        states: int64 [n, 3], distinct abstract states (ix, iy, heading).
        costs: float64 [n], cost from each to a goal, plus ``excess``.
        excess: costs-to-go between the sources exceed the cost to the goal by this much.
    """

    states: np.ndarray
    costs: np.ndarray
    excess: float

    def equal(self, other: "Sources") -> bool:
        """Whether both have the same states and costs."""
        same = np.array_equal(self.states, other.states) and np.array_equal(self.costs, other.costs)
        return same and self.excess == other.excess


def goal_sources(world: World, standing: np.ndarray, goals: np.ndarray) -> Sources:
    """Does the work of ``goal_source_steps`` at once."""
    return finished(goal_source_steps(world, standing, goals))


def goal_source_steps(world: World, standing: np.ndarray, goals: np.ndarray) -> Steps[Sources]:
    """Finds the abstract states from which a search for costs-to-go begins, in steps.

    They surround the goals, as the goals seldom lie on an anchor. The cost from an anchor to the goal is the cost of
    the straight way, and of the turn, on even ground. Their interpolation at the goal is above 0. Costs-to-go exceed
    the costs to the goal by up to this value where ways lead past many anchors, and by nothing where they end at the
    best anchor. Half of it counts as the excess, which a reader of costs-to-go subtracts.

    A goal around which the robot can stand at no anchor has its own abstract state as its source.

    Args:
        world: terrain and robot.
        standing: bool [16, nx, ny], abstract states at which the robot can stand.
        goals: int64 [n, 7], lattice units.
    """
    # Goals on one pose differ in their feet alone, in a hundred thousand ways where feet may stay as they like.
    _, first = np.unique((goals[:, 0] * world.ny + goals[:, 1]) * HEADINGS + goals[:, 2], return_index=True)
    goals = goals[first]
    parts: list[_Around] = []
    for some in np.array_split(goals, range(_AT_ONCE, len(goals), _AT_ONCE)):
        if parts:
            yield
        parts.append(_around(world, standing, some))
    excess = np.concatenate([part.excess for part in parts])
    most = float(excess.max())
    least = np.full(standing.size, np.inf)
    owners = np.split(most - excess, np.cumsum([len(part.excess) for part in parts])[:-1])
    for part, more in zip(parts, owners, strict=True):
        np.minimum.at(least, part.states, part.costs + more[part.goals])
    (found,) = np.nonzero(least < np.inf)
    ix, iy, heading = np.unravel_index(found, (*standing.shape[1:], ABSTRACT_HEADINGS))
    return Sources(np.stack([ix, iy, heading], axis=1).astype(np.int64), least[found], most)


class _Around(NamedTuple):
    """Abstract states around some goals: flat indices (ix, iy, heading), their goals, costs; excess of each goal."""

    states: np.ndarray
    goals: np.ndarray
    costs: np.ndarray
    excess: np.ndarray


def _around(world: World, standing: np.ndarray, goals: np.ndarray) -> _Around:
    last = np.array([*standing.shape[1:], ABSTRACT_HEADINGS]) - 1
    around, shares = surrounding_abstract(goals)
    inside = ((around >= 0) & (around <= last)).all(axis=2)
    states = np.clip(around, 0, last)
    shares = shares * (inside & standing[states[..., 2], states[..., 0], states[..., 1]])
    alone = shares.sum(axis=1) == 0
    states[alone, 0], shares[alone, 0] = np.minimum(detailed_to_abstract(goals[alone]), last), 1.0
    behind = np.broadcast_to(goals[:, None, :3], around.shape)
    costs = _straight_costs(world, states.reshape(-1, 3), behind.reshape(-1, 3)).reshape(shares.shape)
    costs[alone] = 0.0
    excess = 0.5 * (shares * costs).sum(axis=1) / shares.sum(axis=1)
    goal, which = np.nonzero(shares > 0)
    ix, iy, heading = states[goal, which].T
    return _Around((ix * standing.shape[2] + iy) * ABSTRACT_HEADINGS + heading, goal, costs[goal, which], excess)


def _straight_costs(world: World, states: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """Costs, float64 [n], from the anchors of abstract states [n, 3] to base poses [n, 3] on even ground."""
    t = world.tables
    anchors = abstract_anchor(states)
    away = goals - anchors
    turned = abs((away[:, 2] + HEADINGS // 2) % HEADINGS - HEADINGS // 2)
    directions = np.arctan2(DRIVE_MOVES[:, 1], DRIVE_MOVES[:, 0])
    off = np.arctan2(away[:, 1], away[:, 0])[:, None] - directions
    nearest = abs(np.mod(off + np.pi, 2 * np.pi) - np.pi).argmin(axis=1)
    factor = t.deviation[anchors[:, 2], nearest]
    factor = np.where(np.isfinite(factor), factor, t.deviation[np.isfinite(t.deviation)].max())
    return metres(np.hypot(away[:, 0], away[:, 1])) * factor + world.constants.turn * turned
