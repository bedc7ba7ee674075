"""The independent collision check: plans against blocks."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from hdsp.base.errors import InputError
from hdsp.detailed.actions.action import Action, ActionKind
from hdsp.planning.collisions import FOOT_RADIUS, check_plan
from hdsp.planning.planner import Planner
from hdsp.robot.robot import Robot
from hdsp.terrain.arenas import Arena
from hdsp.terrain.obstacles import Bank, Block, Ramp, Scene, Staircase, Tilted, TiltedGround

ROBOT = Robot.load("momaro")
FOOT_OUT = ROBOT.feet.neutral_y + FOOT_RADIUS  # lateral distance from the base to the outside of a foot


def drive(*poses, feet=(0.0, 0.0, 0.0, 0.0)):
    states = np.array([[*pose, *feet] for pose in poses])
    return SimpleNamespace(states=states, actions=(Action(ActionKind.DRIVE),) * (len(states) - 1))


def straight(length=1.0, y=0.0, heading=0.0):
    return drive(*[(2.0 + t * math.cos(heading), 2.0 + y + t * math.sin(heading), heading)
                   for t in np.arange(0, length + 1e-9, 0.1)])  # fmt: skip


def check(plan, *blocks, tolerance=0.0):
    return check_plan(Arena(6.0, Scene(blocks)), plan, ROBOT, tolerance)


def test_open_ground_is_free():
    result = check(straight())
    assert result.free and result.body_clearance == np.inf and result.foot_clearance == np.inf
    assert result.poses >= 100


@pytest.mark.parametrize("gap", [0.02, -0.02])
def test_a_foot_beside_a_block(gap):
    block = Block(2.5, 2.0 + FOOT_OUT + gap + 0.1, 0.0, 0.2, 0.2, 0.1)
    result = check(straight(), block)
    assert result.foot_clearance == pytest.approx(gap, abs=1e-6)
    assert result.free == (gap > 0)
    assert check(straight(), block, tolerance=0.025).free
    assert {collision.part for collision in result.collisions} <= {"front_left foot", "rear_left foot"}
    for collision in result.collisions:
        assert collision.depth == pytest.approx(0.02) and "0.10 m high" in collision.why


def test_between_two_states_is_checked_too():
    thin = Block(2.5, 2.25, 0.0, 0.01, 0.01, 0.1)  # the feet pass it in the middle of a long move
    assert not check(drive((2.0, 2.0, 0.0), (2.1, 2.0, 0.0), (2.2, 2.0, 0.0), (2.3, 2.0, 0.0)), thin).free


@pytest.mark.parametrize(("height", "free"), [(0.25, True), (0.35, False), (1.0, False)])
def test_what_stands_between_the_legs_must_be_low(height, free):
    result = check(straight(), Block(2.6, 2.0, 0.3, 0.1, 0.1, height))
    assert result.free == free
    assert all(collision.part == "body" for collision in result.collisions)


def test_the_body_beside_a_turned_wall():
    # A wall at 45 degrees, at a known distance from the front left corner of the base.
    corner = np.array([2.0 + 0.4375, 2.0 + 0.2875])
    for gap in (0.03, -0.03):
        middle = corner + (gap + 0.05) / math.sqrt(2)
        wall = Block(*middle, -math.pi / 4, 3.0, 0.1, 1.0)
        result = check(drive((2.0, 2.0, 0.0)), wall)
        assert result.body_clearance == pytest.approx(gap, abs=1e-6)
        assert any(collision.part == "body" for collision in result.collisions) == (gap < 0)


def test_low_blocks_may_be_driven_over_and_the_base_rises_with_the_feet():
    slab = Block(2.8, 2.0, 0.0, 2.4, 2.0, 0.04)
    assert check(straight(0.8), slab).free
    assert check(straight(0.8), slab, Block(2.6, 2.0, 0.0, 0.1, 0.1, 0.32)).free  # 0.28 m above the feet


def test_a_foot_may_not_hang_over_an_edge():
    step = Block(2.0, 2.0, 0.0, 0.65, 3.0, 0.2)  # ends 2.5 cm beyond the front feet
    result = check(drive((2.0, 2.0, 0.0)), step)
    assert any("drop" in collision.why for collision in result.collisions)
    assert check(drive((2.0, 2.0, 0.0)), Block(2.0, 2.0, 0.0, 0.75, 3.0, 0.2)).free


def test_ramps_may_be_driven_up_but_not_into_from_the_side():
    ramp = Ramp(2.9, 2.0, 0.0, 1.2, 1.0, 0.2)
    assert check(straight(1.0), ramp).free
    assert not check(straight(1.6, y=-1.0, heading=math.pi / 2), Ramp(2.4, 2.6, 0.0, 1.2, 1.0, 0.2)).free


def test_a_plan_up_stairs_is_free_and_the_same_without_steps_is_not():
    arena = Arena(4.0, Scene((Staircase(2.0, 2.0, 0.0, steps=1, rise=0.2, tread=0.3, width=2.0, depth=1.9),)))
    plan = Planner(arena.height_map()).plan((1.3, 2.0, 0.0), (2.8, 2.0, 0.0), weight=2.0)
    assert plan.solved and plan.steps
    assert check_plan(arena, plan, ROBOT).free
    through = SimpleNamespace(
        states=drive(*[(x, 2.0, 0.0) for x in np.arange(1.3, 2.8, 0.1)]).states,
        actions=(Action(ActionKind.DRIVE),) * 14,
    )
    assert not check_plan(arena, through, ROBOT).free


def test_plans_of_random_arenas_are_free():
    wall = Block(2.0, 1.2, math.pi / 2, 1.6, 0.1, 1.0)
    arena = Arena(4.0, Scene((wall, Block(1.2, 2.9, 0.5, 0.3, 0.3, 0.3), Block(3.2, 2.6, 0.9, 0.3, 0.2, 0.2))))
    plan = Planner(arena.height_map(), heuristic="manual").plan((1.0, 1.0, 0.0), (3.2, 1.0, 0.0), weight=1.5)
    assert plan.solved
    result = check_plan(arena, plan, ROBOT)
    assert result.free, result.collisions


@pytest.mark.parametrize(("height", "free"), [(0.25, True), (0.35, False)])
def test_on_a_slope_what_stands_between_the_legs_counts_from_the_slope(height, free):
    for ground in (TiltedGround(0.25, 0.0), TiltedGround(0.0, -0.25)):
        arena = Arena(6.0, Scene((Block(2.6, 2.0, 0.3, 0.1, 0.1, height),), ground))
        assert check_plan(arena, straight(), ROBOT, 0.0).free == free


def test_the_base_leans_no_more_than_the_steepest_slope():
    # The front feet stand on a platform. A plane through the feet would be steeper, and the base clear of the bar.
    platform = Block(2.825, 2.0, 0.0, 1.2, 2.0, 0.3)
    at = {"free": 0.63, "in the way": 0.70}
    for where, height in at.items():
        bar = Block(2.4, 2.0, 0.0, 0.02, 0.1, 0.15 + 0.4 * math.tan(ROBOT.slope.max_pitch) + height)
        hits = [hit for hit in check(drive((2.0, 2.0, 0.0)), platform, bar).collisions if hit.part == "body"]
        assert bool(hits) == (where == "in the way"), where


def test_gaps_agree_with_the_ground_under_the_body_point_by_point():
    rng = np.random.default_rng(0)
    found = {True: 0, False: 0}
    for _ in range(150):
        at = *(2.0 + rng.uniform(-0.5, 0.5, 2)), rng.uniform(-3, 3)
        size = *rng.uniform(0.1, 0.8, 2), rng.uniform(0.1, 0.7)
        block = (Block(*at, *size), Ramp(*at, *size), Tilted(*at, *size, *rng.uniform(-0.4, 0.4, 2)),
                 Bank(*at, *size, 0.5 * size[0]))[rng.integers(4)]  # fmt: skip
        ground = TiltedGround(*rng.uniform(-0.2, 0.2, 2))
        scene = Scene((block,), ground)
        pose = np.array([[2.0, 2.0, rng.uniform(-3, 3), *rng.uniform(-0.2, 0.2, 4)]])
        verdict = check_plan(Arena(6.0, scene), SimpleNamespace(states=pose, actions=()), ROBOT)
        feet = ROBOT.foot_positions(pose)[0]
        z, x = scene.heights_at(*feet.T).astype(float), ROBOT.neutral_feet()[:, 0] + pose[0, 3:]
        # The plane through four feet by least squares, if the feet stand on the tilted ground alone.
        if not np.allclose(z, ground.height(*feet.T), atol=1e-6):
            continue
        ahead, left, under = np.linalg.lstsq(np.stack([x, ROBOT.neutral_feet()[:, 1], np.ones(4)], axis=1), z)[0]
        hit = False
        for box in ROBOT.body.boxes:
            u, v = np.meshgrid(
                np.linspace(box.x_min, box.x_max, 200), np.linspace(-box.half_width, box.half_width, 120)
            )
            c, s = math.cos(pose[0, 2]), math.sin(pose[0, 2])
            heights = scene.heights_at(2.0 + c * u - s * v, 2.0 + s * u + c * v)
            hit |= bool((heights > under + ahead * u + left * v + box.above).any())
        if abs(verdict.body_clearance) > 0.012:
            assert hit == (verdict.body_clearance < 0), (block, pose)
            found[hit] += 1
    assert min(found.values()) > 20, found


def test_no_plan_and_jumps_are_refused():
    with pytest.raises(InputError, match="no states"):
        check(SimpleNamespace(states=np.empty((0, 7)), actions=[]))
    with pytest.raises(InputError, match=r"jumps by 1.00 m after state 0"):
        check(drive((2.0, 2.0, 0.0), (3.0, 2.0, 0.0)))
