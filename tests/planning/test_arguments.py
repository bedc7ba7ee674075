"""Arguments of queries: each wrong value ends in one line, before anything is computed."""

import copy
import math
import pickle

import numpy as np
import pytest

from hdsp import HeightMap, InputError, Planner, Status
from hdsp.abstract import ManualCosts
from hdsp.planning.heuristics import GeometricHeuristic

START, GOAL = (0.9, 0.9, 0.0), (1.6, 1.1, 0.3)
HUGE = 10**400  # larger than any float
NO_NUMBER = None, "2", True, 1j, [2.0, 3.0], math.nan, {}
WRONG = {
    "weight": (1e7, 1e39, *NO_NUMBER[1:], 0.5, math.inf, -1.0, HUGE),
    "anchor_weight": (1e39, *NO_NUMBER[1:], 0.5, math.inf, HUGE),
    "cost": (*NO_NUMBER, -1.0, -math.inf, -HUGE),
    "expansions": (*NO_NUMBER, 1.5, -1, math.inf),
    "memory": (*NO_NUMBER, 1.5, -1, math.inf),
    "time": (*NO_NUMBER, -0.1),
    "refinable": (None, "no", 1, 0.0),
    "progress": ("print", 3),
}


@pytest.fixture(scope="module")
def flat():
    return Planner(HeightMap.flat((100, 100)))


@pytest.fixture
def unused(flat, monkeypatch):
    """A planner whose query fails as soon as it computes anything."""
    monkeypatch.setattr(flat.heuristic, "set_goal", lambda goal: pytest.fail("computed before the check"))
    return flat


def one_line(error, *words):
    text = str(error.value)
    assert "\n" not in text and all(word in text for word in words), text


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in WRONG.items() for value in values])
def test_q6_wrong_arguments_are_named_with_their_value(unused, name, value):
    with pytest.raises(InputError) as error:
        unused.plan(START, GOAL, **{name: value})
    one_line(error, f"{name} is ", "it must be")
    if name not in ("weight", "anchor_weight"):
        with pytest.raises(InputError) as error:
            unused.improve(START, GOAL, **{name: value})
        one_line(error, f"{name} is ")


@pytest.mark.parametrize(
    "weights", [None, 3.0, "31", (), (3.0, "2"), (3.0, math.nan), (1.0, 2.0), (2.0, 2.0), [[3, 2]]]
)
def test_q6_wrong_weights_of_an_anytime_search_are_named(unused, weights):
    with pytest.raises(InputError) as error:
        unused.improve(START, GOAL, weights)
    one_line(error, "weights are empty" if weights == () else "weight")


def test_q6_numbers_of_other_libraries_and_limits_without_an_end_are_taken(flat):
    wanted = flat.plan(START, GOAL, 1.5)
    limits = {"cost": np.inf, "time": math.inf, "expansions": 1e6, "memory": np.int32(2**30)}
    assert flat.plan(np.float32(START), list(GOAL), np.float32(1.5), **limits).cost == wanted.cost
    limits = dict.fromkeys(("cost", "time", "expansions", "memory"), HUGE)
    assert flat.plan(START, GOAL, 1.5, polish=1e308, **limits).cost <= wanted.cost
    assert flat.plan(START, GOAL, time=0).status == Status.TIME_LIMIT
    assert flat.plan(START, GOAL, expansions=0).status == Status.EXPANSION_LIMIT


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        (("0.9", "0.9", "0"), "finite numbers"),
        ((True, 0.9, 0.0), "finite numbers"),
        ((0.9, 0.9, 1j), "finite numbers"),
        (np.ma.masked_invalid([0.9, math.nan, 0.0]), "finite numbers"),
        (np.array(0.9), "finite numbers"),
        (np.array(None), "finite numbers"),
        ((0.9, 0.9, np.array(None)), "finite numbers"),
        ((HUGE, 0.9, 0.0), "finite numbers"),
        (b"abc", "finite numbers"),
        ({"x": 0.9}, "finite numbers"),
        ((1e300, 0.9, 0.0), "outside the map"),
        ((90.0, 90.0, 0.0), "centimetres?"),
        ((900.0, 900.0, 0.0), "millimetres?"),
        ((0.9, 0.9, 90.0), "degrees? need radians, 90 degrees are 1.5708"),
        ((0.9, 0.9, -180), "degrees?"),
        ((0.9, 0.9, 0.3, 0.0, 0.0, math.sin(0.4), math.cos(0.4)), "here (0.9, 0.9, 0.8000)"),
        ((0.9, 0.9, 0.3, 0, 0, 0.71, 0.71), "a position with a quaternion"),
    ],
)
def test_q6_m18_poses_in_other_forms_are_refused_with_their_name(unused, pose, words):
    for ends, name in (((pose, GOAL), "start"), ((START, pose), "goal")):
        with pytest.raises(InputError) as error:
            unused.plan(*ends)
        one_line(error, name, words)
    with pytest.raises(InputError) as error:
        unused.valid(pose)
    one_line(error, "pose", words)


def test_poses_of_numpy_numbers_without_axes_are_poses(flat):
    start, goal = ([np.array(value) for value in pose] for pose in (START, GOAL))
    wanted = flat.plan(START, GOAL).cost
    assert flat.plan(start, goal).cost == flat.plan(START, [goal, GOAL]).cost == wanted
    assert flat.nearest(start).tolist() == flat.nearest(START).tolist()
    for wrong in (np.zeros((0, 3)), np.zeros((2, 2, 3))):
        with pytest.raises(InputError, match="goal"):
            flat.plan(START, wrong)


def test_positions_on_projected_maps_have_all_their_digits():
    planner = Planner(HeightMap.flat((80, 80), (412345.678, 5654321.123)))
    with pytest.raises(InputError) as error:
        planner.valid((412344.25, 5654322.125, 0.0))
    one_line(error, "position (412344.25, 5654322.125) m is outside", "x 412345.678 to 412347.678")
    with pytest.raises(InputError) as error:
        planner.valid((412346.678, 5654322.125, 0.3, 0.0, 0.0, math.sin(0.4), math.cos(0.4)))
    one_line(error, "here (412346.678, 5654322.125, 0.8000)")


def test_m18_a_pose_a_little_off_the_map_is_not_taken_for_centimetres(unused):
    with pytest.raises(InputError) as error:
        unused.valid((unused.terrain.size[0] + 1.0, 0.9, 0.0))
    one_line(error, "pose", "outside the map")
    assert "centimetres" not in str(error.value)


def test_m18_a_full_turn_and_feet_apart_are_poses(flat):
    assert flat.valid((0.9, 0.9, 2 * math.pi)) and flat.valid((0.9, 0.9, -2 * math.pi))
    assert flat.valid((0.9, 0.9, 0.0, 0.1, 0.1, 0.1, 0.1))
    assert not flat.valid((0.9, 0.9, 0.0, 1e300, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("margin", [None, "0.1", True, [0.1], math.inf])
def test_q6_a_wrong_margin_is_named(margin):
    with pytest.raises(InputError) as error:
        Planner(HeightMap.flat((80, 80)), margin=margin)
    one_line(error, "margin is ")


@pytest.mark.parametrize(
    "heuristic",
    [None, 3, ManualCosts, np.array(["manual", "manual"]), "Manual", "learned:", "os:getcwd", "json:dumps", "math:pi"],
)
def test_q6_a_wrong_heuristic_is_named(heuristic):
    with pytest.raises(InputError) as error:
        Planner(HeightMap.flat((80, 80)), heuristic=heuristic)
    one_line(error, "heuristic ")


@pytest.mark.parametrize("act", [copy.copy, pickle.dumps])
def test_a_planner_is_neither_copied_nor_pickled(flat, act):
    with pytest.raises(InputError) as error:
        act(flat)
    one_line(error, "a planner can be neither pickled nor copied")


def test_q6_a_heuristic_of_another_terrain_is_refused(flat):
    with pytest.raises(InputError) as error:
        Planner(HeightMap.flat((80, 80)), heuristic=GeometricHeuristic(flat.world))
    one_line(error, "another terrain")


@pytest.mark.parametrize(
    "region", [(0, 0, 9), (0, 0, 9.5, 9), ("0", 0, 9, 9), (5, 0, 2, 9), (0, 0, 101, 9), (0, 0, True, 9), 4, "abcd"]
)
def test_q6_a_wrong_region_is_named(flat, region):
    with pytest.raises(InputError) as error:
        flat.update(flat.terrain, region)
    one_line(error, "region ")
    for other in (HeightMap.flat((100, 99)), HeightMap(flat.terrain.heights, origin=(1.0, 0.0))):
        with pytest.raises(InputError) as error:
            flat.update(other, region)
        one_line(error, "region ")
    assert flat.terrain.shape == (100, 100)


def test_q6_an_update_takes_terrain_only(flat):
    for wrong in (None, 3, "nowhere.npz"):
        with pytest.raises(InputError) as error:
            flat.update(wrong)
        one_line(error)
