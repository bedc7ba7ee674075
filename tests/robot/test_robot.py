import copy
import math

import numpy as np
import pytest
import yaml

from hdsp.base.errors import InputError
from hdsp.robot.robot import FEET, Robot
from tests.detailed.instances import TOY


def changed(path, value):
    """The toy robot as a mapping with one (nested) value changed; ``...`` removes the value."""
    values = copy.deepcopy(TOY)
    *parents, last = path.split(".")
    place = values
    for key in parents:
        place = place[key]
    if value is ...:
        del place[last]
    else:
        place[last] = value
    return values


def assert_refused(source, *words):
    with pytest.raises(InputError) as error:
        Robot.load(source)
    message = str(error.value)
    assert all(word in message for word in words), message
    assert "\n" not in message


def test_the_preset_is_momaro():
    robot = Robot.load("momaro")
    assert robot.name == "momaro" and "momaro" in Robot.presets()
    np.testing.assert_allclose(robot.neutral_feet(), [(0.325, 0.25), (-0.325, 0.25), (-0.325, -0.25), (0.325, -0.25)])
    assert robot.offset_range() == (-12, 12)
    assert len(FEET) == 4


def test_a_robot_survives_the_way_through_a_file(tmp_path):
    robot = Robot.load("momaro")
    path = tmp_path / "copy.yaml"
    plain = yaml.safe_load(yaml.safe_dump(robot.to_dict() | {"body": {
        "boxes": [dict(vars(box)) for box in robot.body.boxes],
    }}))  # fmt: skip
    path.write_text(yaml.safe_dump(plain))
    assert Robot.load(path) == Robot.load(str(path)) == robot
    assert Robot.load(path).hash() == robot.hash()
    assert Robot.load(robot) is robot


def test_hashes_tell_robots_apart():
    assert Robot.load(changed("turn.cost", 0.0831)).hash() != Robot.load(TOY).hash()


def test_labels_do_not_depend_on_how_plans_become_motions():
    """A trained abstraction stays valid for longer legs."""
    assert Robot.load(changed("legs.max_length", 0.4)).hash() == Robot.load(TOY).hash()
    assert Robot.load(changed("stance.margin", 0.01)).hash() == Robot.load(TOY).hash()


def test_legs_must_reach_the_ground():
    assert_refused(changed("legs.max_length", 0.1), "stance.base_height", "0.16", "0.1")
    assert_refused(changed("stance.base_height", 0.01), "stance.base_height", "0.01", "0.05")


def test_the_deviation_factor_runs_through_its_knots():
    factor = Robot.load("momaro").drive.deviation_cost
    assert factor(0.0) == 1 and factor(factor.side_from) == pytest.approx(3) and factor(math.pi) == pytest.approx(2.5)
    assert factor(factor.side_from / 2) == pytest.approx(2) and factor(math.pi / 2) == 3
    assert factor(math.atan2(1, 2)) == pytest.approx(2.11424, abs=2e-5)  # published, docs/cost-model.md


def test_the_reach_covers_feet_steps_and_body():
    robot = Robot.load("momaro")
    farthest = robot.feet.neutral_x + robot.feet.offset_max
    assert robot.reach() >= math.hypot(farthest, robot.feet.neutral_y)


def test_unknown_presets_and_files_are_named(tmp_path):
    assert_refused("centauro", "centauro", "momaro")
    assert_refused(tmp_path / "nothing.yaml", "nothing.yaml", "no such file")


def test_keys_that_are_unknown_or_missing_are_named():
    assert_refused(changed("turn.speed", 1.0), "robot.turn", "speed", "allowed")
    assert_refused(changed("turn.cost", ...), "robot.turn", "cost", "missing")
    assert_refused(changed("step", ...), "robot", "step", "missing")
    assert_refused(changed("wheels", 4), "robot", "wheels")
    assert_refused(changed("turn", 3.0), "robot.turn", "mapping", "3.0")


@pytest.mark.parametrize("value", ["fast", None, True, math.nan, math.inf, [1.0]])
def test_values_that_are_no_finite_numbers_are_named(value):
    assert_refused(changed("turn.cost", value), "robot.turn.cost", "finite number", repr(value))


@pytest.mark.parametrize(
    "key", ["feet.neutral_x", "drive.max_height_difference", "drive.unevenness_cost", "turn.cost",
            "foot_move.cost_per_metre", "base_shift.cost_per_metre", "drive.deviation_cost.side",
            "drive.unevenness_radius"],
)  # fmt: skip
@pytest.mark.parametrize("value", [0.0, -1.0])
def test_values_that_must_be_positive_are_named(key, value):
    assert_refused(changed(key, value), key, "positive")


@pytest.mark.parametrize("key", ["step.cost", "step.cost_per_metre", "turn.unevenness_cost", "feet.clearance",
                                 "feet.contact_inward", "feet.contact_half_width"])  # fmt: skip
def test_values_that_must_not_be_negative_are_named(key):
    assert_refused(changed(key, -0.1), key, "at least 0")


def test_foot_offsets_must_include_neutral_and_fit_their_bits():
    assert_refused(changed("feet.offset_min", 0.025), "offsets", "include 0")
    assert_refused(changed("feet.offset_max", 0.8), "offsets", "span")


def test_contacts_must_be_on_the_side_of_their_foot():
    assert_refused(changed("feet.contact_inward", 0.03), "contact_inward", "0.025")


def test_steps_must_be_shorter_than_an_action_code_can_say():
    assert_refused(changed("step.max_length", 0.4), "step.max_length", "0.375")


def test_boxes_must_be_a_list_of_boxes():
    assert_refused(changed("body.boxes", None), "robot.body.boxes")
    assert_refused(changed("body.boxes", [{"above": 1.0}]), "robot.body.boxes[0]", "missing")
