import copy
import math
from dataclasses import replace

import numpy as np
import pytest
import yaml

from hdsp.base.errors import InputError
from hdsp.robot.motion_limits import Accelerations, Speeds
from hdsp.robot.physics import Physics
from hdsp.robot.robot import FEET, Robot
from hdsp.robot.urdf import wheel_radius
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
    np.testing.assert_allclose(robot.neutral_feet(), [(0.3, 0.22), (-0.3, 0.22), (-0.3, -0.22), (0.3, -0.22)])
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
    faster = TOY | {"speeds": {"drive": 2.0}, "accelerations": {"lean": 3.0}}
    assert Robot.load(faster).hash() == Robot.load(TOY).hash()


def test_a_robot_file_without_limits_of_motions_has_their_defaults():
    """Robot files from before these limits stay valid."""
    robot = Robot.load(TOY)
    assert (robot.speeds, robot.accelerations) == (Speeds(), Accelerations())
    quick = Robot.load(TOY | {"speeds": {"drive": 2.0}})
    assert quick.speeds.drive == 2.0 and quick.speeds.lift == Speeds().lift
    assert_refused(TOY | {"speeds": {"drive": 0.0}}, "robot.speeds.drive", "positive")
    assert_refused(TOY | {"accelerations": {"jump": 1.0}}, "robot.accelerations", "jump", "allowed")


def test_legs_must_reach_the_ground():
    assert_refused(changed("legs.max_length", 0.1), "stance.base_height", "0.16", "0.1")
    assert_refused(changed("stance.base_height", 0.01), "stance.base_height", "0.01", "0.05")


def test_the_deviation_factor_runs_through_its_knots():
    factor = Robot.load("momaro").drive.deviation_cost
    assert factor(0.0) == 1 and factor(factor.side_from) == pytest.approx(3) and factor(math.pi) == pytest.approx(2.5)
    assert factor(factor.side_from / 2) == pytest.approx(2) and factor(math.pi / 2) == 3
    assert factor(math.atan2(1, 2)) == pytest.approx(2.11424, abs=2e-5)  # published, docs/cost-model.md


@pytest.mark.parametrize("drive", [{"sideways": False}, {"deviation_cost": {"side": math.inf}}])
def test_a_robot_that_cannot_drive_sideways_drives_along_its_heading(drive):
    values = copy.deepcopy(TOY)
    values["drive"] |= {**drive, "deviation_cost": values["drive"]["deviation_cost"] | drive.get("deviation_cost", {})}
    factor, most = Robot.load(values).drive.factor, TOY["drive"]["straight_deviation"]
    assert factor(0.0) == 1.1 and factor(math.pi) == 2.3
    assert factor(most) == pytest.approx(1.1 * (math.cos(most) + math.sin(most)))
    assert factor(math.pi - most) == pytest.approx(2.3 * (math.cos(most) + math.sin(most)))
    assert math.isinf(factor(most + 1e-6)) and math.isinf(factor(math.pi / 2)) and math.isinf(factor(math.pi - 0.4))


def test_a_robot_that_cannot_drive_backward_keeps_its_other_directions():
    drive = Robot.load(changed("drive.deviation_cost.behind", math.inf)).drive
    assert drive.factor(drive.deviation_cost.side_to) == drive.factor(math.pi / 2) == 3.0
    assert drive.factor(0.1) == Robot.load(TOY).drive.factor(0.1)
    assert math.isinf(drive.factor(math.pi)) and math.isinf(drive.factor(drive.deviation_cost.side_to + 0.01))
    assert_refused(changed("drive.deviation_cost.ahead", math.inf), "ahead", "finite number")
    assert_refused(changed("drive.deviation_cost.behind", math.nan), "behind", "positive")


def test_a_robot_that_does_not_turn_on_the_spot_has_a_radius():
    values = copy.deepcopy(TOY)
    values["turn"] |= {"on_the_spot": False, "radius": 0.5}
    assert Robot.load(values).turn.radius == 0.5
    assert_refused(changed("turn.on_the_spot", False), "turn.radius is None", "least radius")
    assert_refused(changed("turn.radius", 0.5), "turn.radius is 0.5", "on_the_spot false")


def test_the_highest_edge_follows_from_the_wheel():
    values = changed("drive.max_height_difference", ...)
    values["drive"] |= {"wheel_radius": 0.08, "rolled_share": 0.5}
    assert Robot.load(values).drive.highest_edge == 0.04
    assert Robot.load(TOY).drive.highest_edge == 0.05
    ways = "either max_height_difference, or wheel_radius and rolled_share"
    assert_refused(changed("drive.max_height_difference", ...), "drive.max_height_difference", ways)
    assert_refused(changed("drive.wheel_radius", 0.08), "drive.wheel_radius", ways)
    values["drive"]["rolled_share"] = None
    assert_refused(values, "drive.rolled_share", ways)


def test_wheels_have_a_size(tmp_path):
    """Wheels without a radius would turn by infinite angles."""
    bare = changed("physics", {})
    assert_refused(bare, "robot.feet.clearance is 0", "physics.wheel_radius")
    (tmp_path / "bare.yaml").write_text(yaml.safe_dump(bare, sort_keys=False))
    assert_refused(tmp_path / "bare.yaml", "bare.yaml, line ", "robot.feet.clearance is 0")
    robot = Robot.load(TOY)
    assert (robot.feet.clearance, wheel_radius(robot)) == (0, 0.02)
    assert wheel_radius(Robot.load(bare | {"feet": TOY["feet"] | {"clearance": 0.03}})) == 0.03
    with pytest.raises(InputError, match=r"physics\.wheel_radius"):
        wheel_radius(replace(robot, physics=Physics()))


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


def test_a_clearance_in_centimetres_is_refused():
    assert_refused(changed("feet.clearance", 8.0), "robot.feet.clearance is 8", "at most 1")


@pytest.mark.parametrize(
    ("key", "value", "need"),
    [
        ("slope.max_pitch", 1e-9, "at least 0.001"), ("slope.max_roll", 0.0, "at least 0.001"),
        ("slope.max_roll", 1.6, "less than 1.5708"), ("stance.max_roll", 20.0, "less than 1.5708"),
        ("stance.max_pitch", 17.0, "less than 1.5708"),
    ],
)  # fmt: skip
def test_inclinations_are_angles_that_a_map_can_show(key, value, need):
    assert_refused(changed(key, value), f"robot.{key} is {value:g}", need)


def test_a_body_without_boxes_is_refused():
    assert_refused(changed("body.boxes", []), "robot.body.boxes is []", "at least 1")
