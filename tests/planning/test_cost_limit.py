"""Limits on the cost of a plan, to the last digit."""

import numpy as np
import pytest

from hdsp import HeightMap, Planner, Status
from hdsp.detailed.search.bounds import rounding

START = (1.0, 1.5, 0.0)
GOALS = [(1.025, 1.5, 0.0), (1.7, 1.5, 0.0), (1.1, 1.8, 0.7)]


@pytest.fixture(scope="module", params=["geometric", "manual"])
def planner(request):
    return Planner(HeightMap.flat((120, 120)), heuristic=request.param)


@pytest.mark.parametrize("options", [{}, {"anchor_weight": 1.2}, {"weight": 1.5, "polish": 0.0}], ids=str)
def test_a_plan_keeps_a_limit_of_exactly_its_own_cost(planner, options):
    for goal in GOALS:
        plan = planner.plan(START, goal, **options)
        again = planner.plan(START, goal, cost=plan.cost, **options)
        assert again.solved and again.cost <= plan.cost, goal
        below = planner.plan(START, goal, cost=float(np.nextafter(plan.cost, 0)), **options)
        assert below.solved or below.status == Status.COST_LIMIT
        assert below.solved == (below.cost < plan.cost) and len(below.states) == len(below.action_costs) + below.solved


def test_a_proof_that_no_plan_keeps_the_limit_allows_for_rounding(planner):
    for goal in GOALS[:2]:
        least = planner.plan(START, goal, 1.0, anchor_weight=1.0)
        assert least.bound == 1
        for limit in (0.5 * least.cost, float(np.nextafter(least.cost, 0))):
            refused = planner.plan(START, goal, 1.0, cost=limit)
            assert refused.status == Status.COST_LIMIT and not refused.actions and refused.goal_index is None
            error = 3 * rounding(planner.world) * limit
            assert limit * (1 - error) <= refused.stats.lower_bound <= least.cost
            assert refused.explain().startswith("there is no plan within the cost limit")


def test_improved_plans_keep_a_limit_of_exactly_the_least_cost(planner):
    for goal in GOALS[::2]:
        *_, best = planner.improve(START, goal)
        *_, again = planner.improve(START, goal, cost=best.cost)
        assert again.solved and again.cost <= best.cost and again.stats.ended == "solved"
        *_, below = planner.improve(START, goal, cost=float(np.nextafter(best.cost, 0)))
        assert below.solved == (below.cost < best.cost), "other orders of the same actions may have smaller sums"
        assert below.solved or below.stats.ended == str(below.status) == str(Status.COST_LIMIT)
