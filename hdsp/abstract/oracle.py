"""Oracle: costs of the 22 abstract actions from one state, as the detailed planner finds them.

Source: paper, Sec. V-C. T_a->d converts start and goals; each feasible task gets its optimal plan's cost. In the
published labels, the robot never turns far from its heading during a translation, and turning there costs more
(docs/cost-model.md). This rule belongs to labels, not to planning; ``CostKind`` names both kinds of costs.
"""

from enum import StrEnum
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from hdsp.abstract.transform import feet_at_all
from hdsp.base.errors import InputError
from hdsp.base.settings import Count, Positive, checked
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.relaxed.foothold_regions import FootholdRegions, efforts_to, find_foothold_regions
from hdsp.detailed.relaxed.poses import Poses, new_poses
from hdsp.detailed.relaxed.relaxed_costs import costs_to_go, explore, least_costs
from hdsp.detailed.search.estimate import least_foot_cost, pose_estimate, with_step_efforts
from hdsp.detailed.search.outcome import Limits, Status
from hdsp.detailed.search.weighted_astar import solve
from hdsp.detailed.world.world import World
from hdsp.robot.lattice import ABSTRACT_ACTIONS, CELLS_PER_ABSTRACT, HEADINGS, HEADINGS_PER_ABSTRACT


class CostKind(StrEnum):
    """Two costs of the same task.

    ``LABEL`` keeps the rules of the published labels: a window of headings, and more expensive turns inside it.
    ``PLANNING`` is the least cost between the two states without these rules, as a plan of the detailed planner has it.
    A planning cost never exceeds the label's cost, and every task with a feasible label has one.
    """

    LABEL = "label"
    PLANNING = "planning"


def checked_kind(kind: CostKind | str) -> CostKind:
    """Returns the kind of costs with this name; raises InputError if none has it."""
    if kind not in tuple(CostKind):
        raise InputError(f"kind of costs {kind!r}; need {' or '.join(CostKind)}")
    return CostKind(kind)


class Shared(NamedTuple):
    """Data that searches from several starts on one terrain share.

    Attributes:
        poses: poses at all headings (``hdsp.detailed.relaxed.poses``).
        regions: foothold regions under no rules, which allow the most steps.
    """

    poses: Poses
    regions: FootholdRegions


@checked
class LabelSettings:
    """Labelling rules, for every robot: costs are relative to those of the robot.

    Attributes:
        heading_window: largest distance from the task's heading during a translation, in heading steps (5.625 degrees).
        turn_cost_factor: turn cost during a translation, relative to its normal value.
        cost_limit_factor: tasks that are more expensive, by this factor, than the robot's most expensive action on flat
            ground (``hdsp.abstract.flat_table.cost_limit``) count as infeasible. Momaro's limit is 1.6; its published
            labels end at 1.48.
        max_expansions: memory safeguard, far above usual searches. A search beyond it ends undecided; its tasks count
            as infeasible and keep this status.
        planning_costs: whether feasible tasks also get their cost for planning (``CostKind``).
    """

    heading_window: Annotated[int, Field(ge=0, le=HEADINGS)] = 3
    turn_cost_factor: Positive = 1.68099
    cost_limit_factor: Positive = 2.385139176
    max_expansions: Count = 10_000_000
    planning_costs: bool = False


def task_costs(
    world: World,
    start: np.ndarray,
    settings: LabelSettings,
    cost_limit: float,
    actions: np.ndarray = ABSTRACT_ACTIONS,
    kind: CostKind = CostKind.LABEL,
    *,
    at_most: np.ndarray | None = None,
    shared: Shared | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Costs of abstract actions from a valid detailed state.

    Args:
        world: terrain and robot.
        start: int64 [7], lattice units; its heading is an abstract one.
        settings: labelling rules. Planning costs use the limit on expansions alone.
        cost_limit: more expensive tasks count as infeasible.
        actions: int64 [n, 3], a selection of the 22 actions, in the lattice frame.
        kind: label or planning costs.
        at_most: float64 [n], for planning costs: known upper bounds, such as label costs; inf where unknown. They save
            most of the work where they are tight.
        shared: for costs from several starts on this terrain.

    Returns:
        Goal states int64 [n, 7] (neutral feet if none are valid), costs float64 [n] (inf if not solved) and the
        ``Status`` of each task, int64 [n].
    """
    bases = start[:3] + actions * np.array([CELLS_PER_ABSTRACT, CELLS_PER_ABSTRACT, HEADINGS_PER_ABSTRACT])
    bases[:, 2] %= HEADINGS
    goals, valid = feet_at_all(world, bases)
    cost = np.full(len(goals), np.inf)
    reason = np.full(len(goals), Status.INVALID_GOAL, dtype=np.int64)
    turning = actions[:, 2] != 0
    heading = int(start[2])
    if kind == CostKind.PLANNING:
        rules_of = [(Rules(heading), np.ones(len(actions), bool))]
    else:
        translate = Rules(heading, settings.heading_window, settings.turn_cost_factor)
        rules_of = [(translate, ~turning), (Rules(heading, HEADINGS_PER_ABSTRACT, 1.0), turning)]
    tasks = [(rules, np.flatnonzero(those & valid)) for rules, those in rules_of]
    window = max((rules.heading_window for rules, chosen in tasks if len(chosen)), default=0)
    poses = shared.poses if shared else new_poses(world, heading, window)
    known = np.full(len(goals), np.inf) if at_most is None else np.asarray(at_most, float)
    for rules, chosen in tasks:
        if len(chosen):
            task = goals[chosen], known[chosen], rules, settings, cost_limit
            cost[chosen], reason[chosen] = _search(world, start, *task, poses, shared and shared.regions)
    return goals, cost, reason


def _search(
    world: World,
    start: np.ndarray,
    goals: np.ndarray,
    known: np.ndarray,
    rules: Rules,
    settings: LabelSettings,
    cost_limit: float,
    poses: Poses,
    regions: FootholdRegions | None = None,
):
    """Costs and statuses for goals with the same rules, and with known upper bounds on their costs (inf: none).

    Goals out of reach in the relaxed problem are infeasible; goals within its reach, but beyond the limit, are over the
    limit. The relaxed problem also gives the cost of driving alone. A search with all actions runs only for goals with
    a possibly lower cost, once for all of them.
    """
    cost_limit = min(cost_limit, float(known.max()))
    relaxed = explore(world, rules, start, cost_limit, goals, poses)
    least, cost = least_costs(world, relaxed, start, goals), np.minimum(relaxed.driven, known)
    unreached = Status.COST_LIMIT if relaxed.cut else Status.INFEASIBLE
    status = np.where(np.isfinite(least), Status.COST_LIMIT, unreached).astype(np.int64)
    status[np.isfinite(cost)] = Status.SOLVED
    limit = np.where(np.isfinite(cost), cost * (1 - 1e-6), cost_limit)
    chosen = np.flatnonzero(least < limit)
    if not len(chosen):
        return cost, status
    # A goal with a lower limit gets an initial cost, so that one limit on f serves all goals.
    highest = limit[chosen].max()
    to_go, cut = costs_to_go(world, rules, relaxed, start, goals[chosen], highest - limit[chosen], highest)
    regions = regions or find_foothold_regions(world, rules, least_foot_cost(world))
    view = pose_estimate(world, to_go, relaxed.follow, goals[chosen, 3:])
    view = with_step_efforts(view, regions.region, efforts_to(regions, world, goals[chosen]))
    limits = Limits(cost=highest, expansions=settings.max_expansions)
    result = solve(world, start, goals[chosen], view, rules=rules, limits=limits, paths=False)
    ended = np.array(result.status)
    if cut:  # the estimate excludes states over the limit, and the search then reports no way
        ended[ended == Status.INFEASIBLE] = Status.COST_LIMIT
    better = result.cost < cost[chosen]
    undriven = np.isinf(cost[chosen]) | better
    cost[chosen[better]] = result.cost[better]
    status[chosen[undriven]] = ended[undriven]
    return cost, status
