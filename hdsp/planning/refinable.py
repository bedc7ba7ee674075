"""Plans without steps that the robot cannot carry out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hdsp.base.errors import RefinementError
from hdsp.detailed.motion.refinement import ban, last_step
from hdsp.detailed.search.outcome import Status
from hdsp.planning.answers.plans import Plan
from hdsp.planning.polish import Polish
from hdsp.planning.query import Query, Solver

#: Polished plans that may be refused before a plan stays as it is.
TRIES = 3


class RefusedSteps:
    """Steps that could not be carried out so far.

    Attributes:
        words: one sentence per step.
        banned: int64 [n, 7], the steps as ``World.banned``.
        undecided: whether the time of the query ended before the last plan was refined.
    """

    def __init__(self, query: Query):
        self.words: list[str] = []
        self.banned = query.world.banned
        self.undecided = False
        self._ends = query.ends
        self._world, self._grid = query.world, query.grid

    def refuse_from(self, plan: Plan) -> bool:
        """Refines a plan and refuses the last step before an impossible action; returns whether a step was refused.

        Raises:
            RefinementError: an action before the first step cannot be carried out.
        """
        try:
            self.undecided = not plan.refine_until(self._ends)
        except RefinementError as error:
            k = last_step(plan.actions, error.action)
            if k is None:
                raise
            self.words.append(str(error))
            self.banned = ban(self.banned, self._world, self._grid, plan.states[k], plan.actions[k])
            return True
        return False

    def tried(self, query: Query, plan: Plan, polish: Polish | None) -> tuple[Plan, bool]:
        """Like ``refuse_from``; where no step is to blame, the polished plan takes the place of the plan.

        Args:
            query: the query.
            plan: a plan of it.
            polish: budget for the polished plan; None: there is none.

        Returns:
            The plan, or the polished one, and whether a step was refused.

        Raises:
            RefinementError: neither plan can be carried out, and no step of the plan is to blame.
        """
        try:
            return plan, self.refuse_from(plan)
        except RefinementError:
            polished = plan if polish is None else polish.of(without(query, self.banned), plan)
            if polished.cost >= plan.cost or self.refuse_from(polished):
                raise
            return polished, False


def refinable_plan(query: Query, search: Solver, plan: Plan, polish: Polish | None = None) -> Plan:
    """Searches again without the refused steps, until the robot can carry out the plan or no other plan exists.

    Args:
        query: the query; its limits cover all searches together.
        search: the search.
        plan: its first plan.
        polish: budget for the improvement of the plan that can be carried out; None: it stays as it is.

    Raises:
        RefinementError: an action before the first step cannot be carried out, nor is the polished plan possible.
    """
    refused = RefusedSteps(query)
    expansions, seconds = plan.stats.expansions, plan.stats.search_seconds
    while plan.solved:
        plan, again = refused.tried(query, plan, polish)
        if not again:
            break
        left = replace(query.limits, expansions=query.limits.expansions - expansions)
        plan = search(replace(without(query, refused.banned), limits=left), None)
        expansions += plan.stats.expansions
        seconds += plan.stats.search_seconds
    if refused.undecided:
        plan = query.without_path(plan, Status.TIME_LIMIT)
    elif polish is not None:
        plan = polished_and_refinable(without(query, refused.banned), plan, polish)
    return plan.renewed({"expansions": expansions, "search_seconds": seconds}, refused=tuple(refused.words))


def polished_and_refinable(query: Query, plan: Plan, polish: Polish) -> Plan:
    """Returns a plan that costs at most as much, and that the robot can carry out as well.

    A polished plan with an impossible action is dropped. The polish then begins again without the step to blame.

    Args:
        query: the query, without the refused steps.
        plan: a plan that can be carried out.
        polish: budget for each polished plan.
    """
    refused = RefusedSteps(query)
    for _ in range(TRIES):
        polished = polish.of(without(query, refused.banned), plan)
        if polished.cost >= plan.cost:
            return polished
        try:
            if not refused.refuse_from(polished):
                return plan if refused.undecided else polished
        except RefinementError:  # no step is to blame
            return plan
    return plan


def without(query: Query, banned: np.ndarray) -> Query:
    """Returns the same query with other refused steps, as ``World.banned``."""
    return replace(query, world=query.world._replace(banned=banned))
