"""Robots whose wheels do not steer: labels, abstract costs, heuristics and plans."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hdsp import HeightMap, Planner, Robot
from hdsp.abstract import FlatCosts, ManualCosts, check_abstract_costs
from hdsp.abstract.flat_table import cost_limit, flat_table
from hdsp.abstract.oracle import CostKind, LabelSettings
from hdsp.base.errors import InputError
from hdsp.detailed.actions.action import ActionKind
from hdsp.detailed.search.outcome import Status
from hdsp.labels.rules import label_map
from hdsp.planning.heuristic_conformance import check_heuristic
from hdsp.planning.heuristics.abstract import AbstractHeuristic
from hdsp.robot.lattice import ABSTRACT_ACTIONS, PATCH_CELLS
from hdsp.terrain.scenes import random_map

MOMARO = Robot.load("momaro").to_dict()
ACTIONS = [tuple(action) for action in ABSTRACT_ACTIONS.tolist()]
AHEAD, LEFT, BACK = (ACTIONS.index(action) for action in ((1, 0, 0), (0, 1, 0), (-1, 0, 0)))


def robot(size=1.0, **drive) -> Robot:
    """Momaro with other values for driving, smaller by a factor."""
    factors = MOMARO["drive"]["deviation_cost"] | drive.pop("deviation_cost", {})
    feet = {key: size * value if key != "neutral_preference" else value for key, value in MOMARO["feet"].items()}
    boxes = [{key: size * value for key, value in vars(box).items()} for box in Robot.load("momaro").body.boxes]
    turn = MOMARO["turn"] | drive.pop("turn", {})
    changed = {"drive": {**MOMARO["drive"], "deviation_cost": factors, **drive}, "feet": feet, "body": {"boxes": boxes}}
    return Robot.load({**MOMARO, **changed, "turn": turn, "name": "fixed"})


ARCS = robot(sideways=False, deviation_cost={"behind": 1.2}, turn={"on_the_spot": False, "radius": 0.6})
AHEAD_ONLY = robot(sideways=False, deviation_cost={"behind": math.inf})


@st.composite
def robots(draw):
    factors = st.sampled_from([1.0, 3.0, 20.0, 60.0, math.inf])
    return robot(
        draw(st.sampled_from([0.6, 1.0])),
        sideways=draw(st.booleans()),
        deviation_cost={"side": draw(factors), "behind": draw(factors)},
        turn=draw(st.sampled_from([{}, {"cost": 0.05}])),
    )


@settings(max_examples=8, deadline=None, suppress_health_check=list(HealthCheck))
@given(robot=robots(), seed=st.integers(0, 1000))
def test_robots_of_all_kinds_get_labels_abstract_costs_and_plans(robot, seed):
    flat, category = flat_table(robot), ("cuboid_1", "wall_1", "staircase")[seed % 3]
    terrain = random_map(seed, category, 0)
    labels = label_map(terrain, robot)
    if labels is not None:
        assert not (labels.feasible & np.isinf(flat[0])).any()
        assert (labels.cost[labels.feasible] >= flat[0][labels.feasible] * (1 - 1e-5)).all()
        assert labels.cost.max() <= cost_limit(robot, LabelSettings())
    manual = ManualCosts(robot)
    edges = manual.edges(terrain, (6, 6, 12, 12))
    planned = flat_table(robot, None, CostKind.PLANNING)
    assert (
        (planned <= flat).all() and (edges >= planned[:, None, None] * (1 - 1e-6)).all() and not np.isnan(edges).any()
    )
    feasible, cost = manual.predict(terrain.heights[None], ABSTRACT_ACTIONS[None].astype(np.float32))
    assert not (feasible[0] & np.isinf(flat[0])).any() and (cost[feasible] > 0).all()
    planner = Planner(HeightMap.flat((100, 100)), robot, heuristic="manual")
    plan = planner.plan((1.0, 1.2, 0.0), (1.5, 1.3, 0.4), weight=2.0)
    assert plan.status == Status.SOLVED
    assert plan.cost == pytest.approx(planner.plan((1.0, 1.2, 0.0), (1.5, 1.3, 0.4)).cost, rel=1.0)
    heuristic = AbstractHeuristic(planner.world, planner.terrain, manual)
    heuristic.set_goal(np.array([60, 52, 4, 0, 0, 0, 0]))
    assert np.isfinite(heuristic(np.array([[40, 48, 0, 0, 0, 0, 0]]))).all()


def test_labels_of_flat_ground_are_the_flat_costs():
    for each in (robot(sideways=False), robot(deviation_cost={"side": 20.0}), AHEAD_ONLY):
        labels = label_map(HeightMap.flat((PATCH_CELLS, PATCH_CELLS)), each)
        flat = flat_table(each)[0]
        assert (labels.feasible == np.isfinite(flat)).all()
        np.testing.assert_allclose(labels.cost[labels.feasible], flat[labels.feasible], rtol=1e-6)


def test_a_robot_that_drives_ahead_only_has_its_few_actions():
    flat = flat_table(AHEAD_ONLY)
    assert flat[0, AHEAD] == pytest.approx(0.1) and np.isinf(flat[0, [LEFT, BACK]]).all()
    assert np.isfinite(flat[:, -2:]).all() and np.isfinite(flat).any(axis=1).all()
    costs = FlatCosts(AHEAD_ONLY)
    patches = np.zeros((2, PATCH_CELLS, PATCH_CELLS), np.float32)
    feasible, cost = costs.predict(patches, np.stack([ABSTRACT_ACTIONS] * 2).astype(np.float32))
    assert (feasible == np.isfinite(flat[0])).all() and np.isfinite(cost[feasible]).all()


def test_a_robot_that_does_not_turn_on_the_spot_turns_on_arcs():
    flat, spot = flat_table(ARCS), flat_table(robot(sideways=False))
    assert np.isfinite(flat).all()
    assert (flat[:, -2:] > 2 * spot[:, -2:]).all()  # ahead and back
    labels = label_map(HeightMap.flat((PATCH_CELLS, PATCH_CELLS)), ARCS)
    np.testing.assert_allclose(labels.cost, flat[0], rtol=1e-6)
    planner = Planner(HeightMap.flat((120, 120)), ARCS, heuristic="manual")
    plan = planner.plan((1.0, 1.0, 0.0), (1.9, 1.6, 1.2), weight=1.5, refinable=True)
    kinds = {action.kind for action in plan.actions}
    assert plan.solved and kinds <= {ActionKind.DRIVE, ActionKind.ARC_LEFT, ActionKind.ARC_RIGHT} and len(kinds) > 1
    turned = np.abs(np.angle(np.exp(1j * np.diff(plan.states[:, 2]))))
    moved = np.hypot(*np.diff(plan.states[:, :2], axis=0).T)
    assert (moved >= 2 * 0.6 * np.sin(turned / 2) - 1e-6).all() and turned.sum() >= 1.0
    assert "turns by" in plan.explain() and "driving 100%" in plan.explain() and plan.refine().problems() == []
    exact = planner.plan((1.0, 1.0, 0.0), (1.3, 1.1, 0.3))
    assert planner.plan((1.0, 1.0, 0.0), (1.3, 1.1, 0.3), weight=2.0).cost >= exact.cost * (1 - 1e-6)


def test_a_robot_that_cannot_drive_sideways_parks_like_a_car():
    flat = flat_table(robot(sideways=False))
    assert np.isfinite(flat).all()
    assert flat[0, LEFT] > 5 * flat[0, AHEAD]
    assert (flat == flat_table(robot(deviation_cost={"side": math.inf}))).all()


@pytest.mark.parametrize("costs, each", [(FlatCosts, ARCS), (ManualCosts, AHEAD_ONLY)], ids=["flat arcs", "manual"])
def test_abstract_costs_keep_their_contract(costs, each):
    assert "values" in check_abstract_costs(costs(each))
    assert check_heuristic(lambda world, terrain: AbstractHeuristic(world, terrain, costs(each)), each)


def test_the_cost_limit_follows_from_the_prices_of_the_robot():
    settings = LabelSettings()
    assert cost_limit(Robot.load("momaro"), settings) == 1.6
    twice = {key: {**MOMARO["drive"]["deviation_cost"], "ahead": 2.0, "side": 6.0, "behind": 5.0}[key] for key in
             MOMARO["drive"]["deviation_cost"]}  # fmt: skip
    turn = {**MOMARO["turn"], "cost": 2 * MOMARO["turn"]["cost"]}
    dear = robot(deviation_cost=twice)
    assert cost_limit(Robot.load({**dear.to_dict(), "turn": turn}), settings) == pytest.approx(3.2, rel=1e-6)
    step = {**MOMARO["step"], "cost": 1.0}
    stiff = Robot.load({**MOMARO, "step": step})
    most = 4 * (1.0 + step["cost_per_metre"] * step["max_length"] + step["cost_per_height"] * step["max_height"])
    assert cost_limit(stiff, settings) == pytest.approx(settings.cost_limit_factor * most)


def test_a_robot_larger_than_a_patch_is_refused():
    with pytest.raises(InputError, match="cannot stand even on flat ground"):
        flat_table(Robot.load({**MOMARO, "feet": {**MOMARO["feet"], "neutral_x": 1.2}}))
