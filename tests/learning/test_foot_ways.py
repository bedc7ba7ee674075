"""Footholds at start and goal, and the steps between them, as features of the footprint network."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hdsp.base.errors import InputError
from hdsp.labels.rules import label_map
from hdsp.learning import LearnedAbstraction
from hdsp.learning.encoding import encode
from hdsp.learning.footprint_geometry import (
    FEET,
    FOOT_PLACE,
    FOOT_WAY,
    MANOEUVRE_FEATURES,
    OFFSET_UNIT,
    RELATIVE,
    STEP_COST_UNIT,
    WAY_FEATURES,
    FootprintOptions,
)
from hdsp.learning.networks import build_network
from hdsp.learning.networks.foot_ways import BLOCKED, FootWays
from hdsp.learning.networks.footprint import _cut
from hdsp.learning.task_data import mirror_goals, mirror_heights
from hdsp.learning.training import _begin_with
from hdsp.robot.lattice import PATCH_CENTER, RESOLUTION, cells, robot_frame_goals
from hdsp.robot.robot import Robot
from hdsp.terrain.scenes import random_map
from pipeline.config import configure
from tests.learning.test_zoo import model_file, rough_patches

GOALS = torch.from_numpy(robot_frame_goals(0))
AHEAD = [0, 8]


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(0)
    return build_network(model_file("footprint")).eval()


def features(network, heights, goals=GOALS):
    """Offsets in cells [B, 2, G, 4], heights and existence likewise, ways [B, G, 4, 4]."""
    encoded = encode(network.encoding, heights)
    ground = network._first(encoded)[1]
    x, y = (PATCH_CENTER - n for n in network.foot_ways.region)
    known = network.foot_ways.around(_cut(network.foot_ways.ground(ground, network._contact(encoded)), x, y))
    found = network.foot_ways(known, goals.expand(len(heights), -1, -1)).detach()
    places = found[..., : 2 * 4 * FOOT_PLACE].unflatten(-1, (2, 4, FOOT_PLACE)).movedim(-3, 1)
    ways = found[..., 2 * 4 * FOOT_PLACE : WAY_FEATURES - 1].unflatten(-1, (4, FOOT_WAY))
    return (places[..., 0] * OFFSET_UNIT).round(), places[..., 1], places[..., 2] > 0, ways


@pytest.fixture(scope="module")
def labelled():
    """Maps of the paper's kinds with their labels."""
    robot = Robot.load("momaro")
    maps = [
        random_map(7, category, k) for k in range(16) for category in ("cuboid_2", "staircase", "staircase_focused")
    ]
    pairs = [(terrain, label_map(terrain, robot)) for terrain in maps]
    kept = [(terrain.heights, tasks) for terrain, tasks in pairs if tasks is not None]
    assert len(kept) >= 8
    heights = torch.from_numpy(np.stack([heights for heights, _ in kept]))
    assert heights.shape[1:] == (72, 72)
    return heights[:, None], [tasks for _, tasks in kept]


def test_feet_stand_where_the_detailed_planner_puts_them(network, labelled):
    heights, tasks = labelled
    offsets, _, exists, _ = features(network, heights)
    start = torch.from_numpy(np.stack([found.start[3:] for found in tasks]) / RESOLUTION).round()
    goal = torch.from_numpy(np.stack([found.goal[..., 3:] for found in tasks]) / RESOLUTION).round()
    valid = torch.from_numpy(np.stack([found.feasible for found in tasks]))
    assert (offsets[:, 0, 0] == start).float().mean() > 0.97
    assert (start != 0).float().mean() > 0.05
    assert exists[:, 0, 0].all() and exists[:, 1][valid].all()
    assert (offsets[:, 1] == goal)[valid].float().mean() > 0.97


def test_a_task_with_too_long_or_high_a_step_is_infeasible(network, labelled):
    heights, tasks = labelled
    offsets, _, _, ways = features(network, heights)
    states = np.stack([np.stack([np.tile(found.start, (22, 1)), found.goal]) for found in tasks])
    same = (offsets == torch.from_numpy(states[..., 3:] / RESOLUTION).round()).all(-1).all(1)[:, AHEAD]
    ways = ways[:, AHEAD]
    feasible = torch.from_numpy(np.stack([found.feasible[AHEAD] for found in tasks]))
    never = (ways[..., 0] > 0).any(-1) & same
    assert never.sum() >= 3 and not (never & feasible).any()
    needed = (ways[..., 1] > 0).any(-1)
    assert (needed & feasible).sum() >= 3


@cache
def options() -> FootprintOptions:
    return configure(["model=footprint"]).model.checked_options()


def nearest_foothold(free, rough, neutral, reach, counted):
    """Foothold on a line as the detailed planner chooses it: the nearest one, of two the one on more even ground."""
    for distance in range(reach + 1):
        found = [x for x in (neutral - distance, neutral + distance) if 0 <= x < len(free) and free[x]]
        if found:
            known = [rough[x] if counted[0] <= x < counted[1] else 1e3 for x in found]
            return found[1] if len(found) > 1 and known[1] < known[0] - 1e-3 else found[0]
    return None


def steps_between(free, heights, begin, end, rules):
    """Whether a step is too far, the number of steps, and their cost, cell by cell."""
    far, count, cost, x = False, 0, 0.0, begin
    while x < end:
        beyond = x + 1
        while not free[beyond]:
            beyond += 1
        if beyond > x + 1:
            low, high = sorted((heights[x], heights[beyond]))
            rise, length = high - low, (beyond - x) * RESOLUTION
            over = max(*heights[x + 1 : beyond], high) - low
            far |= (
                length > rules.max_length + 1e-9 or rise > rules.max_height + 1e-5 or over > rules.max_clearance + 1e-5
            )
            count += 1
            cost += rules.cost + rules.cost_per_metre * min(length, 20 * RESOLUTION)
            cost += rules.cost_per_height * min(rise, 0.8)
        x = beyond
    return far, count, cost


@given(seed=st.integers(0, 10_000), barred=st.floats(0, 0.8))
def test_each_foot_alone_walks_as_in_the_textbook(seed, barred):
    ways = FootWays(replace(options(), foot_ways=replace(options().foot_ways, max_length=0.15)))
    x, y = ways.region
    random = np.random.default_rng(seed)
    rough = random.random((2 * x + 1, 2 * y + 1)).astype(np.float32)
    rough[np.repeat(random.random((2 * x + 1, 1)) < barred, 2 * y + 1, axis=1)] = BLOCKED
    height = np.repeat(random.integers(0, 9, (2 * x + 1, 1)) * np.float32(0.05), 2 * y + 1, axis=1)
    ground = torch.from_numpy(np.stack([rough, height])[None])
    found = ways(ways.around(ground), GOALS[None])[0]
    low, high = ways.rules.offsets
    assert low == -high
    foot_x, foot_y = ways.options.foot
    counted = x - foot_x - 9, x + foot_x + 10
    for goal in AHEAD:
        places = found[goal, : 2 * 4 * FOOT_PLACE].view(2, 4, FOOT_PLACE)
        for foot, (front, left) in enumerate(FEET):
            row = y + left * foot_y
            free, line = rough[:, row] < BLOCKED, height[:, row]
            stands = []
            for place, base in zip(places[:, foot], (x, x + round(float(GOALS[goal, 0])) * 4), strict=True):
                neutral = base + front * foot_x
                at = nearest_foothold(free, rough[:, row], neutral, high, counted)
                assert bool(place[2]) == (at is not None)
                if at is not None:
                    assert float(place[0]) * OFFSET_UNIT == pytest.approx(at - neutral, abs=1e-4)
                    assert float(place[1]) == pytest.approx(np.clip(line[at] - height[x, y], *RELATIVE), abs=1e-5)
                stands.append(at)
            way = found[goal, 2 * 4 * FOOT_PLACE :][foot * FOOT_WAY : (foot + 1) * FOOT_WAY].tolist()
            if None in stands:
                assert way == [0, 0, 0, 0]
            elif stands[1] < stands[0]:
                assert way == [float(not free[stands[1] : stands[0]].all()), 0, 0, 1]
            else:
                far, count, cost = steps_between(free, line, *stands, ways.rules)
                assert way == pytest.approx([float(far), count, cost / STEP_COST_UNIT, 0], abs=1e-4)


@given(seed=st.integers(0, 10_000), barred=st.floats(0, 0.5))
def test_manoeuvres_as_in_the_textbook(seed, barred):
    ways = FootWays(options())
    (x, y), rules = ways.region, ways.rules
    random = np.random.default_rng(seed)
    free = np.ones((2 * x + 1, 2 * y + 1), bool)
    for _ in range(round(12 * barred)):  # bars across the feet's lines
        i, j, long, wide = random.integers((0, 0, 1, 3), (2 * x, 2 * y, 6, 25))
        free[i : i + long, j : j + wide] = False
    height = np.cumsum(random.random(2 * x + 1) < 0.1).astype(np.float32)[:, None] * np.float32(0.05) + 0 * free
    ground = torch.from_numpy(np.stack([np.where(free, 0, BLOCKED), height])[None].astype(np.float32))
    found = ways(ways.around(ground), GOALS[None])[0]
    assert found.shape[-1] == WAY_FEATURES + MANOEUVRE_FEATURES == options().way_features
    feet = np.array(FEET) * ways.options.foot
    for goal, action in enumerate(GOALS.numpy()):
        places = found[goal, : 2 * 4 * FOOT_PLACE].view(2, 4, FOOT_PLACE)
        offsets = (places[..., 0] * OFFSET_UNIT).round().long().numpy()
        stands = places[..., 2].bool().all(-1).tolist()
        at = np.rint(action[:2] * 4).astype(int)
        away = manoeuvre(free, height, feet, (0, 0), offsets[0], 1, rules) if stands[0] else None
        to = manoeuvre(free, height, feet, at, offsets[1], -1, rules) if stands[1] and not action[2] else None
        expected = [*(of_manoeuvre(away)), *(of_manoeuvre(to)), 0, 0, 0]
        if away and to:
            begin, far = away[2], at[0] - to[2] - away[2]
            poses = [(begin + np.rint(far * k / 8), np.rint(at[1] * k / 8)) for k in range(9)]
            barred = np.mean([not stands_neutral(free, feet, *map(int, pose)) for pose in poses])
            expected[-3:] = barred, far / OFFSET_UNIT, at[1] / OFFSET_UNIT
        assert found[goal, WAY_FEATURES:].tolist() == pytest.approx(expected, abs=1e-4)


def stands_neutral(free, feet, base_x, base_y):
    """Whether all neutral feet have footholds."""
    x, y = (n // 2 for n in free.shape)
    cells = [(x + i + base_x, y + j + base_y) for i, j in feet]
    return all(0 <= i < free.shape[0] and 0 <= j < free.shape[1] and free[i, j] for i, j in cells)


def manoeuvre(free, height, feet, base, offsets, sign, rules):
    """Number of steps, their cost, and distance of the nearest base on neutral feet that the feet reach, or None."""
    x, y = (n // 2 for n in free.shape)
    for shift in range(rules.offsets[1] + 1):
        other = base[0] + sign * shift
        if not stands_neutral(free, feet, other, base[1]):
            continue
        steps, cost, possible = 0, 0.0, True
        for (foot_x, foot_y), offset in zip(feet, offsets, strict=True):
            line, own, neutral = y + base[1] + foot_y, x + base[0] + foot_x + offset, x + other + foot_x
            begin, end = (own, neutral) if sign > 0 else (neutral, own)
            if end < begin:  # feet roll back only on the way to their neutral position
                possible &= sign > 0 and bool(free[end:begin, line].all())
                continue
            far, count, price = steps_between(free[:, line], height[:, line], begin, end, rules)
            steps, cost, possible = steps + count, cost + price, possible and not far
        if possible:
            return steps, cost, shift
    return None


def of_manoeuvre(found):
    """Features of a manoeuvre."""
    if found is None:
        return [0, 0, 0, 0]
    steps, cost, shift = found
    return [1, steps, cost / STEP_COST_UNIT, shift / OFFSET_UNIT]


def test_the_left_feet_on_a_mirrored_map_are_the_right_feet(network):
    heights = torch.from_numpy(rough_patches(4))[:, None]
    mirrored = features(network, mirror_heights(heights), mirror_goals(GOALS))
    feet = [3, 2, 1, 0]
    *places, ways = features(network, heights)
    # Two footholds at one distance may be equal but for the last bit.
    for found, other in zip(places, mirrored, strict=False):
        assert (found == other[..., feet]).float().mean() > 0.97
    assert (ways == mirrored[-1][..., feet, :]).float().mean() > 0.97


@pytest.mark.parametrize("former_ways", ["none", "manoeuvres unknown", "no manoeuvres"])
def test_a_network_may_begin_with_weights_of_one_that_sees_less_of_the_feet(former_ways, tmp_path):
    settings = model_file("footprint")
    ways = dict(settings["options"]["foot_ways"])
    known = {"none": None, "no manoeuvres": ways | {"manoeuvres": False}}
    ways.pop("manoeuvres")
    former = {**settings, "options": {**settings["options"], "foot_ways": known.get(former_ways, ways)}}
    torch.manual_seed(1)
    first = build_network(former)
    saved = LearnedAbstraction(first, _settings(former)).save_pretrained(tmp_path / "model", picture=False)
    network = build_network(settings)
    _begin_with(network, saved, _settings(settings))
    heights = torch.from_numpy(rough_patches(3))[:, None]
    with torch.no_grad():
        for found, expected in zip(*(n(heights, GOALS.expand(3, -1, -1)) for n in (network, first)), strict=True):
            torch.testing.assert_close(found, expected, atol=1e-6, rtol=1e-5)
    with_ways = LearnedAbstraction(network, _settings(settings)).save_pretrained(tmp_path / "ways", picture=False)
    lower = {**settings["options"]["foot_ways"], "max_height": 0.2}
    for folder, change in (
        (saved, {"hidden": 64}),
        (with_ways, {"foot_ways": None}),
        (with_ways, {"steps": 32}),
        (with_ways, {"foot_ways": lower}),
    ):
        other = {**settings, "options": {**settings["options"], **change}}
        with pytest.raises(InputError, match="holds a footprint"):
            _begin_with(build_network(other), folder, _settings(other))


def _settings(values):
    from hdsp.base.settings import load_settings
    from hdsp.learning.networks import ModelSettings

    return load_settings(ModelSettings, values, "model")


@pytest.mark.parametrize(
    ("change", "message"),
    [({"foot_ways": {"reach": [0.1, 0.3]}}, "reach"), ({"stance": None}, "foot_ways")],
)
def test_wrong_options_are_named(change, message):
    given = model_file("footprint")["options"]
    ways = {**given["foot_ways"], **change.get("foot_ways", {})}
    with pytest.raises(InputError, match=message):
        build_network({**model_file("footprint"), "options": {**given, **change, "foot_ways": ways}})


def test_offsets_are_those_of_the_robot():
    ways = options().foot_ways
    robot = Robot.load("momaro")
    assert ways.offsets == tuple(round(cells(reach)) for reach in (robot.feet.offset_min, robot.feet.offset_max))
    assert ways.longest == 15
