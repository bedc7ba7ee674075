import ast
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hdsp.base.errors import InputError
from hdsp.base.messages import coordinates, spans
from hdsp.robot import lattice
from hdsp.robot.lattice import ABSTRACT_ACTIONS, ABSTRACT_HEADINGS, DRIVE_MOVES, HEADINGS, RESOLUTION, Grid

ROOT = Path(__file__).parents[2]

grids = st.builds(
    Grid, st.tuples(st.floats(-50, 50), st.floats(-50, 50)), st.tuples(st.integers(1, 500), st.integers(1, 500))
)


@given(st.integers(-1000, 1000), st.sampled_from([HEADINGS, ABSTRACT_HEADINGS]))
def test_headings_survive_the_way_to_radians_and_back(index, headings):
    angle = lattice.heading_angle(index, headings)
    assert -math.pi <= angle < math.pi
    assert lattice.heading_index(angle, headings) == index % headings
    assert lattice.heading_index(angle + 0.49 * 2 * math.pi / headings, headings) == index % headings


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.int8, np.uint64])
@pytest.mark.parametrize("headings", [HEADINGS, ABSTRACT_HEADINGS])
def test_headings_of_any_kind_of_integer_have_the_same_angles(kind, headings):
    indices = np.arange(headings)
    np.testing.assert_array_equal(
        lattice.heading_angle(indices.astype(kind), headings), lattice.heading_angle(indices, headings)
    )
    assert lattice.heading_angle(kind(headings - 1), headings) == -2 * math.pi / headings


@given(grids, st.data())
def test_cells_survive_the_way_to_the_world_and_back(grid, data):
    cell = data.draw(st.tuples(st.integers(0, grid.shape[0] - 1), st.integers(0, grid.shape[1] - 1)))
    assert grid.cell(grid.center(cell)).tolist() == list(cell)
    assert grid.contains(cell)
    assert not grid.contains((-1, 0)) and not grid.contains((0, grid.shape[1]))


@given(grids, st.data())
def test_states_survive_the_way_to_the_world_and_back(grid, data):
    cell = data.draw(st.tuples(st.integers(0, grid.shape[0] - 1), st.integers(0, grid.shape[1] - 1)))
    rest = data.draw(st.tuples(st.integers(0, 63), *[st.integers(-12, 12)] * 4))
    world = grid.to_world(np.array([*cell, *rest]))
    assert grid.to_lattice(world[:3], world[3:]).tolist() == [*cell, *rest]


def test_the_lower_border_of_a_cell_belongs_to_it():
    grid = Grid((0.0, 0.0), (400, 400))
    edges = np.arange(400) * RESOLUTION
    assert (grid.cell(np.stack([edges, edges], axis=1)) == np.arange(400)[:, None]).all()


@pytest.mark.parametrize("pose", [(math.nan, 0.1, 0.0), (0.1, math.inf, 0.0), (0.1, 0.1, math.nan), (0.1, 0.1)])
def test_a_pose_must_be_three_finite_numbers(pose):
    with pytest.raises(InputError, match="finite"):
        Grid((0.0, 0.0), (40, 40)).to_lattice(pose)


def test_a_pose_off_the_map_is_named_with_the_extent_of_the_map():
    with pytest.raises(InputError, match=r"\(1.2, 0.1\) m is outside the map.*x 0 to 1, y 0 to 1 m, upper") as error:
        Grid((0.0, 0.0), (40, 40)).to_lattice((1.2, 0.1, 0.0))
    assert "\n" not in str(error.value)


def test_rotations_by_quarter_turns_are_exact():
    assert lattice.rotation(math.pi / 2).tolist() == [[0, -1], [1, 0]]
    assert lattice.rotation(-5 * math.pi).tolist() == [[-1, 0], [0, -1]]
    x, y = lattice.rotation(0.3) @ (1, 0)
    assert (x, y) == pytest.approx((math.cos(0.3), math.sin(0.3)))


def test_the_twenty_moves_are_symmetric_and_begin_the_actions():
    moves = {tuple(move) for move in DRIVE_MOVES.tolist()}
    assert len(moves) == 20
    assert moves == {(-dx, dy) for dx, dy in moves} == {(dy, dx) for dx, dy in moves}
    assert (ABSTRACT_ACTIONS[:20, :2] == DRIVE_MOVES).all() and not ABSTRACT_ACTIONS[:20, 2].any()
    assert ABSTRACT_ACTIONS[20:].tolist() == [[0, 0, 1], [0, 0, -1]]


@pytest.mark.parametrize("heading", range(ABSTRACT_HEADINGS))
def test_goals_in_the_frame_of_the_robot_turn_back_to_the_lattice(heading):
    goals = lattice.robot_frame_goals(heading)
    np.testing.assert_array_equal(lattice.robot_frame_goals(np.uint8(heading)), goals)
    turned = goals[:, :2] @ lattice.rotation(float(lattice.heading_angle(heading, ABSTRACT_HEADINGS))).T
    np.testing.assert_allclose(turned, ABSTRACT_ACTIONS[:, :2], atol=1e-6)
    assert (goals[:, 2] == ABSTRACT_ACTIONS[:, 2]).all()
    if heading % 4 == 0:
        assert {tuple(goal) for goal in goals.tolist()} == {tuple(map(float, a)) for a in ABSTRACT_ACTIONS.tolist()}


def test_goals_seen_by_a_robot_that_looks_left():
    left = ABSTRACT_ACTIONS.tolist().index([0, 1, 0])
    assert lattice.robot_frame_goals(4)[left].tolist() == [1, 0, 0]


@given(st.tuples(st.integers(0, 500), st.integers(0, 500), st.integers(0, 15)))
def test_the_anchor_of_an_abstract_state_falls_back_into_it(abstract):
    anchor = lattice.abstract_anchor(np.array(abstract))
    assert lattice.detailed_to_abstract(np.array([*anchor, 1, 2, 3, 4])).tolist() == list(abstract)


def test_detailed_headings_go_to_the_nearest_abstract_heading():
    states = np.array([(5, 9, heading) for heading in (0, 1, 2, 5, 6, 61, 62, 63)])
    abstract = lattice.detailed_to_abstract(states)
    assert abstract[:, 2].tolist() == [0, 0, 1, 1, 2, 15, 0, 0]
    assert (abstract[:, :2] == (1, 2)).all()


def test_abstract_steps_undo_themselves():
    steps = np.array([[1.0, -2.0, 1.0], [0.5, 0.0, -1.0]])
    world = lattice.abstract_steps_to_world(steps)
    np.testing.assert_allclose(world[0], [0.1, -0.2, math.pi / 8])
    np.testing.assert_allclose(lattice.abstract_steps(world), steps)
    assert lattice.abstract_shape((75, 80)) == (18, 20)


def test_lengths_become_cells_and_cells_lengths():
    assert lattice.cells(0.1) == pytest.approx(4) and lattice.metres(4) == pytest.approx(0.1)
    np.testing.assert_allclose(lattice.metres(lattice.cells(np.array([0.3, -1.2]))), [0.3, -1.2])
    assert lattice.is_detailed(RESOLUTION + 1e-12) and not lattice.is_detailed(0.026)


def calculations_with(tree, names):
    """Lines with an arithmetic operation or comparison on one of these names."""
    for node in ast.walk(tree):
        operands = []
        if isinstance(node, ast.BinOp):
            operands = [node.left, node.right]
        elif isinstance(node, ast.AugAssign):
            operands = [node.value]
        elif isinstance(node, ast.Compare):
            operands = [node.left, *node.comparators]
        if any(getattr(operand, "id", getattr(operand, "attr", None)) in names for operand in operands):
            yield node.lineno


def test_only_the_lattice_calculates_with_a_resolution():
    names = {"RESOLUTION", "ABSTRACT_RESOLUTION"}
    assert list(calculations_with(ast.parse("a = 2 * lattice.RESOLUTION"), names)) == [1]
    found = [
        f"{path.relative_to(ROOT)}:{line}"
        for folder in ("hdsp", "pipeline", "benchmarks", "examples")
        for path in sorted((ROOT / folder).rglob("*.py"))
        if path != ROOT / "hdsp/robot/lattice.py"
        for line in calculations_with(ast.parse(path.read_text()), names)
    ]
    assert found == []


@given(st.floats(-1e308, 1e308) | st.floats(-1e8, 1e8))
def test_coordinates_in_messages_are_exact_to_half_a_millimetre_and_short(value):
    text = coordinates([value, 0.5])
    found = float(text.removesuffix(", 0.5"))
    assert len(text) <= 22 and text.endswith(", 0.5") and "-0," not in text
    assert abs(found - value) <= max(0.000501, abs(value) * 1e-5 if abs(value) >= 1e9 else 0)


def test_a_box_far_from_zero_is_told_with_its_decimals():
    assert spans((412345.678, -0.0001), (5654321.1234, 900.0)) == "x 412345.678 to 5654321.123, y 0 to 900"
