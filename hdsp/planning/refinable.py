"""Plans without steps that the robot cannot carry out."""

from __future__ import annotations

from dataclasses import replace

from hdsp.base.errors import RefinementError
from hdsp.detailed.motion.refinement import ban, last_step
from hdsp.planning.answers.plans import Plan
from hdsp.planning.query import Query, Solver


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


def refinable_plan(query: Query, search: Solver, plan: Plan) -> Plan:
    """Searches again without the refused steps, until the robot can carry out the plan or no other plan exists.

    Args:
        query: the query; its limits cover all searches together.
        search: the search.
        plan: its first plan.

    Raises:
        RefinementError: an action before the first step cannot be carried out.
    """
    refused = RefusedSteps(query)
    expansions, seconds = plan.stats.expansions, plan.stats.search_seconds
    while plan.solved and refused.refuse_from(plan):
        left = replace(query.limits, expansions=query.limits.expansions - expansions)
        plan = search(replace(query, world=query.world._replace(banned=refused.banned), limits=left), None)
        expansions += plan.stats.expansions
        seconds += plan.stats.search_seconds
    if refused.undecided:
        plan = query.out_of_time(plan)
    return plan.renewed({"expansions": expansions, "search_seconds": seconds}, refused=tuple(refused.words))
