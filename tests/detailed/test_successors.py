import math
from collections import Counter

import numpy as np
import pytest

from hdsp.detailed.actions.action import Action, ActionKind, action_of, undo
from hdsp.detailed.actions.state_costs import state_cost
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.states import pack_states, unpack_states
from hdsp.detailed.world.world import build_world
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import CATEGORIES, random_map
from tests.detailed.instances import (
    SHORT_ARCS,
    TOY,
    WIDE_ARCS,
    action_tuple,
    blocky,
    kernel_successors,
    near_edges,
    successor_arrays,
    toy,
    valid_states,
)
from tests.naive import Naive


def assert_same_successors(world, twin, state, rules=None):
    """Asserts that kernel and twin agree on a state; returns the kinds of its actions."""
    found = kernel_successors(world, state, rules)
    expected = {(action, reached): cost for action, reached, cost in twin.successors(state)}
    assert set(found) == set(expected), f"at {state}"
    for which, cost in expected.items():
        assert found[which] == pytest.approx(cost, rel=1e-6, abs=1e-9), f"{which} at {state}"
    return Counter(action[0] for action, _ in expected)


@pytest.mark.parametrize("category", CATEGORIES)
def test_successors_equal_the_twins_on_random_terrains(category):
    rng = np.random.default_rng(CATEGORIES.index(category))
    heights = random_map(11, category, 0).heights
    robot = Robot.load("momaro")
    world, twin = build_world(HeightMap(heights), robot), Naive(heights, robot)
    neutral = valid_states(twin, rng, 25)
    states = near_edges(twin, neutral)[:4] + neutral[:3] + valid_states(twin, rng, 3, neutral=False)
    assert len(states) > 4
    for state in states:
        assert_same_successors(world, twin, state)


def test_successors_of_all_kinds_equal_the_twins():
    kinds = Counter()
    for seed in range(30):
        onward = {"backward": seed % 3 > 0}
        factors = {**TOY["drive"]["deviation_cost"], "behind": math.inf if seed % 5 == 0 else 2.3}
        drive = {"level": 0.07 + 0.1 * (seed % 2), "sideways": seed % 4 > 0, "deviation_cost": factors}
        robot = toy(step=onward, base_shift=onward, drive=drive)
        rng = np.random.default_rng(seed)
        heights = blocky(rng)
        heights[rng.random(heights.shape) < 0.01] = np.nan
        world, twin = build_world(HeightMap(heights), robot), Naive(heights, robot)
        states = near_edges(twin, valid_states(twin, rng, 80))[:10] + valid_states(twin, rng, 5, neutral=False)
        for state in states:
            kinds += assert_same_successors(world, twin, state)
    assert min(kinds[kind] for kind in ("drive", "turn", "foot", "shift", "step")) >= 30, kinds


@pytest.mark.parametrize("robot", [SHORT_ARCS, WIDE_ARCS], ids=["short", "wide"])
def test_arcs_equal_the_twins(robot):
    kinds, most = Counter(), robot.drive.straight_deviation
    rules = Rules(heading_center=10, heading_window=12, turn_cost_factor=1.5)
    for seed in range(12):
        rng = np.random.default_rng(seed)
        heights = blocky(rng, cells=18, blocks=1 + seed % 2)
        center, window, factor = (10, 12, 1.5) if seed % 2 else (0, 64, 1.0)
        world, twin = build_world(HeightMap(heights), robot), Naive(heights, robot, center, window, factor)
        for state in valid_states(twin, rng, 12, headings=range(64) if seed % 2 == 0 else range(62, 87)):
            state = (*state[:2], state[2] % 64, *state[3:])
            kinds += assert_same_successors(world, twin, state, rules if seed % 2 else None)
    assert kinds["arc"] >= 60 and kinds["turn"] == 0, kinds
    arcs = build_world(HeightMap.flat((20, 20)), robot).tables.arcs[..., :2]
    length = np.hypot(arcs[..., 0], arcs[..., 1])
    assert (length * 0.025 >= 2 * robot.turn.radius * math.sin(math.pi / 64) - 1e-9).all()
    mean = (np.arange(64)[:, None] + 0.5 * np.array([1, -1, 1, -1])) * math.pi / 32 + np.array([0, 0, 1, 1]) * math.pi
    off = np.angle(np.exp(1j * (np.arctan2(arcs[..., 1], arcs[..., 0]) - mean)))
    assert (abs(off) <= most + 1e-9).all()


def test_rules_of_labelling_limit_and_price_turns():
    robot, rules = toy(), Rules(heading_center=62, heading_window=3, turn_cost_factor=1.5)
    heights = blocky(np.random.default_rng(3))
    world, twin = build_world(HeightMap(heights), robot), Naive(heights, robot, center=62, window=3, turn_factor=1.5)
    states = [
        (*state[:2], heading, *state[3:])
        for state in valid_states(twin, np.random.default_rng(3), 10)
        for heading in (59, 62, 0, 1)
    ]
    turns = Counter()
    for state in filter(twin.valid, states):
        assert_same_successors(world, twin, state, rules)
        turns[state[2]] += sum(action[0] == "turn" for action, _ in kernel_successors(world, state, rules))
    assert turns[1] > 0 and turns[59] > 0 and turns[62] > turns[1], turns


def test_state_costs_and_validity_equal_the_twins():
    robot, checked = toy(), Counter()
    for seed in range(6):
        rng = np.random.default_rng(seed)
        heights = blocky(rng)
        world, twin = build_world(HeightMap(heights), robot), Naive(heights, robot)
        for _ in range(150):
            state = (*rng.integers(0, 12, 2).tolist(), int(rng.integers(64)), *rng.integers(-2, 2, 4).tolist())
            cost = state_cost(world, int(pack_states(state, -2)[0]))
            assert cost == pytest.approx(twin.state_cost(state), rel=1e-6)
            checked[bool(np.isfinite(cost))] += 1
    assert min(checked.values()) > 100


@pytest.mark.parametrize("robot", [toy(), WIDE_ARCS, Robot.load("momaro")], ids=["toy", "wide", "momaro"])
def test_undo_inverts_every_action(robot):
    kinds, size = Counter(), 12 if robot.name == "toy" else 72
    for seed in range(4):
        rng = np.random.default_rng(seed)
        heights = blocky(rng) if robot.name == "toy" else random_map(2, "cuboid_2", seed).heights
        world, twin = build_world(HeightMap(heights), robot), Naive(heights, robot)
        neutral = valid_states(twin, rng, size)
        states = near_edges(twin, neutral)[:4] + neutral[:3] + valid_states(twin, rng, 4, neutral=False)
        t = world.tables
        for state in states:
            key = int(pack_states(state, t.lowest)[0])
            keys, _, actions = successor_arrays(world, state)
            for reached, action in zip(keys, actions, strict=True):
                back = undo(np.int64(reached), action, t.move_dx, t.move_dy, t.shifts, t.arcs)
                assert back == key, f"{action_of(int(action))} from {state}"
                kinds[action_tuple(int(action))[0]] += 1
    assert len(kinds) == 5, kinds


def test_states_survive_packing():
    rng = np.random.default_rng(0)
    bases, headings, feet = rng.integers(0, 65536, (500, 2)), rng.integers(0, 64, 500), rng.integers(-12, 13, (500, 4))
    states = np.column_stack([bases, headings, feet])
    assert (unpack_states(pack_states(states, -12), -12) == states).all()
    assert len(np.unique(pack_states(states, -12))) == len(np.unique(states, axis=0))


def test_action_names_say_what_moves_and_how_far():
    assert [str(action_of(code)) for code in (0, 20, 21, 22, 23, 30, 31)] == [
        "drive", "turn_left", "turn_right", "foot_move front_left +0.025", "foot_move front_left -0.025",
        "base_shift forward", "base_shift backward",
    ]  # fmt: skip
    step = action_of(32 + 32 * 2 + 16 - 7)
    assert step == Action(ActionKind.STEP, "rear_right", pytest.approx(-0.175)) and step.stepping_foot == 2
    assert str(step) == "step rear_right -0.175"
    assert action_of(22).stepping_foot is None
