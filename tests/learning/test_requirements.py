"""A robot's requirements for the ground, against the detailed planner's maps and plain loops."""

import math

import numpy as np
import pytest
import torch

from hdsp.base.errors import InputError
from hdsp.learning.encoding import encode
from hdsp.learning.footprint_geometry import FEET, MOST, NEAR_RADIUS, POSE_FEATURES, POSES, REACH, SHARPNESS
from hdsp.learning.networks import build_network
from hdsp.robot.lattice import PATCH_CENTER, RESOLUTION
from hdsp.robot.robot import Robot
from hdsp.terrain.cost_maps import cost_maps
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import TerrainSettings, random_map
from tests.learning.test_zoo import model_file

ROBOT = Robot.load("momaro")
FIRST = PATCH_CENTER - REACH


@pytest.fixture(scope="module")
def network():
    return build_network(model_file("footprint")).eval()


@pytest.fixture(scope="module", params=["cuboid_2", "wall_1", "staircase"])
def patch(request):
    heights = random_map(5, request.param, 1, TerrainSettings()).heights.copy()
    heights[20:22, 44] = np.nan
    return heights


@pytest.fixture(scope="module")
def straight(network, patch):
    """Features [REQUIREMENT_FEATURES, POSES, POSES] for poses with heading 0."""
    ground = network._first(encode(network.encoding, torch.from_numpy(patch)[None, None]))[1]
    return network._required(ground, [FIRST - NEAR_RADIUS] * 2, (POSES, POSES))[0].numpy()


def feet_cells(x, y, inward=0.0, heading=0.0):
    cos, sin = math.cos(heading), math.sin(heading)
    at = [(i * (ROBOT.feet.neutral_x - inward), j * (ROBOT.feet.neutral_y - inward)) for i, j in FEET]
    turned = np.array([(cos * a - sin * b, sin * a + cos * b) for a, b in at]) / RESOLUTION
    return tuple((np.rint(np.round(turned, 9)).astype(int) + (x, y)).T)


def shares(patch, x, y, heading=0.0):
    """Height spread of the feet, whether each foot stands, and the largest rise in the boxes, by plain loops."""
    feet = patch[feet_cells(x, y, heading=heading)]
    level = (np.nanmax(feet) - np.nanmin(feet)) / ROBOT.drive.level
    standable = cost_maps(HeightMap(patch), ROBOT).standable[feet_cells(x, y, heading=heading)]
    under, rise = np.fmin(patch[x, y], feet.mean()), 0.0
    for box in ROBOT.body.boxes:
        for i in range(-20, 21):
            for j in range(-20, 21):
                inside = box.x_min <= i * RESOLUTION <= box.x_max and abs(j * RESOLUTION) <= box.half_width
                if inside and patch[x + i, y + j] - under > rise * box.above:
                    rise = (patch[x + i, y + j] - under) / box.above
    return level, standable, rise


def test_shares_are_those_of_the_robot_and_the_ground(patch, straight):
    facts = straight[-POSE_FEATURES:]
    for x in range(0, POSES, 3):
        for y in range(0, POSES, 3):
            level, standable, rise = shares(patch, FIRST + x, FIRST + y)
            seen = facts[:, x, y]
            assert seen[0] == pytest.approx(min(level, MOST), abs=1e-4)
            assert (seen[3] > 1) == (not standable.all())
            # A box extends at most half a cell beyond the squares that cover it.
            assert seen[6] == pytest.approx(min(rise, MOST), abs=1e-4)
            for first in (0, 3, 6):
                soft = [1 / (1 + math.exp(min((1 - seen[first]) / width, 50))) for width in SHARPNESS]
                if seen[first] < MOST:
                    np.testing.assert_allclose(seen[first + 1 : first + 3], soft, atol=2e-3)


def test_each_foot_is_barred_where_it_cannot_stand(patch, straight):
    standable = cost_maps(HeightMap(patch), ROBOT).standable
    for x in range(0, POSES, 2):
        for y in range(0, POSES, 2):
            cells = feet_cells(FIRST + x, FIRST + y)
            assert ((straight[4:8, x, y] > 0.5) == ~standable[cells]).all()
            base = patch[FIRST + x, FIRST + y]
            expected = np.nan_to_num(patch[cells] - base, nan=0.0).clip(-0.5, 0.8)
            np.testing.assert_allclose(straight[:4, x, y], expected, atol=1e-5)


def test_the_price_is_what_driving_costs_more_on_uneven_ground(patch, straight):
    uneven = cost_maps(HeightMap(patch), ROBOT).unevenness
    for x in range(0, POSES, 3):
        for y in range(0, POSES, 3):
            under = uneven[feet_cells(FIRST + x, FIRST + y, inward=ROBOT.feet.contact_inward)]
            price = ROBOT.drive.unevenness_cost * (under.max() + under.sum())
            assert straight[-1, x, y] == pytest.approx(min(price, MOST), rel=1e-3, abs=1e-4)


def test_turned_poses_see_the_ground_under_turned_feet(network, patch):
    ground = network._first(encode(network.encoding, torch.from_numpy(patch)[None, None]))[1]
    centre = torch.tensor([[PATCH_CENTER - NEAR_RADIUS] * 2])
    turned = network.requirements.turned(ground, centre)[0, 0].numpy()
    for seen, heading in zip(turned, network.turns.tolist(), strict=True):
        level, standable, _ = shares(patch, PATCH_CENTER, PATCH_CENTER, heading)
        assert seen[-POSE_FEATURES] == pytest.approx(min(level, MOST), abs=1e-4)
        assert ((seen[4:8] > 0.5) == ~standable).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"level": 0.0}, "level"),
        ({"neutral": [0.0, 0.2]}, "neutral"),
        ({"neutral": [0.7, 0.2]}, "cells far"),
        ({"boxes": [{"above": 0.3}]}, "boxes"),
    ],
)
def test_wrong_values_are_named(change, message):
    model = model_file("footprint")
    model["options"]["stance"] |= change
    with pytest.raises(InputError, match=message):
        build_network(model)


def test_its_channels_are_asked_for():
    model = model_file("footprint")
    model["encoding"]["channels"] = ["height", "edge", "unknown"]
    with pytest.raises(InputError, match="unevenness"):
        build_network(model)
