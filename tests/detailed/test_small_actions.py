"""All actions on small maps against the textbook twin; quick enough to run without the JIT, for mutation testing."""

import math
from collections import Counter
from functools import cache
from itertools import product

import numpy as np
import pytest

from hdsp.detailed.actions.action import ActionKind, action_of, undo
from hdsp.detailed.actions.any_feet import can_step_from_neutral, least_pose_cost, stands_on_neutral
from hdsp.detailed.actions.manoeuvres import is_banned
from hdsp.detailed.actions.state_costs import state_cost, state_costs
from hdsp.detailed.actions.successors import MAX_SUCCESSORS, Rules, allowed_headings
from hdsp.detailed.states import pack_states
from hdsp.detailed.world.body import look_at_body
from hdsp.detailed.world.world import build_world, cell_index
from hdsp.robot.robot import FEET
from hdsp.terrain.height_map import HeightMap
from tests import naive_relaxed
from tests.detailed.instances import (
    NIMBLE,
    action_tuple,
    kernel_successors,
    successor_arrays,
    toy,
    valid_states,
)
from tests.detailed.small_scenes import SCENES, by_scene, small_scene
from tests.naive import Naive

FOUND = {"drive": 400, "turn": 60, "arc": 30, "foot": 300, "shift": 50, "step": 30}


def some_states(name, count=60):
    """States of a scene, first those from which a foot steps."""
    graph = small_scene(name).graph
    steps = {state: sum(action[0] == "step" for action, _, _ in edges) for state, edges in graph.items()}
    return sorted(graph, key=lambda state: -steps[state])[: count // 2] + sorted(graph)[:: 2 * len(graph) // count + 1]


@by_scene
def test_actions_equal_the_twins_and_are_undone(name):
    scene, t = small_scene(name), small_scene(name).world.tables
    scene.world.base[:] = 0  # no body was looked at before
    for state in some_states(name):
        found = kernel_successors(scene.world, state, scene.rules)
        expected = {(action, reached): cost for action, reached, cost in scene.graph[state]}
        assert set(found) == set(expected), state
        assert all(found[which] == pytest.approx(cost, rel=1e-6) for which, cost in expected.items()), state
        for reached, _, code in zip(*successor_arrays(scene.world, state, scene.rules), strict=True):
            before = undo(np.int64(reached), int(code), t.move_dx, t.move_dy, t.shifts, t.arcs)
            assert before == pack_states(state, t.lowest)[0]
            assert_named(int(code))


def assert_named(code):
    """The name of an action says which foot moves, and how."""
    kind, *how = action_tuple(code)
    action = action_of(code)
    if kind in ("drive", "turn"):
        turns = {1: ActionKind.TURN_LEFT, -1: ActionKind.TURN_RIGHT}
        assert action.kind == (ActionKind.DRIVE if kind == "drive" else turns[how[0]])
        assert action.foot is action.length is action.stepping_foot is None and str(action) == str(action.kind)
    elif kind in ("foot", "step"):
        assert action.kind == {"foot": ActionKind.FOOT_MOVE, "step": ActionKind.STEP}[kind]
        assert action.foot == FEET[how[0]] and action.length == pytest.approx(how[1] * 0.025)
        assert action.stepping_foot == (how[0] if kind == "step" else None)
        assert str(action) == f"{action.kind} {FEET[how[0]]} {how[1] * 0.025:+.3f}"
    else:
        sides = {1: ActionKind.ARC_LEFT, -1: ActionKind.ARC_RIGHT}
        assert action.kind == (ActionKind.BASE_SHIFT if kind == "shift" else sides[how[1]])
        assert action.foot is None and math.copysign(1, action.length) == how[0]
        assert str(action) == f"{action.kind} {'forward' if how[0] == 1 else 'backward'}"


def test_all_kinds_of_actions_occur():
    kinds = Counter(
        action[0] for name in SCENES for state in some_states(name) for action, _, _ in small_scene(name).graph[state]
    )
    assert all(kinds[kind] >= count for kind, count in FOUND.items()), kinds


@by_scene
def test_a_window_of_headings_and_a_factor_apply_to_turns(name):
    scene = small_scene(name)
    state = next(state for state, edges in scene.graph.items() if edges and edges[0][0][0] == "drive")
    for center, window, factor in ((state[2], 0, 1.0), ((state[2] + 40) % 64, 25, 1.5), ((state[2] + 5) % 64, 5, 0.5)):
        twin, rules = scene.twin, Rules(center, window, factor)
        allowed = {h for h in range(64) if min(abs(h - center), 64 - abs(h - center)) <= window}
        assert set(np.flatnonzero(allowed_headings(rules)).tolist()) == allowed
        twin.center, twin.window, twin.turn_factor = center, window, factor
        expected = {(action, reached): cost for action, reached, cost in twin.successors(state)}
        twin.center, twin.window, twin.turn_factor = scene.start[2], scene.rules.heading_window, 1.0
        assert kernel_successors(scene.world, state, rules) == pytest.approx(expected, rel=1e-6)


@by_scene
def test_driving_alone_leaves_out_all_manoeuvres(name):
    scene = small_scene(name)
    alone = scene.rules._replace(drive_only=True)
    for state in some_states(name)[::3]:
        driven = {which for which in kernel_successors(scene.world, state, alone)}
        edges = {(action, reached) for action, reached, _ in scene.graph[state]}
        assert driven == {which for which in edges if which[0][0] in ("drive", "turn", "arc")}


@by_scene
def test_costs_of_states_and_poses_equal_the_twins(name):
    world, twin, _, start, _ = small_scene(name)
    rng, low = np.random.default_rng(1), world.tables.lowest
    bases = rng.integers(0, twin.shape, (60, 2)).tolist()
    some = [(*base, int(rng.integers(64)), *rng.integers(low, 2, 4).tolist()) for base in bases] + [start]
    expected = [twin.state_cost(state) for state in some]
    np.testing.assert_allclose(state_costs(world, pack_states(some, low)), expected, rtol=1e-6)
    assert state_cost(world, pack_states(start, low)[0]) == pytest.approx(expected[-1], rel=1e-6)
    for x, y, heading in [(*base, int(h)) for base, h in zip(bases, rng.integers(64, size=60), strict=True)]:
        neutral = (x, y, heading, 0, 0, 0, 0)
        assert stands_on_neutral(world, x, y, heading) == twin.valid(neutral)
        assert can_step_from_neutral(world, x, y, heading) == twin.any_foot_can_step(neutral)
        assert least_pose_cost(world, x, y, heading) == pytest.approx(
            naive_relaxed.least_pose_cost(twin, x, y, heading), rel=1e-6
        )


@by_scene
def test_a_banned_step_is_left_out_near_its_feet_alone(name):
    world, _, rules, _, graph = small_scene(name)
    rng, tested = np.random.default_rng(2), Counter()
    stepping = [state for state, edges in graph.items() if any(action[0] == "step" for action, _, _ in edges)]
    for state in stepping[:: len(stepping) // 8 + 1]:
        before = kernel_successors(world, state, rules)
        foot = next(action[1] for action, _ in before if action[0] == "step")
        row, feet = [foot, cell_under(world, state, foot), state[2]], state[3:]
        ahead = [feet[(foot + 1 + j) % 4] - feet[foot] for j in range(3)]
        for _ in range(6):
            off, tolerance = rng.integers(-2, 3, 3), int(rng.integers(0, 3))
            banned = [[*row, *(ahead + off), tolerance], [(foot + 1) % 4, *row[1:], *ahead, 9]]
            banned += [[row[0], row[1] + 1, row[2], *ahead, 9], [*row[:2], row[2] + 1, *ahead, 9]]
            near = bool((abs(off) <= tolerance).all())
            banned = np.array(banned)[rng.permutation(4)]
            found = kernel_successors(world._replace(banned=banned), state, rules)
            expected = {which: cost for which, cost in before.items() if not (near and which[0][:2] == ("step", foot))}
            assert found == expected
            offsets = (offset - world.tables.lowest for offset in feet)
            assert is_banned(banned, *row, *offsets) == near
            tested[near] += 1
    assert min(tested[True], tested[False]) > 3, tested


def cell_under(world, state, foot):
    """Flat cell under a foot."""
    t = world.tables
    row = (state[2] * 4 + foot) * t.n_offsets + state[3 + foot] - t.lowest
    return int(cell_index(world, state[0], state[1]) + t.feet[row * t.n_samples])


def test_no_state_has_more_successors_than_the_arrays_hold():
    most = max(len(edges) for name in SCENES for edges in small_scene(name).graph.values())
    assert most < MAX_SUCCESSORS


#: A long body sweeps other cells at the next heading.
LONG_BODY = {"boxes": [{"above": 0.1, "x_min": -0.2, "x_max": 0.225, "half_width": 0.025}]}
LONG = toy(body=LONG_BODY, drive={"sideways": False}, turn={"on_the_spot": False, "radius": 1.2})


@pytest.mark.parametrize(("pillar", "free"), [(10, -1), (-9, 1)])
def test_a_pillar_at_one_end_of_the_body_leaves_the_shift_to_the_other_end(pillar, free):
    heights, robot = np.zeros((27, 27), np.float32), toy(body=LONG_BODY, feet={"offset_max": 0.05})
    heights[13 + pillar, 13] = 0.5
    state = (13, 13, 0, 1, -1, -1, 1)
    found = kernel_successors(build_world(HeightMap(heights), robot), state)
    expected = {(action, reached): cost for action, reached, cost in Naive(heights, robot).successors(state)}
    assert found == pytest.approx(expected, rel=1e-6)
    assert [action[1] for action, _ in found if action[0] == "shift"] == [free]


def test_a_step_ahead_needs_no_other_direction():
    """Cells at which a foot can step in the first direction alone, heading 0."""
    heights, steps = np.zeros((20, 20), np.float32), 0
    heights[10:] = 0.1
    world, twin = build_world(HeightMap(heights), NIMBLE), Naive(heights, NIMBLE)
    ahead = world._replace(steps=world.steps & np.uint64(1))
    for offsets in product((-2, -1, 0, 1), repeat=4):
        if twin.valid(state := (8, 10, 0, *offsets)):
            expected = {action for action, _, _ in twin.successors(state) if action[0] == "step" and action[2] > 0}
            assert {action for action, _ in kernel_successors(ahead, state) if action[0] == "step"} == expected
            steps += len(expected)
    assert steps > 20


@cache
def among_spikes(name):
    """States on neutral feet on maps with thin spikes, and the twin's actions: [(world, state, actions)]."""
    robot = LONG if name == "long" else SCENES[name][0]
    found = []
    for seed in range(6 if name == "long" else 1):
        rng = np.random.default_rng(seed)
        heights = np.where(rng.random((22, 22)) < 0.03, np.float32(0.5), np.float32(0))
        world, twin = build_world(HeightMap(heights), robot), Naive(heights, robot)
        if seed == 0:  # what is known of other poses must not matter
            for x, y, heading in np.ndindex(*heights.shape, 64):
                look_at_body(world, heading, cell_index(world, x, y))
        found += [(world, state, list(twin.successors(state))) for state in valid_states(twin, rng, 16)]
    return found


@pytest.mark.parametrize("name", ["nimble", "ahead only", "short arcs", "long"])
def test_bodies_between_spikes_collide_where_the_twins_do(name):
    """Spikes stand so densely that a heading step or a cell decides about the body on the way."""
    kinds = Counter()
    for world, state, actions in among_spikes(name):
        expected = {(action, reached): cost for action, reached, cost in actions}
        assert kernel_successors(world, state) == pytest.approx(expected, rel=1e-6), state
        kinds.update(action[0] for action, _ in expected)
    assert kinds["drive"] > 20 and kinds["turn"] + kinds["arc"] > 10, kinds
