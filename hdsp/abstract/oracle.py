"""The oracle: what the 22 abstract actions from one state cost the detailed planner itself.

Source: paper, Sec. V-C. Start and goals go through T_a->d; each feasible task gets the cost of its optimal plan. In the
published labels a translation never turns far from its heading, and turning there costs more (docs/cost-model.md); that
rule belongs to labels, not to planning.
"""

from dataclasses import dataclass

import numpy as np

from hdsp.abstract.transform import feet_at
from hdsp.detailed.actions import Rules
from hdsp.detailed.estimate import pose_estimate
from hdsp.detailed.relaxed import pose_costs, pose_distances
from hdsp.detailed.solve import Limits, Status, solve
from hdsp.detailed.world import World
from hdsp.errors import InputError
from hdsp.lattice import ABSTRACT_ACTIONS, CELLS_PER_ABSTRACT, HEADINGS, HEADINGS_PER_ABSTRACT


@dataclass(frozen=True)
class LabelSettings:
    """How tasks are labelled.

    Attributes:
        heading_window: in a translation task, the most heading steps (5.625 degrees) away from its heading.
        turn_cost_factor: in a translation task, what turning costs relative to its normal cost.
        cost_limit: tasks that cost more count as infeasible; the published labels end at 1.48.
        max_expansions: a search that takes more ends undecided; its tasks count as infeasible and say so.
    """

    heading_window: int = 3
    turn_cost_factor: float = 1.58235
    cost_limit: float = 1.6
    max_expansions: int = 100_000

    def __post_init__(self):
        if not (self.heading_window >= 0 and self.turn_cost_factor > 0 and self.cost_limit > 0 and self.max_expansions > 0):
            raise InputError(f"{self}: the window must not be negative, all else must be positive")


def task_costs(
    world: World, start: np.ndarray, settings: LabelSettings
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Costs of the 22 abstract actions from a valid detailed state.

    Args:
        world: terrain and robot.
        start: int64 [7], lattice units; its heading is an abstract one.
        settings: the rules of labelling.

    Returns:
        Goal states int64 [22, 7] (neutral feet where none are valid), costs float64 [22] (inf where not solved) and
        the ``Status`` of each task, int64 [22]. Actions are in the frame of the lattice.
    """
    steps = ABSTRACT_ACTIONS * np.array([CELLS_PER_ABSTRACT, CELLS_PER_ABSTRACT, HEADINGS_PER_ABSTRACT])
    goals = np.zeros((len(steps), 7), dtype=np.int64)
    goals[:, :3] = start[:3] + steps
    goals[:, 2] %= HEADINGS
    cost = np.full(len(goals), np.inf)
    reason = np.full(len(goals), Status.INVALID_GOAL, dtype=np.int64)
    valid = np.zeros(len(goals), dtype=bool)
    for i, goal in enumerate(goals):
        state = feet_at(world, goal[:3])
        if state is not None:
            goals[i], valid[i] = state, True
    turning = ABSTRACT_ACTIONS[:, 2] != 0
    heading = int(start[2])
    translate = Rules(heading, settings.heading_window, settings.turn_cost_factor)
    turn = Rules(heading, HEADINGS_PER_ABSTRACT, 1.0)
    for rules, kind in ((translate, ~turning), (turn, turning)):
        chosen = np.flatnonzero(kind & valid)
        if len(chosen):
            cost[chosen], reason[chosen] = _search(world, start, goals[chosen], rules, settings)
    return goals, cost, reason


def _search(world: World, start: np.ndarray, goals: np.ndarray, rules: Rules, settings: LabelSettings):
    """Costs and statuses of goals under the same rules, in one search for all that share a foot configuration."""
    cost, status = np.full(len(goals), np.inf), np.full(len(goals), Status.INFEASIBLE)
    costs = pose_costs(world, rules)
    # What even the relaxed problem cannot reach, or only beyond the limit, needs no search.
    reach = pose_distances(world, rules, costs, start[None, :3], False, settings.cost_limit)
    least = reach[goals[:, 2], goals[:, 0], goals[:, 1]]
    status[np.isinf(least)] = Status.COST_LIMIT
    limits = Limits(cost=settings.cost_limit, expansions=settings.max_expansions)
    for feet in np.unique(goals[:, 3:], axis=0):
        chosen = np.flatnonzero(np.isfinite(least) & (goals[:, 3:] == feet).all(axis=1))
        if len(chosen) == 0:
            continue
        to_go = pose_distances(world, rules, costs, goals[chosen, :3], True, settings.cost_limit)
        result = solve(world, start, goals[chosen], pose_estimate(world, to_go, feet), rules=rules, limits=limits, paths=False)
        cost[chosen], status[chosen] = result.cost, result.status
    return cost, status
