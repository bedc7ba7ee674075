"""Every plan has a finite bound, and no bound claims too much."""

import pickle

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from hdsp import HeightMap, Planner
from hdsp.abstract import FlatCosts
from hdsp.detailed.search import weighted_astar
from hdsp.planning.heuristics import GeometricHeuristic
from hdsp.terrain.random_arenas import random_arena
from hdsp.terrain.scenes import CATEGORIES
from tests.detailed.instances import small_map, toy, valid_states
from tests.naive import Naive

ROUNDED = 1 + 1e-5
robots = st.builds(lambda backward: toy(step={"backward": backward}), st.booleans())
terrains = st.builds(small_map, st.sampled_from(CATEGORIES), st.integers(0, 10_000), st.just(16))


class Exaggerating(GeometricHeuristic):
    admissible = consistent = False

    def estimate_for(self, goal):
        estimate = super().estimate_for(goal)
        return estimate._replace(distance=3 * estimate.distance, turn=5 * estimate.turn)


@settings(max_examples=20, deadline=None, suppress_health_check=list(HealthCheck))
@given(robots, terrains, st.integers(0, 1000), st.sampled_from([0, 20, 10**6]), st.booleans())
def test_a_bound_never_claims_too_much(robot, heights, seed, settled, abstract):
    states = valid_states(Naive(heights, robot), np.random.default_rng(seed), 25)
    assume(len(states) > 1)
    exact = Planner(HeightMap(heights), robot, conditioning=None)
    start, goal = (exact.grid.to_world(state) for state in (states[0], states[-1]))
    least = exact.plan(start, goal, start_free=False).cost
    assume(np.isfinite(least))
    heuristic = FlatCosts(robot) if abstract else Exaggerating(exact.world)
    planner = Planner(exact.terrain, robot, heuristic, conditioning=None)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(weighted_astar, "LEAST_SETTLED", settled)
        plans = [planner.plan(start, goal, 2.0, start_free=False, polish=seconds) for seconds in (0.0, 0.1)]
    for plan in plans:
        assert plan.solved and plan.stats.lower_bound <= least * ROUNDED
        assert plan.cost <= plan.bound * least * ROUNDED < np.inf and plan.bound >= 1
    assert plans[1].bound <= plans[0].bound


def test_more_of_the_backward_search_proves_more_and_a_bound_stays_with_its_plan(monkeypatch):
    planner, ends = Planner(random_arena(7), heuristic="manual"), ((4.0, 3.35, 3.14), (1.0, 1.2, -1.57))
    monkeypatch.setattr(weighted_astar, "LEAST_SETTLED", 0)
    little = planner.plan(*ends, 1.25, polish=0.0)
    monkeypatch.setattr(weighted_astar, "LEAST_SETTLED", 10**5)
    much = planner.plan(*ends, 1.25, polish=0.0)
    assert much.cost == little.cost and 1 < much.bound < little.bound < np.inf
    assert much.cost == pytest.approx(much.bound * much.stats.lower_bound)
    for copy in (pickle.loads(pickle.dumps(much)), much.renewed({"seconds": 1.0})):
        assert (copy.bound, copy.stats.lower_bound) == (much.bound, much.stats.lower_bound)
