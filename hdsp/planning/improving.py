"""Anytime planning: plans that get better, each with a proven bound."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import replace

import numpy as np

from hdsp.base.errors import RefinementError
from hdsp.base.gradual import now
from hdsp.detailed.search import anytime
from hdsp.detailed.search.bounds import LEAST_GAIN, rounding, suboptimality
from hdsp.detailed.search.outcome import Limits, Status
from hdsp.planning.answers.plan_statistics import PlanStatistics
from hdsp.planning.answers.plans import Plan
from hdsp.planning.cost_limit import judged, within_rounding
from hdsp.planning.memory import proof_memory
from hdsp.planning.polish import Polish
from hdsp.planning.query import Query, ReachedStates
from hdsp.planning.refinable import RefusedSteps, polished_and_refinable, without


def improving_plans(
    query: Query, weights: Sequence[float], refinable: bool, polish: Polish, prepared: float
) -> Iterator[Plan]:
    """Yields better and better plans; see ``Planner.improve``.

    Args:
        query: the query; its limits cover all rounds together.
        weights: weights of the rounds, falling.
        refinable: whether the robot must be able to carry out each plan.
        polish: budget for the improvement of each better plan of a round.
        prepared: time for the heuristic, s.
    """
    query = replace(query, ends=now() + max(0.0, query.limits.time - prepared))
    best, last, shown, lower, found = None, None, np.inf, 0.0, np.inf
    polished, unpolished = {"polish_expansions": 0, "polish_seconds": 0.0}, None
    error = rounding(query.world)
    refused = RefusedSteps(query)
    rounds = _rounds(query, weights, refused, polish if refinable else None)
    with closing(rounds):
        for plan, ended in rounds:
            lower = max(lower, plan.stats.lower_bound)
            searched = plan.stats.search_seconds - polished["polish_seconds"]
            if plan.cost < found * (1 - LEAST_GAIN):
                found = plan.cost
                plan = _polished(without(query, refused.banned), plan, polish, refinable)
                polished = {name: polished[name] + plan.stats[name] for name in polished}
            better = plan.solved and (best is None or plan.cost < best.cost * (1 - LEAST_GAIN))
            best, unpolished = (plan, plan.stats.unpolished_cost) if better else (best, unpolished)
            if best is None and ended is None:
                continue
            if best is not None and ended in (Status.INFEASIBLE, Status.COST_LIMIT):
                ended = Status.SOLVED  # there is no other plan without the refused steps
            bound = np.inf if best is None else suboptimality(best.cost, lower, error)
            if bound <= weights[-1]:
                ended = Status.SOLVED
            how = None if ended is None else str(ended)
            seconds = searched + plan.stats.proof_seconds + prepared + polished["polish_seconds"]
            if last is not None and not better and bound >= shown:
                if how is not None:
                    last.stats.end(how, seconds)
                    return
                continue
            stats = {
                **plan.stats,
                **polished,
                "unpolished_cost": unpolished,
                "search_seconds": searched,
                "lower_bound": lower,
                "ended": how,
                "heuristic_seconds": prepared,
                "seconds": seconds,
            }
            shown, last = bound, (best or plan).renewed(stats, bound=bound, refused=tuple(refused.words))
            yield last
            if ended is not None:
                return


def _polished(query: Query, plan: Plan, polish: Polish, refinable: bool) -> Plan:
    return polished_and_refinable(query, plan, polish) if refinable else polish.of(query, plan)


def _rounds(
    query: Query, weights: Sequence[float], refused: RefusedSteps, refinable: Polish | None
) -> Generator[tuple[Plan, Status | None]]:
    """Yields plans from all rounds, and the end of the search.

    After a refused step the rounds start again without it, from the present weight on. A plan that cannot be carried
    out without a step to blame gives way to the plan before.

    Args:
        query, weights: as in ``improving_plans``.
        refused: steps that could not be carried out; grows.
        refinable: budget for polished plans in place of plans that cannot be carried out; None: plans are not refined.
    """
    began, spent, cost, world = now(), 0, np.inf, query.world
    kept: Plan | None = None
    proof = query.proof()
    guide = None if query.admissible else query.estimate
    admissible = query.estimate if guide is None else query.grid_anchor()
    reached = ReachedStates(query.goal)
    while True:
        limits = query.limits
        memory = limits.memory - (proof_memory(world) if query.may_prove else 0)
        left = Limits(within_rounding(query).cost, limits.expansions - spent, memory, query.time_left())
        rounds = anytime.improve(
            world,
            query.start,
            query.goals,
            weights,
            admissible,
            guide,
            limits=left,
            # A refused step is part of a plan.
            hopeless=proof.succeeds_by if query.may_prove and not refused.words else None,
            progress=query.progress,
            at_end=reached.take,
        )
        for found in rounds:
            plan = query.plan_of(found.result, PlanStatistics(query.heuristic.name, float(found.weight)), reached)
            plan = judged(query, plan)
            spent_now = {
                "expansions": plan.stats.expansions + spent,
                "search_seconds": now() - began - proof.seconds,
                "proof_seconds": proof.seconds,
            }
            plan = plan.renewed(spent_now)
            if refinable is not None and plan.solved and plan.cost < cost * (1 - LEAST_GAIN):
                try:
                    plan, again = refused.tried(query, plan, refinable)
                except RefinementError:
                    if kept is None:
                        raise
                    plan, again = kept.renewed({**spent_now, "lower_bound": plan.stats.lower_bound}), False
                if again:
                    world, spent = world._replace(banned=refused.banned), plan.stats.expansions
                    weights = weights[weights.index(found.weight) :]
                    break
                if refused.undecided:
                    yield query.without_path(plan, Status.TIME_LIMIT), Status.TIME_LIMIT
                    return
                cost, kept = plan.cost, plan
            if found.ended == Status.INFEASIBLE and not plan.solved and query.may_prove and not refused.words:
                proof.succeeds_by(query.ends)
                plan = query.without_way(plan, proof.found)
            costly = found.ended == Status.SOLVED and not plan.solved
            yield plan, Status.COST_LIMIT if costly else found.ended
        else:
            return
