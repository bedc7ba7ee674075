"""The oracle: what the 22 abstract actions from one state cost the detailed planner itself.

Source: paper, Sec. V-C. Start and goals go through T_a->d; each feasible task gets the cost of its optimal plan. In the
published labels a translation never turns far from its heading, and turning there costs more (docs/cost-model.md); that
rule belongs to labels, not to planning.
"""

from dataclasses import dataclass

import numpy as np

from hdsp.abstract.transform import feet_at_all
from hdsp.base.errors import InputError
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.relaxed.foothold_regions import efforts_to, find_footing
from hdsp.detailed.relaxed.relaxed import Poses, costs_to_go, explore, least_costs, new_poses
from hdsp.detailed.search.estimate import least_foot_cost, pose_estimate, with_footing
from hdsp.detailed.search.solve import Limits, Status, solve
from hdsp.detailed.world.world import World
from hdsp.robot.lattice import ABSTRACT_ACTIONS, CELLS_PER_ABSTRACT, HEADINGS, HEADINGS_PER_ABSTRACT


@dataclass(frozen=True)
class LabelSettings:
    """How tasks are labelled.

    Attributes:
        heading_window: in a translation task, the most heading steps (5.625 degrees) away from its heading.
        turn_cost_factor: in a translation task, what turning costs relative to its normal cost.
        cost_limit: tasks that cost more count as infeasible; the published labels end at 1.48.
        max_expansions: a safety net for memory, far above what searches take. One that takes more ends undecided; its
            tasks count as infeasible and say so.
    """

    heading_window: int = 3
    turn_cost_factor: float = 1.68099
    cost_limit: float = 1.6
    max_expansions: int = 10_000_000

    def __post_init__(self):
        if self.heading_window < 0 or min(self.turn_cost_factor, self.cost_limit, self.max_expansions) <= 0:
            raise InputError(f"{self}: the window must not be negative, all else must be positive")


def task_costs(
    world: World, start: np.ndarray, settings: LabelSettings, actions: np.ndarray = ABSTRACT_ACTIONS
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Costs of abstract actions from a valid detailed state.

    Args:
        world: terrain and robot.
        start: int64 [7], lattice units; its heading is an abstract one.
        settings: the rules of labelling.
        actions: int64 [n, 3], some of the 22, in the frame of the lattice.

    Returns:
        Goal states int64 [n, 7] (neutral feet where none are valid), costs float64 [n] (inf where not solved) and
        the ``Status`` of each task, int64 [n].
    """
    bases = start[:3] + actions * np.array([CELLS_PER_ABSTRACT, CELLS_PER_ABSTRACT, HEADINGS_PER_ABSTRACT])
    bases[:, 2] %= HEADINGS
    goals, valid = feet_at_all(world, bases)
    cost = np.full(len(goals), np.inf)
    reason = np.full(len(goals), Status.INVALID_GOAL, dtype=np.int64)
    turning = actions[:, 2] != 0
    heading = int(start[2])
    translate = Rules(heading, settings.heading_window, settings.turn_cost_factor)
    turn = Rules(heading, HEADINGS_PER_ABSTRACT, 1.0)
    tasks = [(rules, np.flatnonzero(kind & valid)) for rules, kind in ((translate, ~turning), (turn, turning))]
    window = max((rules.heading_window for rules, chosen in tasks if len(chosen)), default=0)
    poses = new_poses(world, heading, window)
    for rules, chosen in tasks:
        if len(chosen):
            cost[chosen], reason[chosen] = _search(world, start, goals[chosen], rules, settings, poses)
    return goals, cost, reason


def _search(world: World, start: np.ndarray, goals: np.ndarray, rules: Rules, settings: LabelSettings, poses: Poses):
    """Costs and statuses of goals under the same rules.

    What the relaxed problem cannot reach is infeasible, and what it reaches beyond the limit is over it. On the way it
    tells what driving alone costs. Only for goals that might be reached for less is there a search of all actions,
    again one for all of them.
    """
    relaxed = explore(world, rules, start, settings.cost_limit, goals, poses)
    least, cost = least_costs(world, relaxed, start, goals), relaxed.driven.copy()
    unreached = Status.COST_LIMIT if relaxed.cut else Status.INFEASIBLE
    status = np.where(np.isfinite(least), Status.COST_LIMIT, unreached).astype(np.int64)
    status[np.isfinite(cost)] = Status.SOLVED
    limit = np.where(np.isfinite(cost), cost * (1 - 1e-6), settings.cost_limit)
    chosen = np.flatnonzero(least < limit)
    if not len(chosen):
        return cost, status
    # Goals that may cost less start later: f then has one limit for all.
    highest = limit[chosen].max()
    to_go, cut = costs_to_go(world, rules, relaxed, start, goals[chosen], highest - limit[chosen], highest)
    footing = find_footing(world, rules, least_foot_cost(world))
    view = pose_estimate(world, to_go, relaxed.follow, goals[chosen, 3:])
    view = with_footing(view, footing, efforts_to(footing, world, goals[chosen]))
    limits = Limits(cost=highest, expansions=settings.max_expansions)
    result = solve(world, start, goals[chosen], view, rules=rules, limits=limits, paths=False)
    ended = np.array(result.status)
    if cut:  # the estimate keeps out what is over the limit, which the search takes for what leads nowhere
        ended[ended == Status.INFEASIBLE] = Status.COST_LIMIT
    better = result.cost < cost[chosen]
    undriven = np.isinf(cost[chosen]) | better
    cost[chosen[better]] = result.cost[better]
    status[chosen[undriven]] = ended[undriven]
    return cost, status
