"""The oracle: what the 22 abstract actions from one state cost the detailed planner itself.

Source: paper, Sec. V-C. Start and goals go through T_a->d; each feasible task gets the cost of its optimal plan. In the
published labels a translation never turns far from its heading, and turning there costs more (docs/cost-model.md); that
rule belongs to labels, not to planning.
"""

from dataclasses import dataclass

import numpy as np

from hdsp.abstract.transform import feet_at
from hdsp.detailed.actions import Rules
from hdsp.detailed.estimate import least_foot_cost, pose_estimate, with_footing
from hdsp.detailed.footing import efforts_to, find_footing
from hdsp.detailed.relaxed import costs_to_go, explore, least_costs
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
        max_expansions: a safety net for memory, far above what searches take. One that takes more ends undecided; its
            tasks count as infeasible and say so.
    """

    heading_window: int = 3
    turn_cost_factor: float = 1.58235
    cost_limit: float = 1.6
    max_expansions: int = 10_000_000

    def __post_init__(self):
        if self.heading_window < 0 or min(self.turn_cost_factor, self.cost_limit, self.max_expansions) <= 0:
            raise InputError(f"{self}: the window must not be negative, all else must be positive")


def task_costs(world: World, start: np.ndarray, settings: LabelSettings) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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
    """Costs and statuses of goals under the same rules.

    What the relaxed problem cannot reach is infeasible, and what it reaches beyond the limit is over it. For the rest,
    first driving alone, a problem of three dimensions; then all actions, where only what is cheaper than that is still
    looked for, again in one search for all goals.
    """
    relaxed = explore(world, rules, start, settings.cost_limit)
    least = least_costs(world, relaxed, start, goals)
    possible = least <= settings.cost_limit
    unreached = Status.COST_LIMIT if relaxed.cut[0] else Status.INFEASIBLE
    cost = np.full(len(goals), np.inf)
    status = np.where(np.isfinite(least), Status.COST_LIMIT, unreached).astype(np.int64)
    limit = np.full(len(goals), settings.cost_limit)
    footing = find_footing(world, rules, least_foot_cost(world))

    def search(chosen: np.ndarray, rules: Rules):
        # Goals that may cost less start later: f then has one limit for all.
        highest = limit[chosen].max()
        to_go, cut = costs_to_go(world, rules, relaxed, start, goals[chosen], highest - limit[chosen], highest)
        view = pose_estimate(world, to_go, relaxed.follow, goals[chosen, 3:])
        if not rules.drive_only:
            view = with_footing(view, footing, efforts_to(footing, world, goals[chosen]))
        limits = Limits(cost=highest, expansions=settings.max_expansions)
        result = solve(world, start, goals[chosen], view, rules=rules, limits=limits, paths=False)
        status = np.array(result.status)
        if cut:  # the estimate keeps out what is over the limit, which the search takes for what leads nowhere
            status[status == Status.INFEASIBLE] = Status.COST_LIMIT
        return result.cost, status

    driven = np.flatnonzero(possible & ~goals[:, 3:].any(axis=1))
    if len(driven) and not start[3:].any():
        cost[driven], _ = search(driven, rules._replace(drive_only=True))
        status[np.isfinite(cost)] = Status.SOLVED
        limit = np.where(np.isfinite(cost), cost * (1 - 1e-6), limit)
    chosen = np.flatnonzero(possible & (limit > least))
    if len(chosen):
        found, ended = search(chosen, rules)
        better = found < cost[chosen]
        undriven = np.isinf(cost[chosen]) | better
        cost[chosen[better]] = found[better]
        status[chosen[undriven]] = ended[undriven]
    return cost, status
