import math

import numpy as np
import pytest

from hdsp.base.errors import InputError
from hdsp.detailed.world import build_world, world
from hdsp.detailed.world.geometry import (
    MOVE_SAMPLES,
    base_cells,
    base_shifts,
    contact_cells,
    foot_cells,
    rectangle_cells,
    step_line,
)
from hdsp.robot.lattice import DRIVE_MOVES, HEADINGS, RESOLUTION, heading_angle, rotation
from hdsp.robot.robot import Robot
from hdsp.robot.shape import Rectangle
from hdsp.terrain.height_map import HeightMap
from tests.detailed.instances import toy
from tests.naive_ground import rectangle_offsets


@pytest.mark.parametrize("shape", [(65537, 1), (1, 65537)])
def test_maps_too_long_for_packed_states_are_refused(shape):
    with pytest.raises(InputError, match=rf"{shape[0]} x {shape[1]} cells.*65536"):
        build_world(HeightMap.flat(shape), Robot.load("momaro"))


def test_maps_with_too_many_cells_for_the_tables_are_refused():
    with pytest.raises(InputError, match=r"1073741824 cells.*at most"):
        world.robot_tables(Robot.load("momaro"), stride=1 << 15, size=1 << 30)


@pytest.fixture(scope="module", params=["momaro", "toy"])
def robot(request):
    return toy() if request.param == "toy" else Robot.load("momaro")


def test_neutral_feet_of_momaro_and_their_contacts_are_12_and_9_cells_from_the_base():
    for cells in (foot_cells(Robot.load("momaro")), contact_cells(Robot.load("momaro"))):
        assert cells[0, :, 12, 0].tolist() == [[12, 9], [-12, 9], [-12, -9], [12, -9]]


def test_contacts_turn_with_the_robot_and_follow_its_moves_by_whole_cells(robot):
    table, low = contact_cells(robot), robot.offset_range()[0]
    neutral = robot.neutral_feet()
    middle = (neutral - np.sign(neutral) * robot.feet.contact_inward) / RESOLUTION
    for heading in range(HEADINGS):
        exact = middle @ rotation(float(heading_angle(heading))).T
        assert abs(table[heading, :, -low, 0] - exact).max() <= 0.5 + 1e-9
    moved = table - table[:, :, :, :1]
    assert abs(moved - MOVE_SAMPLES.displacement).max() <= 0.5 + 1e-9
    assert (moved == moved[:, :, :1]).all()


def test_turned_feet_are_in_the_cell_nearest_to_their_circle(robot):
    table, low = foot_cells(robot), robot.offset_range()[0]
    for heading in range(HEADINGS):
        exact = robot.neutral_feet() / RESOLUTION @ rotation(float(heading_angle(heading))).T
        assert abs(table[heading, :, -low, 0] - exact).max() <= 0.5 + 1e-9


@pytest.mark.parametrize("cells_of", [foot_cells, contact_cells])
def test_quarter_turned_feet_are_in_quarter_turned_cells(robot, cells_of):
    # The move samples rotate too: row s in the table belongs to a displacement; ``turned`` has the rotated one's row.
    table, quarter = cells_of(robot), rotation(math.pi / 2)
    at = MOVE_SAMPLES.displacement
    turned = [int(np.abs(at - shift).sum(axis=1).argmin()) for shift in at @ quarter.T]
    for heading in range(HEADINGS):
        later = (heading + HEADINGS // 4) % HEADINGS
        assert (table[later][:, :, turned] == table[heading] @ quarter.T).all()
        assert (base_cells()[turned] == base_cells() @ quarter.T).all()


@pytest.mark.parametrize("cells_of", [foot_cells, contact_cells])
def test_mirrored_feet_are_in_mirrored_cells(robot, cells_of):
    table, at = cells_of(robot), MOVE_SAMPLES.displacement
    mirrored = [int(np.abs(at - shift).sum(axis=1).argmin()) for shift in at * (1, -1)]
    for heading in range(HEADINGS):
        other = table[-heading % HEADINGS][[3, 2, 1, 0]][:, :, mirrored]
        assert (other == table[heading] * (1, -1)).all()


def test_positions_between_two_cells_go_forward_and_toward_the_body():
    half = toy(feet={"neutral_x": 0.0625, "neutral_y": 0.0375})  # 2.5 and 1.5 cells
    assert foot_cells(half)[0, :, 2, 0].tolist() == [[3, 1], [-2, 1], [-2, -1], [3, -1]]


def test_moves_are_sampled_at_least_once_a_cell():
    for (dx, dy), first, count in zip(DRIVE_MOVES, MOVE_SAMPLES.first, MOVE_SAMPLES.counts, strict=True):
        rows = MOVE_SAMPLES.displacement[first : first + count]
        n = math.floor(math.hypot(dx, dy)) + 1
        assert len(rows) == n - 1
        np.testing.assert_allclose(rows, [(dx * i / n, dy * i / n) for i in range(1, n)])


def test_rectangles_cover_the_cells_whose_centres_lie_in_them():
    rectangle = Rectangle(-0.15, 0.2, 0.11)
    for heading in range(HEADINGS):
        expected = [offset[:2] for offset in rectangle_offsets(rectangle, heading)]
        assert sorted(map(tuple, rectangle_cells(rectangle, heading).tolist())) == expected


def test_base_shifts_lead_ahead_and_turn_with_the_robot():
    table = base_shifts()
    assert table[0].tolist() == [1, 0, 1]
    for heading, (dx, dy, n) in enumerate(table.tolist()):
        ahead = rotation(float(heading_angle(heading)))[:, 0] * n
        assert np.hypot(*(ahead - (dx, dy))) <= math.sqrt(0.5)
        assert table[(heading + 16) % HEADINGS].tolist() == [-dy, dx, n]
        assert table[-heading % HEADINGS].tolist() == [dx, -dy, n]


def test_step_lines_lead_straight_ahead(robot):
    lines = step_line(robot)
    for heading in range(HEADINGS):
        ahead = rotation(float(heading_angle(heading)))[:, 0]
        assert abs(lines[heading] - np.arange(lines.shape[1])[:, None] * ahead).max() <= 0.5 + 1e-9
