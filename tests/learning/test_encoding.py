"""Heights as input of a network."""

import math

import numpy as np
import pytest
import torch

from hdsp.base.errors import InputError
from hdsp.base.settings import load_settings
from hdsp.learning.encoding import encode, greatest_difference
from hdsp.learning.learning_settings import HeightEncoding
from hdsp.robot.lattice import cells
from hdsp.robot.robot import Robot
from hdsp.terrain.cost_maps import cost_maps
from hdsp.terrain.height_map import HeightMap


def patch(value=0.0):
    return torch.full((1, 1, 72, 72), value)


def test_heights_pass_unchanged_by_default_within_the_clip():
    heights = torch.rand(2, 1, 72, 72)
    torch.testing.assert_close(encode(HeightEncoding(), heights), heights)


def test_unknown_cells_become_the_configured_height_after_the_reference():
    heights = patch(0.5)
    heights[..., 3, 4] = math.nan
    encoded = encode(HeightEncoding(reference="base", unknown=0.7, scale=2.0), heights)
    assert encoded[0, 0, 3, 4] == pytest.approx(1.4)
    assert encoded[0, 0, 36, 36] == 0


def test_the_base_cell_is_the_reference():
    heights = patch(0.0)
    heights[..., 36, 36] = 0.25
    encoded = encode(HeightEncoding(reference="base"), heights)
    assert encoded[0, 0, 36, 36] == 0
    assert encoded[0, 0, 0, 0] == pytest.approx(-0.25)


def test_lifting_the_whole_map_changes_nothing_with_the_base_as_reference():
    heights = torch.rand(2, 1, 72, 72)
    encoding = HeightEncoding(reference="base", channels=("height", "edge"))
    torch.testing.assert_close(encode(encoding, heights + 0.3), encode(encoding, heights), atol=1e-6, rtol=0)


def test_an_unknown_base_cell_leaves_the_other_heights_as_they_are():
    heights = patch(0.5)
    heights[..., 36, 36] = math.nan
    encoded = encode(HeightEncoding(reference="base", unknown=1.0), heights)
    assert encoded[0, 0, 0, 0] == 0.5
    assert encoded[0, 0, 36, 36] == 1.0


def test_edges_are_the_greatest_difference_to_the_eight_neighbours():
    heights = torch.rand(1, 1, 9, 8)
    result = greatest_difference(heights)[0, 0]
    plain = heights[0, 0]
    for x in range(9):
        for y in range(8):
            around = plain[max(x - 1, 0) : x + 2, max(y - 1, 0) : y + 2]
            assert result[x, y] == pytest.approx(float((around - plain[x, y]).abs().max()))


def test_the_edge_channel_is_one_half_at_its_scale():
    heights = patch()
    heights[..., 40:, :] = 0.1
    encoded = encode(HeightEncoding(channels=("height", "edge"), edge_scale=0.1), heights)
    assert encoded.shape == (1, 2, 72, 72)
    assert encoded[0, 1, 40, 10] == pytest.approx(0.5)
    assert encoded[0, 1, 20, 10] == 0


def test_unknown_cells_without_a_height_are_edges_and_do_not_count_for_their_neighbours():
    heights = patch(3.0)
    heights[..., 20:, :] = 3.1
    heights[..., 40:, 30:] = math.nan
    encoding = HeightEncoding(unknown=None, clip=(-100, 100), channels=("edge", "unknown", "slope_x", "slope_y"))
    encoded = encode(encoding, heights)
    edge, unknown, slope_x, slope_y = encoded[0]
    assert (unknown == heights[0, 0].isnan()).all()
    assert (edge[40:, 30:] == 1).all()
    assert edge[39, 50] == 0
    assert slope_x[39, 50] == 0
    assert slope_x[19, 3] == slope_x[20, 3] == pytest.approx(0.5, abs=1e-5)
    assert (slope_y == 0).all()


def test_unevenness_is_that_of_the_cost_model():
    rng = np.random.default_rng(0)
    heights = rng.normal(0, 0.02, (72, 72)).astype(np.float32)
    heights[30:36, 50:] = np.nan
    robot = Robot.load("momaro")
    contact = int(cells(robot.feet.contact_half_width))
    encoding = HeightEncoding(unknown=None, channels=("height", "unevenness"), unevenness_contact=contact)
    expected = cost_maps(HeightMap(heights), robot).unevenness
    encoded = encode(encoding, torch.from_numpy(heights)[None, None])[0, 1]
    inner = slice(14, 72 - 14)  # near the rim, the two methods assume different neighbours
    np.testing.assert_allclose(encoded[inner, inner].expm1(), expected[inner, inner], rtol=1e-4)
    assert encoding.unevenness_radius == round(cells(robot.drive.unevenness_radius))
    assert encoding.radius("unevenness") == 12 + contact == 13


def test_encoding_survives_its_mapping():
    encoding = HeightEncoding(reference="base", clip=(-0.5, 1.0), channels=("edge",), edge_scale=0.2)
    assert load_settings(HeightEncoding, encoding.to_dict(), "model.encoding") == encoding


@pytest.mark.parametrize(
    "faulty",
    [{"channels": ["slope"]}, {"channels": []}, {"unevenness_radius": 0}, {"edge_scale": 0}, {"reference": "mean"}],
)
def test_wrong_encodings_are_refused(faulty):
    with pytest.raises(InputError, match=r"encoding\."):
        load_settings(HeightEncoding, faulty, "model.encoding")
