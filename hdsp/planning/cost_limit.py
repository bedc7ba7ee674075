"""Cost limits of queries, despite the rounding in a search.

A search adds costs in single precision, a plan in double precision. A plan at exactly the limit may therefore cost more
than the limit in the store. Searches get a slightly larger limit, so that they lose no plan, and each plan is judged by
its own cost.
"""

from __future__ import annotations

from dataclasses import replace

from hdsp.detailed.search.bounds import rounding
from hdsp.detailed.search.life_cycle import Hopeless
from hdsp.detailed.search.outcome import Limits, Status
from hdsp.planning.answers.plans import Plan
from hdsp.planning.query import Query, Solver


def within_rounding(query: Query) -> Limits:
    """Returns the limits of a query with the largest cost in the store that a plan within the limit may have."""
    limits = query.limits
    return replace(limits, cost=limits.cost * (1 + rounding(query.world) * limits.cost))


def at_most(search: Solver) -> Solver:
    """Returns a search whose plans cost at most the limit of the query, and that finds plans at exactly this limit."""

    def searched(query: Query, hopeless: Hopeless | None) -> Plan:
        plan = search(replace(query, limits=within_rounding(query)), hopeless)
        if plan.status == Status.COST_LIMIT:
            return plan.renewed({"lower_bound": query.limits.cost})
        if not plan.solved or plan.cost <= query.limits.cost:
            return plan
        # Between the limit and the limit with its rounding: another plan may cost less.
        spent = plan.stats.expansions, plan.stats.search_seconds
        limits = replace(query.limits, expansions=max(query.limits.expansions - spent[0], 0))
        plan = search(replace(query, limits=limits), None)
        plan = plan.renewed(
            {"expansions": plan.stats.expansions + spent[0], "search_seconds": plan.stats.search_seconds + spent[1]}
        )
        return judged(query, plan)

    return searched


def judged(query: Query, plan: Plan) -> Plan:
    """Returns a plan, or the answer that no plan keeps the limit where this one costs more."""
    if not plan.solved or plan.cost <= query.limits.cost:
        return plan
    return query.without_path(plan, Status.COST_LIMIT)
