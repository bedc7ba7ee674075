"""Causes of failures (M17, Q2): each kind is named where it is, and an independent check of the map bears it out."""

import math
import re
import time
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from hdsp import HeightMap, Planner
from hdsp.detailed.causes import Cause, Kind, gap
from hdsp.detailed.causes.gap import _resistance
from hdsp.detailed.causes.state_faults import cell_under, flat_index
from hdsp.detailed.relaxed.proofs import POSE, body_hits
from hdsp.detailed.search.outcome import Status
from hdsp.robot.robot import Robot
from tests.planning.cause_check import complaints, gap_complaints

MOMARO = Robot.load("momaro")
START, GOAL = (0.8, 1.5, 0.0), (2.6, 1.5, 0.0)
X, Y = np.mgrid[:136, :120] * 0.025 + 0.0125  # m


def ground(where, height):
    """3.4 x 3 m of flat ground with another height, m or NaN, at some cells."""
    return np.where(where, height, 0.0).astype(np.float32)


def planner_on(heights, **options):
    return Planner(HeightMap(heights), conditioning=None, **options)


def ring(centre):
    away = np.hypot(X - centre[0], Y - centre[1])
    return (away > 0.65) & (away < 0.85)


RAMP = np.clip((X - 1.4) * math.tan(math.radians(30)), 0, 0.4)
DOOR = (abs(X - 1.7) < 0.05) & (abs(Y - 1.5) > 0.3)

#: Ground, kinds that have to be among the causes, kinds that must not, a test of a place.
GROUNDS = {
    "wall": (ground(abs(X - 1.7) < 0.05, 1.0), {Kind.EDGE}, {Kind.UNKNOWN}, lambda x, y: abs(x - 1.7) < 0.1),
    "unknown stripe": (
        ground(abs(X - 1.7) < 0.2, np.nan), {Kind.UNKNOWN}, {Kind.EDGE}, lambda x, y: abs(x - 1.7) < 0.2,
    ),
    "unknown ring at the start": (
        ground(ring(START), np.nan), {Kind.UNKNOWN}, {Kind.EDGE}, lambda x, y: ring_holds(START, x, y),
    ),
    "unknown ring at the goal": (
        ground(ring(GOAL), np.nan), {Kind.UNKNOWN}, {Kind.EDGE}, lambda x, y: ring_holds(GOAL, x, y),
    ),
    "ditch": (ground(abs(X - 1.7) < 0.3, -0.8), {Kind.EDGE}, {Kind.UNKNOWN}, lambda x, y: abs(x - 1.7) < 0.35),
    "steep ramp": (RAMP.astype(np.float32), {Kind.SLOPE}, {Kind.EDGE, Kind.UNKNOWN}, lambda x, y: 1.3 < x < 2.2),
    "high step": (ground(X > 1.7, 0.45), {Kind.EDGE}, {Kind.UNKNOWN}, lambda x, y: abs(x - 1.7) < 0.05),
    "goal on a platform": (
        ground((abs(X - 2.6) < 0.5) & (abs(Y - 1.5) < 0.5), 0.6), {Kind.EDGE}, {Kind.UNKNOWN},
        lambda x, y: max(abs(x - 2.6), abs(y - 1.5)) < 0.55,
    ),
    "narrow door": (ground(DOOR, 1.0), {Kind.BODY}, {Kind.UNKNOWN}, lambda x, y: abs(x - 1.7) < 0.1),
    "block under the body": (
        np.where(abs(Y - 1.5) > 0.5, np.nan, ground((abs(X - 1.7) < 0.3) & (abs(Y - 1.5) < 0.08), 0.4)),
        {Kind.BODY}, {Kind.UNKNOWN}, lambda x, y: abs(x - 1.7) < 0.3 and abs(y - 1.5) < 0.1,
    ),
}  # fmt: skip


def ring_holds(centre, x, y):
    return 0.6 < math.hypot(x - centre[0], y - centre[1]) < 0.9


def checked(plan):
    """The causes of a plan without a path, all borne out by its map."""
    found = [words for cause in plan.causes for words in complaints(cause, plan.terrain, plan.robot)]
    if not plan.problems and plan.findings.gap is not None:
        found += gap_complaints(plan.findings.gap)
    assert not found, found
    return plan.causes


@pytest.mark.parametrize("name", GROUNDS)
def test_q2_each_kind_of_obstacle_is_named_at_its_place(name):
    heights, kinds, others, is_there = GROUNDS[name]
    plan = planner_on(heights, heuristic="manual").plan(START, GOAL, weight=2)
    causes = checked(plan)
    named = {cause.kind for cause in causes}
    assert plan.status == Status.INFEASIBLE and kinds <= named and not others & named, plan.explain()
    assert all(is_there(*cause.place) for cause in causes if cause.kind in kinds), plan.explain()
    assert plan.nearest is not None and 0 < plan.nearest.distance <= math.dist(START[:2], GOAL[:2])
    labels = plan.show().axes[0].get_legend_handles_labels()[1]
    assert all(any(cause.label in label for label in labels) for cause in causes), labels
    assert Planner(plan.terrain, conditioning=None).plan(START, plan.nearest.pose, weight=2).solved


def test_q2_where_only_the_heading_is_out_of_reach_the_robot_cannot_turn_there():
    # The robot drives into a bay. Its body, longer than wide, fits along and across, and its corners have no room.
    plan = turned_plan(math.pi / 2)
    causes = checked(plan)
    assert plan.status == Status.INFEASIBLE, plan.explain()
    assert causes[0].kind == Kind.HEADING and causes[0].amount == pytest.approx(math.pi / 2, abs=1e-6)
    assert len(causes) > 1 and plan.findings.gap.turns, plan.explain()
    assert plan.nearest.distance < 0.1 and plan.nearest.turn > 0.5
    assert "with a goal tolerance of" in plan.explain() and plan.limits is None


def turned_plan(heading, **options):
    """A plan to a heading that the robot cannot turn to, in a bay with room for its body along and across."""
    heights = np.ones_like(X, dtype=np.float32)
    heights[X < 1.3] = 0
    heights[(abs(Y - 1.5) < 0.4) & (X < 2.88)] = 0
    heights[(abs(Y - 1.5) < 0.48) & (abs(X - 2.45) < 0.43)] = 0
    return planner_on(heights).plan((0.7, 1.5, 0.0), (2.4, 1.5, heading), weight=2, **options)


@pytest.mark.parametrize("heading", [1.52, math.pi / 2, 1.61])
def test_an_advised_tolerance_has_a_plan_for_headings_between_those_of_the_lattice(heading):
    words = turned_plan(heading).explain()
    metres, degrees = re.search(r"a goal tolerance of ([\d.]+) m and (\d+) degrees there is a plan", words).groups()
    assert turned_plan(heading, tolerance=(float(metres), math.radians(int(degrees)))).solved


@pytest.mark.parametrize("heading", [None, 0.0, 0.03])
def test_a_pose_in_reach_but_not_on_the_given_feet_is_said_so(heading):
    planner, pose = planner_on(np.zeros_like(X, dtype=np.float32), heuristic="manual"), (2.0, 1.5, heading)
    plan = planner.plan(START, (*pose, 0.1, 0.1, 0.1, 0.1))
    words = plan.explain()
    assert "the robot gets to the pose, but not onto these feet; without foot offsets there is a plan" in words
    assert plan.limits is None and "tolerance" not in words and planner.plan(START, pose).solved


def test_the_nearest_pose_counts_from_the_goal_as_asked_and_no_tolerance_adds_to_it():
    planner = planner_on(ground(abs(X - 1.7) < 0.05, 1.0), heuristic="manual")
    plans = [planner.plan(START, (*GOAL[:2], heading), tolerance=t, weight=2) for heading, t in
             ((0.0, None), (None, None), (0.0, (0.3, 0.5)))]  # fmt: skip
    away = [math.dist(plan.nearest.pose[:2], GOAL[:2]) for plan in plans]
    assert [plan.nearest.distance for plan in plans] == pytest.approx(away, abs=0.02) and plans[1].nearest.turn == 0


def test_an_obstacle_before_an_undecided_search_is_not_called_the_end_of_all_ways():
    planner = planner_on(ground(X > 1.7, 0.15), heuristic="manual")
    words = planner.plan(START, GOAL, expansions=100).explain()
    assert "stopped after 100 expansions" in words and "an obstacle stops driving from" in words
    assert "the robot cannot get" not in words and planner.plan(START, GOAL, weight=2).solved
    assert "stopped after 1 expansion;" in planner.plan(START, GOAL, expansions=1).explain()


def test_a_proved_obstacle_is_named_also_where_the_time_ends_before_the_reasons():
    heights = ground((abs(X - 1.7) < 0.06) & (abs(Y - 1.5) > 0.3), 1.0)
    plan = planner_on(heights, heuristic="manual").plan(START, GOAL, weight=2)
    assert plan.status == Status.INFEASIBLE and plan.inquiry.proof.proof == POSE
    late = replace(plan, inquiry=replace(plan.inquiry, seconds=0.0))
    assert checked(late) and late.findings.gap is not None
    assert {cause.kind for cause in late.causes} == {Kind.BODY}
    assert late.explain().endswith("; the reasons take longer than the time limit")


def test_the_longest_step_of_the_reasons_needs_no_second_time_of_its_length(monkeypatch):
    plan = planner_on(ground(DOOR, 1.0), heuristic="manual").plan(START, GOAL, weight=2)
    assert plan.causes
    quick = gap._way_of_least_resistance

    def slow(*arguments):
        time.sleep(max(1.0, 2 * plan.findings.seconds))
        return quick(*arguments)

    monkeypatch.setattr(gap, "_way_of_least_resistance", slow)
    seconds = 1.5 * max(1.0, 2 * plan.findings.seconds)
    again = replace(plan, inquiry=replace(plan.inquiry, seconds=seconds))
    assert again.causes == plan.causes and "longer than the time" not in again.explain()


def test_m17_one_unknown_cell_beside_a_foot_is_unknown_ground_not_an_edge():
    heights = np.zeros_like(X, dtype=np.float32)
    planner = planner_on(heights)
    foot = MOMARO.foot_positions(np.array([*START, 0, 0, 0, 0]))[0]
    cell = planner.grid.cell(foot + (0.0, 0.075))
    heights[tuple(cell)] = np.nan
    plan = planner_on(heights).plan((*START, 0, 0, 0, 0), GOAL, start_free=False)
    (cause,) = checked(plan)
    assert plan.status == Status.INVALID_START and cause.kind == Kind.UNKNOWN and cause.foot == "front_left"
    assert cause.place == pytest.approx(planner.grid.center(cell)) and "edge" not in plan.explain()
    # On feet that avoid the cell, the robot stands there, and can go nowhere.
    stuck = planner_on(heights).plan(START, GOAL, start_free=False)
    assert stuck.status == Status.INFEASIBLE and {each.kind for each in checked(stuck)} == {Kind.UNKNOWN}
    assert Planner(HeightMap(heights)).plan(START, GOAL, weight=2).solved


@pytest.mark.parametrize(
    ("pose", "kind"), [((0.2, 1.5, 0.0), Kind.BORDER), ((1.7, 1.5, 0.0), Kind.EDGE), ((1.7, 0.9, 0.0), Kind.BODY)]
)
def test_q2_an_invalid_goal_is_explained_at_its_place(pose, kind):
    heights = ground((abs(X - 1.7) < 0.06) & (abs(Y - 0.9) < 0.05), 0.9)
    heights[(abs(X - 1.7) < 0.6) & (abs(Y - 1.5) < 0.3)] = 0.2
    heights[60:72, 50:54] = 0.9
    plan = planner_on(heights).plan((2.6, 2.3, 0.0), (*pose, 0, 0, 0, 0))
    assert plan.status == Status.INVALID_GOAL and kind in {cause.kind for cause in checked(plan)}, plan.explain()


def test_q2_an_undecided_search_tells_how_far_it_came():
    plan = planner_on(ground(abs(X - 1.7) < 0.05, 1.0)).plan(START, GOAL, expansions=2000)
    assert plan.status == Status.EXPANSION_LIMIT
    checked(plan)
    assert 0 < plan.nearest.distance < math.dist(START[:2], GOAL[:2])
    assert str(plan.nearest) in plan.explain()
    free = planner_on(np.zeros_like(X, dtype=np.float32)).plan(START, GOAL, expansions=5)
    assert free.status == Status.EXPANSION_LIMIT and free.causes == () and free.nearest is not None


def test_q2_advice_is_given_for_a_small_hole_for_a_near_pose_and_for_a_margin():
    heights = ground((abs(X - 1.7) < 0.05) & (abs(Y - 1.5) > 0.42), 1.0)
    assert planner_on(heights).plan(START, GOAL, weight=2).solved
    plan = planner_on(heights, margin=0.15).plan(START, GOAL, weight=2)
    assert "without the margin" in " ".join(plan.findings.advice), plan.explain()
    heights = ground((X > 2.0) & (X < 2.06), np.nan)
    plan = planner_on(heights).plan(START, GOAL, weight=2)
    assert ("known ground" in plan.explain()) == Planner(HeightMap(heights)).plan(START, GOAL, weight=2).solved
    heights = ground((abs(X - 1.7) < 0.05) & (abs(Y - 0.9) < 0.3), np.nan)
    heights[abs(Y - 0.9) > 0.45] = 1.0
    start, goal = (0.8, 0.9, 0.0), (2.6, 0.9, 0.0)
    plan = planner_on(heights).plan(start, goal, weight=2)
    assert ("known ground" in plan.explain()) == Planner(HeightMap(heights)).plan(start, goal, weight=2).solved


def random_ground(rng):
    heights = np.zeros((110, 90), np.float32)
    for _ in range(rng.integers(2, 7)):
        x, y, long, wide = rng.integers(0, 110), rng.integers(0, 90), rng.integers(2, 60), rng.integers(2, 60)
        heights[x : x + long, y : y + wide] = rng.choice([np.nan, -0.6, 0.08, 0.2, 0.5, 1.0])
    if rng.random() < 0.3:
        heights += np.clip(np.arange(110) - 50, 0, None)[:, None] * 0.025 * math.tan(rng.uniform(0.1, 0.6))
    heights[rng.random(heights.shape) < rng.choice([0, 0.002])] = np.nan
    return HeightMap(heights, origin=(-1.3, 2.05))


@pytest.mark.parametrize("seed", range(3))
def test_q2_on_random_maps_every_cause_is_there_and_no_gap_has_equal_ends(seed):
    rng, named = np.random.default_rng(seed), 0
    for _ in range(4):
        terrain = random_ground(rng)
        planner = Planner(terrain, conditioning=None)
        poses = [(*rng.uniform((-1.2, 2.1), (1.4, 4.2)), rng.uniform(-3, 3)) for _ in range(12)]
        valid = [pose for pose in poses if planner.valid(pose)]
        pairs = [*pairwise(valid[:3]), *((pose, pose) for pose in poses if pose not in valid)][:4]
        for start, goal in pairs:
            plan = planner.plan(start, goal, weight=3, expansions=60_000, start_free=False)
            if plan.solved:
                continue
            causes = checked(plan)
            named += len(causes)
            assert causes or plan.status != Status.INFEASIBLE, plan.explain()
    assert named > 3


def test_the_resistance_of_poses_equals_its_plain_twin():
    rng = np.random.default_rng(3)
    terrain = random_ground(rng)
    planner = Planner(terrain, conditioning=None)
    world = planner.world
    away = rng.random(len(world.standable)).astype(np.float32)
    shift, headings = np.array([1, 2]), np.array([0, 9, 40])
    found = _resistance(world, away, shift, 9, headings)
    for i, j, k in np.ndindex(found.shape):
        state = np.array([*(shift + 9 * np.array([i, j])), headings[k], 0, 0, 0, 0])
        feet = [flat_index(world, cell_under(world, state, foot)) for foot in range(4)]
        under = world.height[[*feet, flat_index(world, state[:2])]]
        blocked = bool(np.isinf(under).any()) or len(body_hits(world, state)) > 0
        assert found[i, j, k] == pytest.approx(2.0 * away[feet].sum() + 10.0 * blocked, rel=1e-5), state


def test_a_cause_is_a_value_with_words():
    cause = Cause(Kind.EDGE, (1.0, 2.0), 0.153, 0.05, "rear_left", (1.1, 2.0))
    assert cause == Cause(Kind.EDGE, (1.0, 2.0), 0.153, 0.05, "rear_left", (1.1, 2.0))
    assert (
        str(cause)
        == "the rear_left foot cannot stand at (1.10, 2.00) m: an edge of 15.3 cm (wheels pass 5 cm) at (1.00, 2.00) m"
    )
    assert "an edge of 15000 cm" in str(replace(cause, amount=150.0))  # heights in millimetres
