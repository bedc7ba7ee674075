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
        cost_ratio, cost_margin: tasks that driving alone cannot do also count as infeasible if they cost more than
            this ratio of, plus this margin over, what they would cost if feet could be anywhere (the relaxed problem;
            on flat ground the cost itself). Of the published ones none does.
        max_expansions: a search that takes more ends undecided; its tasks count as infeasible and say so.
    """

    heading_window: int = 3
    turn_cost_factor: float = 1.58235
    cost_limit: float = 1.6
    cost_ratio: float = 2.0
    cost_margin: float = 0.15
    max_expansions: int = 100_000

    def __post_init__(self):
        positive = (self.turn_cost_factor, self.cost_limit, self.cost_ratio, self.max_expansions)
        if self.heading_window < 0 or self.cost_margin < 0 or min(positive) <= 0:
            raise InputError(f"{self}: the window and the margin must not be negative, all else must be positive")


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
    """Costs and statuses of goals under the same rules, each up to its own cost limit.

    First by driving alone, a problem of three dimensions; then with all actions, where only what is cheaper than that
    is still looked for, again in one search for all goals.
    """
    cost, status = np.full(len(goals), np.inf), np.full(len(goals), Status.COST_LIMIT)
    costs = pose_costs(world, rules)
    # What even the relaxed problem cannot reach, or only beyond its limit, needs no search.
    reach = pose_distances(world, rules, costs, start[None, :3], np.zeros(1), False, settings.cost_limit)
    least = reach[goals[:, 2], goals[:, 0], goals[:, 1]].astype(float)
    possible = np.isfinite(least)
    limit = np.full(len(goals), settings.cost_limit)

    def search(chosen: np.ndarray, rules: Rules):
        # Goals that may cost less start later: f then has one limit for all.
        highest = limit[chosen].max()
        to_go = pose_distances(world, rules, costs, goals[chosen, :3], highest - limit[chosen], True, highest)
        limits = Limits(cost=highest, expansions=settings.max_expansions)
        view = pose_estimate(world, to_go, goals[chosen, 3:])
        if not rules.drive_only:
            view = with_footing(view, footing, efforts_to(footing, world, goals[chosen]))
        return solve(world, start, goals[chosen], view, rules=rules, limits=limits, paths=False)

    footing = find_footing(world, rules, least_foot_cost(world))
    driven = np.flatnonzero(possible & ~goals[:, 3:].any(axis=1))
    if len(driven) and not start[3:].any():
        result = search(driven, rules._replace(drive_only=True))
        solved = driven[np.isfinite(result.cost)]
        cost[driven], status[solved] = result.cost, Status.SOLVED
    bounded = np.minimum(settings.cost_ratio * least + settings.cost_margin, settings.cost_limit)
    limit = np.where(np.isfinite(cost), cost * (1 - 1e-6), bounded)
    chosen = np.flatnonzero(possible)
    if len(chosen):
        result = search(chosen, rules)
        better = result.cost < cost[chosen]
        cost[chosen[better]] = result.cost[better]
        undriven = np.isinf(cost[chosen]) | better
        status[chosen[undriven]] = np.asarray(result.status)[undriven]
    return cost, status
